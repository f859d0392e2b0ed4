"""Light that a rough-plastic coat sends to the camera: base and highlight of each LED, with the shadows of shading."""

import numba
import numpy as np

from gelgap.render.plastic import REFRACTIVE_INDEX, highlight, interface_shares, shadowing, transmitted_share
from gelgap.render.shading import (
    GENTLE_NORMAL,
    LedSamples,
    Light,
    ShadowDetail,
    occluders_of,
    smooth_stride,
    visible_parts,
)
from gelgap.render.surface import Surface


@numba.njit(cache=True, fastmath=True, inline="always")
def _to_camera(px, py, pz, camera):
    """Return the unit vector from a point to the camera."""
    vx, vy, vz = camera[0] - px, camera[1] - py, camera[2] - pz
    inverse = np.float32(1) / np.sqrt(vx * vx + vy * vy + vz * vz)
    return vx * inverse, vy * inverse, vz * inverse


@numba.njit(cache=True, fastmath=True)
def _open_gloss(px, py, pz, nx, ny, nz, camera, nodes, led, shares, scale, roughness, eta):
    """Return base and highlight of an LED in full view; its nodes lie side by side, as for the irradiance."""
    zero = np.float32(0)
    vx, vy, vz = _to_camera(px, py, pz, camera)
    cosine_out = nx * vx + ny * vy + nz * vz
    if cosine_out <= zero:
        return zero, zero
    shadowing_out = shadowing(cosine_out, roughness) / (np.float32(4) * cosine_out)
    base, glossy = zero, zero
    for k in range(nodes.shape[2]):
        qx, qy, qz = nodes[led, 0, k] - px, nodes[led, 1, k] - py, nodes[led, 2, k] - pz
        r2 = qx * qx + qy * qy + qz * qz
        inverse = np.float32(1) / np.sqrt(r2)
        cosine_in = (nx * qx + ny * qy + nz * qz) * inverse
        away = -(nodes[led, 3, k] * qx + nodes[led, 4, k] * qy + nodes[led, 5, k] * qz) * inverse
        solid_angle = nodes[led, 6, k] * (away if away > zero else zero) / r2
        cosine_in = cosine_in if cosine_in > zero else zero
        in_dot_out = (qx * vx + qy * vy + qz * vz) * inverse
        base += solid_angle * cosine_in * transmitted_share(cosine_in, shares)
        glossy += solid_angle * highlight(cosine_in, cosine_out, in_dot_out, shadowing_out, roughness, eta)
    return base * transmitted_share(cosine_out, shares) * scale, glossy


@numba.njit(cache=True, fastmath=True)
def _partial_gloss(px, py, pz, nx, ny, nz, camera, strips, begin, end, parts, shares, scale, roughness, eta):
    """Return base and highlight from the visible intervals of an LED's strips."""
    one, zero = np.float32(1), np.float32(0)
    gauss = (np.float32(0.11270167), np.float32(0.5), np.float32(0.88729833))
    weight = (np.float32(5 / 18), np.float32(8 / 18), np.float32(5 / 18))
    vx, vy, vz = _to_camera(px, py, pz, camera)
    cosine_out = nx * vx + ny * vy + nz * vz
    if cosine_out <= zero:
        return zero, zero
    shadowing_out = shadowing(cosine_out, roughness) / (np.float32(4) * cosine_out)
    base, glossy = zero, zero
    for k in range(begin, end):
        s0, s1 = parts[k - begin, 0], parts[k - begin, 1]
        if s1 <= s0:
            continue
        ex, ey, ez = strips[k, 3] - strips[k, 0], strips[k, 4] - strips[k, 1], strips[k, 5] - strips[k, 2]
        for g in range(3):
            w = s0 + (s1 - s0) * gauss[g]
            qx = strips[k, 0] + w * ex - px
            qy = strips[k, 1] + w * ey - py
            qz = strips[k, 2] + w * ez - pz
            r2 = qx * qx + qy * qy + qz * qz
            inverse = one / np.sqrt(r2)
            cosine_in = (nx * qx + ny * qy + nz * qz) * inverse
            if strips[k, 9] == zero:
                solid_angle = weight[g] / r2
            else:
                away = -(strips[k, 6] * qx + strips[k, 7] * qy + strips[k, 8] * qz) * inverse
                solid_angle = weight[g] * (s1 - s0) * strips[k, 9] * away / r2
            if cosine_in <= zero or solid_angle <= zero:
                continue
            in_dot_out = (qx * vx + qy * vy + qz * vz) * inverse
            base += solid_angle * cosine_in * transmitted_share(cosine_in, shares)
            glossy += solid_angle * highlight(
                cosine_in, cosine_out, in_dot_out, shadowing_out, roughness, eta
            )
    return base * transmitted_share(cosine_out, shares) * scale, glossy


