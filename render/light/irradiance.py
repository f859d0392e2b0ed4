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


@numba.njit(cache=True, error_model="numpy", fastmath=True, inline="always")
def _open_irradiance(vertex, leds, led):
    """Return the irradiance from an LED in full view, and how far its lowest node is above the tangent plane.

    Nodes lie side by side, and their number is the array's own, so that the loop runs in vector registers.
    """
    zero = np.float32(0)
    px, py, pz = vertex.x, vertex.y, vertex.z
    nx, ny, nz = vertex.nx, vertex.ny, vertex.nz
    node_mm, normal, area_mm2 = leds.nodes
    total, lowest = zero, np.float32(1e9)
    if leds.is_point[led]:
        qx, qy, qz = node_mm[led, 0, 0] - px, node_mm[led, 1, 0] - py, node_mm[led, 2, 0] - pz
        r2 = qx * qx + qy * qy + qz * qz
        lowest = nx * qx + ny * qy + nz * qz
        total = lowest / (r2 * np.sqrt(r2))
    else:
        for k in range(node_mm.shape[2]):
            qx, qy, qz = node_mm[led, 0, k] - px, node_mm[led, 1, k] - py, node_mm[led, 2, k] - pz
            r2 = qx * qx + qy * qy + qz * qz
            front = nx * qx + ny * qy + nz * qz
            away = -(normal[led, 0, k] * qx + normal[led, 1, k] * qy + normal[led, 2, k] * qz)
            lowest = front if front < lowest else lowest
            total += area_mm2[led, k] * front * (away if away > zero else zero) / (r2 * r2)
    return total, lowest


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
        area = strip.area
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
        total += part * (s1 - s0) * area
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
    changed = surface.changed
    rows, columns = changed.shape
    count = len(leds.is_point)
    field = HeightField(surface.height_mm.ravel(), columns, surface.grid)
    occluders = find_occluders(surface, leds.outlines)
    found = 0
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
                for led in range(count):
                    doubtful = may_be_hidden(vertex, leds.outlines, led, occluders[led])
                    if not changed[j, i] and not doubtful:
                        continue
                    total, lowest = out[j, i, led], one
                    if changed[j, i]:
                        total, lowest = _open_irradiance(vertex, leds, led)
                    if lowest > zero and not doubtful:
                        out[j, i, led] = total
                        continue
                    if stride < 4 and lowest > zero:
                        a, b = share[north, west, led], share[north, east, led]
                        c, d = share[south, west, led], share[south, east, led]
                        least = min(min(a, b), min(c, d))
                        if least == one or (stride == 1 and gentle and least >= zero):
                            around = np.float32(0.25) * (a + b + c + d)
                            out[j, i, led] = total * around
                            share[j, i, led] = around
                            continue
                    strips = leds.strips[leds.first_strip[led] : leds.first_strip[led + 1]]
                    if found == len(known):
                        known = np.concatenate((known, np.empty_like(known)))
                    parts = known[found]
                    if not visible_parts(vertex, field, occluders[led], strips, march_step_mm, parts):
                        out[j, i, led] = total
                        continue
                    partial = _partial_irradiance(vertex, strips, parts)
                    out[j, i, led] = partial
                    # Behind an LED's face no light arrives that could be shared.
                    shares = gentle and lowest > zero and total > zero
                    if shares:
                        share[j, i, led] = min(partial / total, SHADED)
                    else:
                        share[j, i, led] = np.float32(-1 - found)
                        found += 1
    return known[:found]


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
