"""Gloss: what a rough-plastic coat sends to the camera, as base and highlight of each LED, with the LED's shadows.

Rough plastic is a Lambertian base under a rough dielectric interface. The model is that of Mitsuba 3's `roughplastic`
(Beckmann distribution, interior 1.49, exterior 1.000277, linear): microfacet reflection after Walter et al. (2007) with
Smith's shadowing, and a base that receives and returns what the interface transmits, so that a picture can be checked
against a path tracer without a fitted gain.
"""

from functools import lru_cache
from typing import NamedTuple

import numba
import numpy as np

from gelgap.render.light.irradiance import GAUSS_NODES, GAUSS_WEIGHTS, GENTLE_NORMAL, DirectLight
from gelgap.render.light.leds import LedSamples
from gelgap.render.light.occlusion import vertex_at
from gelgap.render.surface import Surface

REFRACTIVE_INDEX = 1.49 / 1.000277
TABLE_SIZE = 64
TERMS = 7
# Where the surface is nearly flat, gloss in full view is computed this far apart and interpolated: within one code
# value at standard quality from a roughness of 0.2 on. A glossy frame of a solved membrane takes 1.4 times as long
# without.
SMOOTH_MM = 0.4


class Plastic(NamedTuple):
    """Rough plastic of one roughness as kernels take it.

    The base reflects albedo/π × base_scale × (share transmitted in) × (share transmitted out). The transmitted share is
    a polynomial in the cosine to the normal (TERMS coefficients, from c⁰).
    """

    roughness: np.float32  # Beckmann α
    refractive_index: np.float32
    transmission: np.ndarray  # (TERMS,)
    base_scale: float


def _fresnel(cosine: np.ndarray, eta: float) -> np.ndarray:
    """Return the unpolarised Fresnel reflectance of a dielectric; `eta` is transmitted over incident index."""
    sine2 = (1 - cosine**2) / eta**2
    transmitted = np.sqrt(np.maximum(1 - sine2, 0))
    parallel = (cosine - eta * transmitted) / (cosine + eta * transmitted)
    perpendicular = (eta * cosine - transmitted) / (eta * cosine + transmitted)
    return np.where(sine2 >= 1, 1.0, 0.5 * (parallel**2 + perpendicular**2))


def _smith_g1(cosine: np.ndarray, roughness: float) -> np.ndarray:
    """Return Smith's shadowing for a Beckmann surface, in the rational form of Walter et al. (2007)."""
    tangent = np.sqrt(np.maximum(1 - cosine**2, 0)) / np.maximum(cosine, 1e-6)
    a = 1 / np.maximum(roughness * tangent, 1e-6)
    return np.where(a >= 1.6, 1.0, (3.535 * a + 2.181 * a**2) / (1 + 2.276 * a + 2.577 * a**2))


def _through_interface(cosine: float, roughness: float, eta: float) -> tuple[float, float]:
    """Return reflected and transmitted share of light that meets the rough interface at one angle."""
    tilt = (np.arange(64) + 0.5) / 64 * (np.pi / 2)
    turn = (np.arange(32) + 0.5) / 32 * 2 * np.pi
    tilt, turn = np.meshgrid(tilt, turn, indexing="ij")
    m = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    distribution = np.exp(-((np.tan(tilt) / roughness) ** 2)) / (np.pi * roughness**2 * np.cos(tilt) ** 4)
    incident = np.array([np.sqrt(1 - cosine**2), 0, cosine])[:, None, None]
    facing = (incident * m).sum(0)
    visible = np.where(facing > 0, _smith_g1(np.array(cosine), roughness) * facing * distribution / cosine, 0)
    visible *= np.sin(tilt)
    visible /= visible.sum()
    facing = np.maximum(facing, 1e-9)
    reflectance = _fresnel(facing, eta)
    reflected = 2 * facing * m - incident
    transmitted_cosine = np.sqrt(np.maximum(1 - (1 - facing**2) / eta**2, 0))
    transmitted = m * (facing / eta - transmitted_cosine) - incident / eta
    out_up = np.where(reflected[2] > 0, _smith_g1(np.clip(reflected[2], 1e-6, 1), roughness), 0)
    out_down = np.where(transmitted[2] < 0, _smith_g1(np.clip(-transmitted[2], 1e-6, 1), roughness), 0)
    shares = visible * reflectance * out_up, visible * (1 - reflectance) * out_down
    return float(shares[0].sum()), float(shares[1].sum())


