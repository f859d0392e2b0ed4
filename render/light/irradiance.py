"""Irradiance of the membrane under area LEDs with soft shadows: direct light, per LED, so that light adds up.

The visible part of each strip of an LED is integrated by Gauss' rule; no gain is fitted, nothing is random. Points that
see a whole LED need fewer nodes, and points that the contact neither moved nor shadowed keep the undeformed membrane's
light.
"""

from typing import NamedTuple

import numba
import numpy as np

from gelgap.render.light.leds import LedSamples, ShadowDetail
from gelgap.render.light.occlusion import HeightField, find_occluders, may_be_hidden, vertex_at, visible_parts
from gelgap.render.surface import Surface

# Cosine of the tilt below which a vertex counts as nearly flat: 2°.
GENTLE_NORMAL = 0.9994
# The visible share of a partly hidden LED stays below 1, which says that it is in full view.
SHADED = np.float32(0.99999)
# Gauss' rule along the visible part of a strip, in shares of it.
GAUSS_NODES = (np.float32(0.11270167), np.float32(0.5), np.float32(0.88729833))
GAUSS_WEIGHTS = (np.float32(5 / 18), np.float32(8 / 18), np.float32(5 / 18))


class DirectLight(NamedTuple):
    """Direct light on a surface: `irradiance` and `visible` (rows, columns, leds), `parts` (n, strips, 2); float32.

    `irradiance` is per unit radiance of each LED, sr. `visible` is 1 where a vertex sees the whole LED, and else the
    share of the irradiance, or −1 − k where that says nothing about the neighbours: of each strip of this LED
    `parts[k]` is then what the vertex sees, (start, end) in shares of its length.
    """

    irradiance: np.ndarray
    visible: np.ndarray
    parts: np.ndarray


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _open_irradiance(surface, leds, out, lowest):
    """Overwrite out[row, column, led] with the irradiance from each LED in full view where the surface changed.

    There `lowest` becomes the height of the LED's lowest node above the tangent plane. Vertices of a row lie side by
    side, in arrays that cannot overlap, so that loops over them run in vector registers: light takes 0.6 of the time.
    """
    zero = np.float32(0)
    rows, columns = surface.changed.shape
    points, first, normal = leds.nodes
    px, py, pz, nx, ny, nz = np.empty((6, columns), np.float32)
    total, least = np.empty(columns, np.float32), np.empty(columns, np.float32)
    for j in range(rows):
        if not surface.changed[j].any():
            continue
        for i in range(columns):
            px[i], py[i], pz[i] = surface.positions_mm[j, i]
            nx[i], ny[i], nz[i] = surface.normals[j, i]
        for led in range(len(leds.is_point)):
            total[:], least[:] = zero, np.float32(1e9)
            ax, ay, az = normal[led]
            for k in range(first[led], first[led + 1]):
                x, y, z, area = points[:, k]
                for i in range(columns):
                    qx, qy, qz = x - px[i], y - py[i], z - pz[i]
                    r2 = qx * qx + qy * qy + qz * qz
                    front = nx[i] * qx + ny[i] * qy + nz[i] * qz
                    least[i] = front if front < least[i] else least[i]
                    if leds.is_point[led]:
                        total[i] = front / (r2 * np.sqrt(r2))
                    else:
                        away = -(ax * qx + ay * qy + az * qz)
                        total[i] += area * front * (away if away > zero else zero) / (r2 * r2)
            for i in range(columns):
                if surface.changed[j, i]:
                    out[j, i, led], lowest[j, i, led] = total[i], least[i]


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _partial_irradiance(vertex, strips, parts):
    """Return the irradiance from the visible parts of an LED's strips."""
    zero = np.float32(0)
    px, py, pz = vertex.x, vertex.y, vertex.z
    nx, ny, nz = vertex.nx, vertex.ny, vertex.nz
    total = zero
    for k in range(len(strips)):
        strip = strips[k]
        s0, s1 = parts[k, 0], parts[k, 1]
        if s1 <= s0:
            continue
        ax, ay, az = strip.low_x - px, strip.low_y - py, strip.low_z - pz
        if strip.is_point:
            r2 = ax * ax + ay * ay + az * az
            total += max(nx * ax + ny * ay + nz * az, zero) / (r2 * np.sqrt(r2))
            continue
        ex, ey, ez = strip.high_x - strip.low_x, strip.high_y - strip.low_y, strip.high_z - strip.low_z
        part = zero
        for g in range(3):
            w = s0 + (s1 - s0) * GAUSS_NODES[g]
            qx, qy, qz = ax + w * ex, ay + w * ey, az + w * ez
            r2 = qx * qx + qy * qy + qz * qz
            away = -(strip.normal_x * qx + strip.normal_y * qy + strip.normal_z * qz)
            part += GAUSS_WEIGHTS[g] * max(nx * qx + ny * qy + nz * qz, zero) * max(away, zero) / (r2 * r2)
        total += part * (s1 - s0) * strip.area
    return total


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _irradiance(surface, leds, march_step_mm, out, share, known):
    """Overwrite out[row, column, led] (irradiance per unit radiance, sr) where the surface changed or may be shadowed.

    Fill in the visible `share`, 1 at first, and return the visible parts, both as `DirectLight` has them; `known` is
    room for parts.

    Only every fourth vertex surely walks to the horizon; then every second, then all. Vertices are skipped where those
    around them see the whole LED, and, where the surface is nearly flat and so the shadow soft, every second vertex
    gives the others its visible share of the LED: a frame takes 1.4 to 2.6 times as long where all vertices walk.
    """
    zero, one = np.float32(0), np.float32(1)
    rows, columns = surface.changed.shape
    lowest = np.ones_like(out)
    _open_irradiance(surface, leds, out, lowest)
    field = HeightField(surface.height_mm.ravel(), columns, surface.grid)
    occluders = find_occluders(surface, leds.outlines)
    parts_known = 0
    for stride in (4, 2, 1):
        for j in range(0, rows, stride):
            for i in range(0, columns, stride):
                if stride < 4 and i % (2 * stride) == 0 and j % (2 * stride) == 0:
                    continue
                vertex = vertex_at(surface, j, i)
                gentle = vertex.nz < np.float32(-GENTLE_NORMAL)
                west, north = i - i % (2 * stride), j - j % (2 * stride)
                east = min(i + i % (2 * stride), columns - 1)
                south = min(j + j % (2 * stride), rows - 1)
                for led in range(len(leds.is_point)):
                    doubtful = may_be_hidden(vertex, leds.outlines, led, occluders[led])
                    is_above = lowest[j, i, led] > zero
                    if is_above and not doubtful:
                        continue
                    total = out[j, i, led]
                    if stride < 4 and is_above:
                        a, b = share[north, west, led], share[north, east, led]
                        c, d = share[south, west, led], share[south, east, led]
                        least = min(min(a, b), min(c, d))
                        if least == one or (stride == 1 and gentle and least >= zero):
                            share[j, i, led] = np.float32(0.25) * (a + b + c + d)
                            out[j, i, led] = total * share[j, i, led]
                            continue
                    strips = leds.strips[leds.first_strip[led] : leds.first_strip[led + 1]]
                    if parts_known == len(known):
                        known = np.concatenate((known, np.empty_like(known)))
                    parts = known[parts_known]
                    if not visible_parts(vertex, field, occluders[led], strips, march_step_mm, parts):
                        continue
                    out[j, i, led] = _partial_irradiance(vertex, strips, parts)
                    # Behind an LED's face no light arrives that could be shared.
                    if gentle and is_above and total > zero:
                        share[j, i, led] = min(out[j, i, led] / total, SHADED)
                    else:
                        share[j, i, led] = np.float32(-1 - parts_known)
                        parts_known += 1
    return known[:parts_known]


def direct_light(
    surface: Surface, leds: LedSamples, detail: ShadowDetail, reference: np.ndarray | None
) -> DirectLight:
    """Return the light of each LED on the surface.

    Where the contact neither moved the surface nor can shadow it, `reference` (the irradiance of the undeformed
    membrane) is taken; without a reference every vertex is computed.
    """
    if reference is None:
        surface = surface._replace(changed=np.ones_like(surface.changed))
        irradiance = np.zeros((*surface.changed.shape, len(leds.is_point)), np.float32)
    else:
        irradiance = reference.copy()
    visible, room = np.ones_like(irradiance), np.empty((1024, leds.most_strips, 2), np.float32)
    parts = _irradiance(surface, leds, np.float32(detail.march_step_mm), irradiance, visible, room)
    return DirectLight(irradiance, visible, parts)