@numba.njit(cache=True, fastmath=True)
def _coarse_gloss(
    positions, normals, changed, camera, nodes, shares, scale, roughness, eta, out, stride, gentle, coarse
):
    """Fill coarse[row, column, led] with what every stride-th, nearly flat vertex sends if nothing hides the LED."""
    rows, columns = gentle.shape
    for row in range(rows):
        for column in range(columns):
            j, i = row * stride, column * stride
            px, py, pz = positions[j, i, 0], positions[j, i, 1], positions[j, i, 2]
            nx, ny, nz = normals[j, i, 0], normals[j, i, 1], normals[j, i, 2]
            gentle[row, column] = nz < np.float32(-GENTLE_NORMAL)
            if not gentle[row, column]:
                continue
            for led in range(len(nodes)):
                base, glossy = out[j, i, led, 0], out[j, i, led, 1]
                if changed[j, i]:
                    base, glossy = _open_gloss(
                        px, py, pz, nx, ny, nz, camera, nodes, led, shares, scale, roughness, eta
                    )
                coarse[row, column, led, 0], coarse[row, column, led, 1] = base, glossy


@numba.njit(cache=True, fastmath=True)
def _gloss(
    positions, normals, changed, height, x0, y0, spacing, strips, first_strip, nodes, outlines, step, camera,
    irradiance, visible, shares, scale, roughness, eta, stride, out,
):  # fmt: skip
    """Overwrite out[row, column, led] = (base, highlight) where the surface changed or an LED is partly hidden.

    Where the surface is nearly flat, light in full view is computed for every stride-th vertex and interpolated, and
    what is partly hidden is the visible share of it.
    """
    one, zero = np.float32(1), np.float32(0)
    rows, columns, _ = positions.shape
    leds = len(outlines)
    flat_height = height.ravel()
    occluders = np.empty((leds, 8), np.float32)
    occluders_of(height, x0, y0, spacing, outlines, occluders)
    parts = np.empty((len(strips), 2), np.float32)
    gentle = np.empty(((rows - 1) // stride + 1, (columns - 1) // stride + 1), np.bool_)
    coarse = np.empty((*gentle.shape, leds, 2), np.float32)
    _coarse_gloss(
        positions, normals, changed, camera, nodes, shares, scale, roughness, eta, out, stride, gentle, coarse
    )
    inverse_stride = np.float32(1 / stride)
    for j in range(rows):
        north = min(j // stride, gentle.shape[0] - 2)
        fv = np.float32(j - north * stride) * inverse_stride
        for i in range(columns):
            west = min(i // stride, gentle.shape[1] - 2)
            fu = np.float32(i - west * stride) * inverse_stride
            px, py, pz = positions[j, i, 0], positions[j, i, 1], positions[j, i, 2]
            nx, ny, nz = normals[j, i, 0], normals[j, i, 1], normals[j, i, 2]
            smooth = (
                nz < np.float32(-GENTLE_NORMAL)
                and fu <= one
                and fv <= one
                and gentle[north, west]
                and gentle[north, west + 1]
                and gentle[north + 1, west]
                and gentle[north + 1, west + 1]
            )
            w00, w10, w01, w11 = (one - fu) * (one - fv), fu * (one - fv), (one - fu) * fv, fu * fv
            for led in range(leds):
                share = visible[j, i, led]
                if share == one and not changed[j, i]:
                    continue
                if irradiance[j, i, led] == zero:
                    out[j, i, led] = zero
                    continue
                if share > zero and not changed[j, i]:
                    out[j, i, led] *= share
                    continue
                if nodes[led, 6, 0] > zero and share > zero:
                    if smooth:
                        for k in range(2):
                            out[j, i, led, k] = share * (
                                w00 * coarse[north, west, led, k]
                                + w10 * coarse[north, west + 1, led, k]
                                + w01 * coarse[north + 1, west, led, k]
                                + w11 * coarse[north + 1, west + 1, led, k]
                            )
                        continue
                    base, glossy = _open_gloss(
                        px, py, pz, nx, ny, nz, camera, nodes, led, shares, scale, roughness, eta
                    )
                    base, glossy = base * share, glossy * share
                else:
                    begin, end = first_strip[led], first_strip[led + 1]
                    visible_parts(
                        px, py, pz, nx, ny, nz, flat_height, columns, x0, y0, spacing, occluders[led], strips,
                        begin, end, step, parts,
                    )  # fmt: skip
                    base, glossy = _partial_gloss(
                        px, py, pz, nx, ny, nz, camera, strips, begin, end, parts, shares, scale, roughness,
                        eta,
                    )  # fmt: skip
                out[j, i, led, 0] = base
                out[j, i, led, 1] = glossy


def gloss(
    surface: Surface,
    samples: LedSamples,
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
    lattice = surface.lattice
    if reference is None:
        shape = (lattice.rows, lattice.columns)
        changed, out = np.ones(shape, bool), np.zeros((*shape, len(samples.outlines), 2), np.float32)
    else:
        changed, out = surface.changed, reference.copy()
    shares, scale = interface_shares(roughness)
    _gloss(
        surface.positions_mm,
        surface.normals,
        changed,
        surface.height_mm,
        np.float32(lattice.x0_mm),
        np.float32(lattice.y0_mm),
        np.float32(lattice.spacing_mm),
        samples.strips,
        samples.first_strip,
        samples.nodes,
        samples.outlines,
        np.float32(detail.march_step_mm),
        np.asarray(camera_mm, np.float32),
        light.irradiance,
        light.visible,
        shares,
        np.float32(scale),
        np.float32(roughness),
        np.float32(REFRACTIVE_INDEX),
        smooth_stride(lattice.spacing_mm),
        out,
    )
    return out