@lru_cache(maxsize=16)
def rough_plastic(roughness: float) -> Plastic:
    """Return the rough plastic of a roughness (Beckmann α).

    The transmission is fitted to share × cosine, as it is used: within 5e-4 for a roughness of 0.1, 1e-4 from 0.2 on.
    """
    cosines = np.maximum(np.linspace(0, 1, TABLE_SIZE), 1e-3)
    transmitted = np.array([_through_interface(c, roughness, REFRACTIVE_INDEX)[1] for c in cosines])
    powers = cosines[:, None] ** np.arange(TERMS)
    coefficients = np.linalg.lstsq(cosines[:, None] * powers, cosines * transmitted, rcond=None)[0]
    # The mean over the table is how the path tracer integrates; a finer rule would make the base 1–2 % brighter.
    inside = np.array([_through_interface(c, roughness, 1 / REFRACTIVE_INDEX)[0] for c in cosines])
    internal = 2 * float((inside * cosines).mean())
    return Plastic(
        roughness=np.float32(roughness),
        refractive_index=np.float32(REFRACTIVE_INDEX),
        transmission=coefficients.astype(np.float32),
        base_scale=1 / ((1 - internal) * REFRACTIVE_INDEX**2),
    )


@numba.njit(cache=True, error_model="numpy", fastmath=True, inline="always")
def transmitted_share(cosine, coat):
    """Return the share of light that the interface transmits at a cosine to the normal."""
    share = coat.transmission[TERMS - 1]
    for k in range(TERMS - 2, -1, -1):
        share = share * cosine + coat.transmission[k]
    return share


@numba.njit(cache=True, error_model="numpy", fastmath=True, inline="always")
def shadowing(cosine, coat):
    """Return `_smith_g1` without a branch, so that loops over it run in vector registers."""
    one = np.float32(1)
    positive = cosine if cosine > np.float32(1e-6) else np.float32(1e-6)
    sine2 = one - positive * positive
    sine2 = sine2 if sine2 > np.float32(1e-12) else np.float32(1e-12)
    a = positive / (coat.roughness * np.sqrt(sine2))
    a = a if a < np.float32(1.6) else np.float32(1.6)
    share = (np.float32(3.535) * a + np.float32(2.181) * a * a) / (
        one + np.float32(2.276) * a + np.float32(2.577) * a * a
    )
    return share if share < one else one


@numba.njit(cache=True, error_model="numpy", fastmath=True, inline="always")
def _exp_minus(t):
    """Return e^−t for t ≥ 0, within 2e-4 of what matters (t ≤ 5), by (1 + t/32 + …)³²: no call within a loop."""
    one = np.float32(1)
    x = (t if t < np.float32(60) else np.float32(60)) * np.float32(1 / 32)
    p = one + x * (one + x * (np.float32(1 / 2) + x * np.float32(1 / 6)))
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    return one / p


@numba.njit(cache=True, error_model="numpy", fastmath=True, inline="always")
def highlight(cosine_in, cosine_out, in_dot_out, shadowing_out, coat):
    """Return the interface's microfacet BRDF × cosine_in × 4 cosine_out; both cosines must be positive.

    Angles are those of both directions to the normal and to each other.
    """
    eta = coat.refractive_index
    one, half, zero = np.float32(1), np.float32(0.5), np.float32(0)
    # |in + out|² = 2 (1 + in·out)
    length2 = np.float32(2) * (one + in_dot_out)
    length2 = length2 if length2 > np.float32(1e-6) else np.float32(1e-6)
    both = cosine_in + cosine_out
    tilt2 = both * both / length2
    tilt2 = tilt2 if tilt2 < one else one
    facing2 = np.float32(0.25) * length2
    facing2 = facing2 if facing2 < one else one
    facing = np.sqrt(facing2)
    rough2 = coat.roughness * coat.roughness
    inverse = one / (tilt2 * rough2)
    distribution = _exp_minus((one - tilt2) * inverse) * inverse / (np.float32(np.pi) * tilt2)
    inside2 = one - (one - facing2) / (eta * eta)
    inside = np.sqrt(inside2 if inside2 > zero else zero)
    parallel = (facing - eta * inside) / (facing + eta * inside)
    perpendicular = (eta * facing - inside) / (eta * facing + inside)
    fresnel = half * (parallel * parallel + perpendicular * perpendicular)
    return fresnel * distribution * shadowing(cosine_in, coat) * shadowing_out


class View(NamedTuple):
    """The unit vector from a vertex to the camera, and its cosine to the vertex's normal."""

    x: float
    y: float
    z: float
    cosine: float


