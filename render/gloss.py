"""Light that a rough-plastic coat sends to the camera: base and highlight of each LED, with the LED's shadows."""

from typing import NamedTuple

import numba
import numpy as np

from gelgap.render.irradiance import GENTLE_NORMAL, Light, smooth_stride
from gelgap.render.led_samples import LedSamples, ShadowDetail
from gelgap.render.occlusion import HeightField, find_occluders, vertex_at, visible_parts
from gelgap.render.plastic import highlight, rough_plastic, shadowing, transmitted_share
from gelgap.render.shaded_surface import Surface


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
    node_mm, normal, area_mm2 = nodes
    shadowing_out = shadowing(view.cosine, coat) / (np.float32(4) * view.cosine)
    base, glossy = zero, zero
    for k in range(node_mm.shape[2]):
        qx, qy, qz = node_mm[led, 0, k] - px, node_mm[led, 1, k] - py, node_mm[led, 2, k] - pz
        r2 = qx * qx + qy * qy + qz * qz
        inverse = np.float32(1) / np.sqrt(r2)
        cosine_in = (nx * qx + ny * qy + nz * qz) * inverse
        away = -(normal[led, 0, k] * qx + normal[led, 1, k] * qy + normal[led, 2, k] * qz) * inverse
        solid_angle = area_mm2[led, k] * (away if away > zero else zero) / r2
        cosine_in = cosine_in if cosine_in > zero else zero
        in_dot_out = (qx * view.x + qy * view.y + qz * view.z) * inverse
        base += solid_angle * cosine_in * transmitted_share(cosine_in, coat)
        glossy += solid_angle * highlight(cosine_in, view.cosine, in_dot_out, shadowing_out, coat)
    return base * transmitted_share(view.cosine, coat) * coat.base_scale, glossy


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _partial_gloss(vertex, camera_mm, coat, strips, parts):
    """Return base and highlight from the visible parts of an LED's strips."""
    one, zero = np.float32(1), np.float32(0)
    gauss = (np.float32(0.11270167), np.float32(0.5), np.float32(0.88729833))
    weight = (np.float32(5 / 18), np.float32(8 / 18), np.float32(5 / 18))
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
            w = s0 + (s1 - s0) * gauss[g]
            qx, qy, qz = strip.low_x + w * ex - px, strip.low_y + w * ey - py, strip.low_z + w * ez - pz
            r2 = qx * qx + qy * qy + qz * qz
            inverse = one / np.sqrt(r2)
            cosine_in = (nx * qx + ny * qy + nz * qz) * inverse
            area = strip.area
            if strip.is_point:
                solid_angle = weight[g] * area / r2
            else:
                away = -(strip.normal_x * qx + strip.normal_y * qy + strip.normal_z * qz) * inverse
                solid_angle = weight[g] * (s1 - s0) * area * away / r2
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
def _gloss(surface, light, camera_mm, coat, leds, march_step_mm, stride, out):
    """Overwrite out[row, column, led] = (base, highlight) where the surface changed or an LED is partly hidden.

    Where the surface is nearly flat, light in full view is computed for every stride-th vertex and interpolated, and
    what is partly hidden is the visible share of it.
    """
    one, zero = np.float32(1), np.float32(0)
    changed = surface.changed
    rows, columns = changed.shape
    count = len(leds.is_point)
    field = HeightField(surface.height_mm.ravel(), columns, surface.grid)
    occluders = find_occluders(surface, leds.outlines)
    parts = np.empty((len(leds.strips), 2), np.float32)
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
                    out[j, i, led] = zero
                    continue
                if share > zero and not changed[j, i]:
                    out[j, i, led] *= share
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
                    base, glossy = base * share, glossy * share
                else:
                    strips = leds.strips[leds.first_strip[led] : leds.first_strip[led + 1]]
                    visible_parts(vertex, field, occluders[led], strips, march_step_mm, parts)
                    base, glossy = _partial_gloss(vertex, camera_mm, coat, strips, parts)
                out[j, i, led, 0] = base
                out[j, i, led, 1] = glossy


def gloss(
    surface: Surface,
    leds: LedSamples,
    detail: ShadowDetail,
    light: Light,
    camera_mm: tuple[float, float, float],
    roughness: float,
    reference: np.ndarray | None,
) -> np.ndarray:
    """Return (rows, columns, leds, 2) float32 of rough plastic per unit LED radiance.

    The first value times albedo/π is the radiance that the base sends to the camera; the second is that of the
    highlight. `light` is that of the same surface: it knows which LEDs are hidden. What the contact did not change is
    taken from `reference`.
    """
    if reference is None:
        surface = surface.all_changed()
        out = np.zeros((*light.irradiance.shape, 2), np.float32)
    else:
        out = reference.copy()
    coat = rough_plastic(roughness)
    coat = coat._replace(base_scale=np.float32(coat.base_scale))  # all in single precision, for speed
    step_mm, stride = np.float32(detail.march_step_mm), smooth_stride(surface.grid.spacing_mm)
    _gloss(surface, light, np.asarray(camera_mm, np.float32), coat, leds, step_mm, stride, out)
    return out