@numba.njit(cache=True, error_model="numpy", fastmath=True, inline="always")
def view_from(vertex, camera_mm):
    """Return how a vertex sees the camera at a place (3,)."""
    vx, vy, vz = camera_mm[0] - vertex.x, camera_mm[1] - vertex.y, camera_mm[2] - vertex.z
    inverse = np.float32(1) / np.sqrt(vx * vx + vy * vy + vz * vz)
    vx, vy, vz = vx * inverse, vy * inverse, vz * inverse
    return View(vx, vy, vz, vertex.nx * vx + vertex.ny * vy + vertex.nz * vz)


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _open_gloss(vertex, camera_mm, coat, nodes, led):
    """Return base and highlight of an area LED in full view; its nodes lie side by side, as for the irradiance."""
    zero = np.float32(0)
    view = view_from(vertex, camera_mm)
    if view.cosine <= zero:
        return zero, zero
    px, py, pz = vertex.x, vertex.y, vertex.z
    nx, ny, nz = vertex.nx, vertex.ny, vertex.nz
    points, first, normal = nodes
    ax, ay, az = normal[led]
    shadowing_out = shadowing(view.cosine, coat) / (np.float32(4) * view.cosine)
    base, glossy = zero, zero
    for k in range(first[led], first[led + 1]):
        qx, qy, qz = points[0, k] - px, points[1, k] - py, points[2, k] - pz
        r2 = qx * qx + qy * qy + qz * qz
        inverse = np.float32(1) / np.sqrt(r2)
        cosine_in = (nx * qx + ny * qy + nz * qz) * inverse
        away = -(ax * qx + ay * qy + az * qz) * inverse
        solid_angle = points[3, k] * (away if away > zero else zero) / r2
        cosine_in = cosine_in if cosine_in > zero else zero
        in_dot_out = (qx * view.x + qy * view.y + qz * view.z) * inverse
        base += solid_angle * cosine_in * transmitted_share(cosine_in, coat)
        glossy += solid_angle * highlight(cosine_in, view.cosine, in_dot_out, shadowing_out, coat)
    return base * transmitted_share(view.cosine, coat) * coat.base_scale, glossy


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _partial_gloss(vertex, camera_mm, coat, strips, parts):
    """Return base and highlight from the visible parts of an LED's strips."""
    one, zero = np.float32(1), np.float32(0)
    view = view_from(vertex, camera_mm)
    if view.cosine <= zero:
        return zero, zero
    px, py, pz = vertex.x, vertex.y, vertex.z
    nx, ny, nz = vertex.nx, vertex.ny, vertex.nz
    shadowing_out = shadowing(view.cosine, coat) / (np.float32(4) * view.cosine)
    base, glossy = zero, zero
    for k in range(len(strips)):
        strip = strips[k]
        s0, s1 = parts[k, 0], parts[k, 1]
        if s1 <= s0:
            continue
        ex, ey, ez = strip.high_x - strip.low_x, strip.high_y - strip.low_y, strip.high_z - strip.low_z
        for g in range(3):
            w = s0 + (s1 - s0) * GAUSS_NODES[g]
            qx, qy, qz = strip.low_x + w * ex - px, strip.low_y + w * ey - py, strip.low_z + w * ez - pz
            r2 = qx * qx + qy * qy + qz * qz
            inverse = one / np.sqrt(r2)
            cosine_in = (nx * qx + ny * qy + nz * qz) * inverse
            area = strip.area
            if strip.is_point:
                solid_angle = GAUSS_WEIGHTS[g] * area / r2
            else:
                away = -(strip.normal_x * qx + strip.normal_y * qy + strip.normal_z * qz) * inverse
                solid_angle = GAUSS_WEIGHTS[g] * (s1 - s0) * area * away / r2
            if cosine_in <= zero or solid_angle <= zero:
                continue
            in_dot_out = (qx * view.x + qy * view.y + qz * view.z) * inverse
            base += solid_angle * cosine_in * transmitted_share(cosine_in, coat)
            glossy += solid_angle * highlight(cosine_in, view.cosine, in_dot_out, shadowing_out, coat)
    return base * transmitted_share(view.cosine, coat) * coat.base_scale, glossy


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _coarse_gloss(surface, camera_mm, coat, leds, out, stride, gentle, coarse):
    """Fill coarse[row, column, led] with what every stride-th, nearly flat vertex sends if nothing hides the LED."""
    rows, columns = gentle.shape
    for row in range(rows):
        for column in range(columns):
            j, i = row * stride, column * stride
            vertex = vertex_at(surface, j, i)
            gentle[row, column] = vertex.nz < np.float32(-GENTLE_NORMAL)
            if not gentle[row, column]:
                continue
            for led in range(len(leds.is_point)):
                base, glossy = out[j, i, led, 0], out[j, i, led, 1]
                if surface.changed[j, i]:
                    base, glossy = _open_gloss(vertex, camera_mm, coat, leds.nodes, led)
                coarse[row, column, led, 0], coarse[row, column, led, 1] = base, glossy


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _gloss(surface, light, camera_mm, coat, leds, whole, stride, out):
    """Overwrite out[row, column, led] = (base, highlight) where the surface changed or an LED is partly hidden.

    `whole` are the visible parts (strips, 2) of an LED of which nothing is hidden.
    Where the surface is nearly flat, light in full view is computed for every stride-th vertex and interpolated, and
    what is partly hidden is the visible share of it.
    """
    one, zero = np.float32(1), np.float32(0)
    changed = surface.changed
    rows, columns = changed.shape
    count = len(leds.is_point)
    gentle = np.empty(((rows - 1) // stride + 1, (columns - 1) // stride + 1), np.bool_)
    coarse = np.empty((*gentle.shape, count, 2), np.float32)
    _coarse_gloss(surface, camera_mm, coat, leds, out, stride, gentle, coarse)
    inverse_stride = np.float32(1 / stride)
    for j in range(rows):
        north = min(j // stride, gentle.shape[0] - 2)
        fv = np.float32(j - north * stride) * inverse_stride
        for i in range(columns):
            west = min(i // stride, gentle.shape[1] - 2)
            fu = np.float32(i - west * stride) * inverse_stride
            vertex = vertex_at(surface, j, i)
            smooth = (
                vertex.nz < np.float32(-GENTLE_NORMAL)
                and fu <= one
                and fv <= one
                and gentle[north, west]
                and gentle[north, west + 1]
                and gentle[north + 1, west]
                and gentle[north + 1, west + 1]
            )
            w00, w10, w01, w11 = (one - fu) * (one - fv), fu * (one - fv), (one - fu) * fv, fu * fv
            for led in range(count):
                share = light.visible[j, i, led]
                if share == one and not changed[j, i]:
                    continue
                if light.irradiance[j, i, led] == zero:
                    out[j, i, led, 0], out[j, i, led, 1] = zero, zero
                    continue
                if share > zero and not changed[j, i]:
                    for k in range(2):
                        out[j, i, led, k] *= share
                    continue
                if share > zero and not leds.is_point[led]:
                    if smooth:
                        for k in range(2):
                            out[j, i, led, k] = share * (
                                w00 * coarse[north, west, led, k]
                                + w10 * coarse[north, west + 1, led, k]
                                + w01 * coarse[north + 1, west, led, k]
                                + w11 * coarse[north + 1, west + 1, led, k]
                            )
                        continue
                    base, glossy = _open_gloss(vertex, camera_mm, coat, leds.nodes, led)
                else:
                    strips = leds.strips[leds.first_strip[led] : leds.first_strip[led + 1]]
                    parts = whole if share > zero else light.parts[np.int64(-1 - share)]
                    base, glossy = _partial_gloss(vertex, camera_mm, coat, strips, parts)
                seen = share if share > zero else one
                out[j, i, led, 0], out[j, i, led, 1] = base * seen, glossy * seen


def smooth_stride(spacing_mm: float) -> int:
    """Return how many vertices lie between those for which gloss in full view is computed on nearly flat places."""
    return max(round(SMOOTH_MM / spacing_mm), 1)


def gloss(
    surface: Surface,
    leds: LedSamples,
    light: DirectLight,
    camera_mm: tuple[float, float, float],
    roughness: float,
    reference: np.ndarray | None,
) -> np.ndarray:
    """Return (rows, columns, leds, 2) float32 of rough plastic per unit LED radiance.

    The first value times albedo/π is the radiance that the base sends to the camera; the second is that of the
    highlight. `light` is that of the same surface: it knows what is hidden of LEDs. What the contact did not change is
    taken from `reference`.
    """
    if reference is None:
        surface = surface._replace(changed=np.ones_like(surface.changed))
        out = np.zeros((*light.irradiance.shape, 2), np.float32)
    else:
        out = reference.copy()
    coat = rough_plastic(roughness)
    coat = coat._replace(base_scale=np.float32(coat.base_scale))  # all in single precision, for speed
    stride = smooth_stride(surface.grid.spacing_mm)
    whole = np.tile(np.float32([0, 1]), (leds.most_strips, 1))
    _gloss(surface, light, np.asarray(camera_mm, np.float32), coat, leds, whole, stride, out)
    return out
