"""Irradiance of the membrane under area LEDs with soft shadows: direct light, per LED, so that light adds up.

An LED is cut into strips across its level axis. Of a strip, a point of the membrane sees what lies above its own
tangent plane and above its horizon, the steepest slope that the deformed height field shows on the way. The
visible part is integrated by Gauss' rule; no gain is fitted, nothing is random. Points that see a whole LED need fewer
nodes, and points that the contact neither moved nor shadowed keep the undeformed membrane's light.
"""

from dataclasses import dataclass
from itertools import chain, product
from math import ceil

import numba
import numpy as np

from gelgap.render.illumination import Emitter
from gelgap.render.surface import Surface

# A horizon below this slope is not looked for: an LED's light from there is negligible.
SMALLEST_SLOPE = 0.01
OPEN_NODES = (8, 2)
# Cosine of the tilt below which a vertex counts as nearly flat: 2°.
GENTLE_NORMAL = 0.9994
# The visible share of a partly hidden LED stays below 1, which says that it is in full view.
SHADED = np.float32(0.99999)

# Where the surface is nearly flat, light in full view is computed this far apart and interpolated: within one code
# value at standard quality (of gloss: from a roughness of 0.2 on).
SMOOTH_MM = 0.4


@dataclass(frozen=True)
class ShadowDetail:
    """How finely partly hidden LEDs are sampled."""

    strip_width_mm: float
    fewest_strips: int
    march_step_mm: float


@dataclass(frozen=True)
class LedSamples:
    """LEDs cut up for integration; float32. LED k owns strips first_strip[k] to first_strip[k + 1].

    Strips are (low end, high end, normal, area): 10 columns; an area of 0 marks a point light of intensity 1 mm².
    Nodes, for LEDs in full view, are (leds, 7, n): position, normal, weight.
    Outlines are (left end, right end, lowest height).
    """

    strips: np.ndarray
    first_strip: np.ndarray
    nodes: np.ndarray
    outlines: np.ndarray


def _slices(emitter: Emitter, count: int) -> list[tuple[float, float, float]]:
    """Return (place, weight, chord) of slices along the level axis, in units of its half length.

    A disc takes Chebyshev's nodes, whose rule holds the chord √(1 − s²), so that its area comes out exactly.
    """
    if emitter.kind == "disc":
        angles = np.arange(1, count + 1) * np.pi / (count + 1)
        return [(float(np.cos(a)), float(np.pi / (count + 1) * np.sin(a)), float(np.sin(a))) for a in angles]
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return [(float(node), float(weight), 1.0) for node, weight in zip(nodes, weights, strict=True)]


def _strips(emitter: Emitter, detail: ShadowDetail) -> list[np.ndarray]:
    if emitter.kind == "point":
        return [np.concatenate([emitter.center_mm, emitter.center_mm, emitter.normal, [0.0]])]
    length_mm = 2 * np.linalg.norm(emitter.half_u_mm)
    count = max(ceil(length_mm / detail.strip_width_mm), detail.fewest_strips)
    rows = []
    for place, weight, chord in _slices(emitter, count):
        center = emitter.center_mm + place * emitter.half_u_mm
        half = chord * emitter.half_v_mm
        area = weight * length_mm / 2 * 2 * np.linalg.norm(half)
        rows.append(np.concatenate([center - half, center + half, emitter.normal, [area]]))
    return rows


def _open_nodes(emitter: Emitter) -> np.ndarray:
    """Return (7, n): position, normal and weight of every node; a point has one, with weight 0, and −1 for the rest."""
    nodes = np.zeros((OPEN_NODES[0] * OPEN_NODES[1], 7))
    nodes[:, :3], nodes[:, 3:6] = emitter.center_mm, emitter.normal
    if emitter.kind == "point":
        nodes[1:, 6] = -1
        return nodes.T
    across = list(zip(*np.polynomial.legendre.leggauss(OPEN_NODES[1]), strict=True))
    slices = _slices(emitter, OPEN_NODES[0])
    for row, ((place, weight, chord), (other, other_weight)) in zip(
        nodes, product(slices, across), strict=True
    ):
        half = chord * emitter.half_v_mm
        row[:3] += place * emitter.half_u_mm + other * half
        row[6] = weight * np.linalg.norm(emitter.half_u_mm) * other_weight * np.linalg.norm(half)
    return nodes.T


def led_samples(emitters: tuple[Emitter, ...], detail: ShadowDetail) -> LedSamples:
    """Cut every emitter into strips, for where it is partly hidden, and into nodes, for where it is in full view."""
    strips = [_strips(emitter, detail) for emitter in emitters]
    outlines = []
    for emitter in emitters:
        ends = [emitter.center_mm - emitter.half_u_mm, emitter.center_mm + emitter.half_u_mm]
        lowest_mm = -emitter.center_mm[2] - abs(emitter.half_u_mm[2]) - abs(emitter.half_v_mm[2])
        outlines.append([*ends[0][:2], *ends[1][:2], lowest_mm])
    return LedSamples(
        strips=np.array(list(chain.from_iterable(strips)), np.float32),
        first_strip=np.cumsum([0] + [len(rows) for rows in strips]).astype(np.int32),
        nodes=np.array([_open_nodes(emitter) for emitter in emitters], np.float32),
        outlines=np.array(outlines, np.float32),
    )


def smooth_stride(spacing_mm: float) -> int:
    """Return how many vertices lie between those for which light in full view is computed on nearly flat places."""
    return max(round(SMOOTH_MM / spacing_mm), 1)


@dataclass(frozen=True)
class Light:
    """Direct light on a surface, both (rows, columns, leds) float32.

    `irradiance` is per unit radiance of each LED, sr; `visible` is 1 where a vertex sees the whole LED, and below 1
    (negative where the share is not known) where it does not.
    """

    irradiance: np.ndarray
    visible: np.ndarray


@numba.njit(cache=True, fastmath=True)
def occluders_of(height, x0, y0, spacing, outlines, out):
    """Fill out[led] with what can hide an LED: x and y bounds, centre, radius, top.

    At the horizon a ray touches the surface, so the surface there is as steep as the ray. Only what is steeper than the
    lowest ray that can reach the LED from anywhere on the lattice matters.
    """
    rows, columns = height.shape
    half = np.float32(0.5) / spacing
    top = np.float32(0)
    for j in range(rows):
        for i in range(columns):
            top = max(top, height[j, i])
    x1, y1 = x0 + spacing * np.float32(columns - 1), y0 + spacing * np.float32(rows - 1)
    for led in range(len(outlines)):
        mx = np.float32(0.5) * (outlines[led, 0] + outlines[led, 2])
        my = np.float32(0.5) * (outlines[led, 1] + outlines[led, 3])
        ux, uy = mx - outlines[led, 0], my - outlines[led, 1]
        fx, fy = max(abs(mx - x0), abs(mx - x1)), max(abs(my - y0), abs(my - y1))
        farthest = np.sqrt(fx * fx + fy * fy) + np.sqrt(ux * ux + uy * uy)
        least = max(np.float32(0.9) * (outlines[led, 4] - top) / farthest, np.float32(SMALLEST_SLOPE))
        i0, i1, j0, j1 = columns, -1, rows, -1
        peak = np.float32(0)
        # Two cells from the edge, so that a walk within the bounds never leaves the lattice.
        for j in range(2, rows - 2):
            for i in range(2, columns - 2):
                gx = (height[j, i + 1] - height[j, i - 1]) * half
                gy = (height[j + 1, i] - height[j - 1, i]) * half
                if gx * gx + gy * gy > least * least:
                    i0, i1, j0, j1 = min(i0, i), max(i1, i), min(j0, j), max(j1, j)
                    peak = max(peak, height[j, i])
        out[led, 0] = x0 + spacing * np.float32(i0 - 1)
        out[led, 1] = x0 + spacing * np.float32(i1 + 1)
        out[led, 2] = y0 + spacing * np.float32(j0 - 1)
        out[led, 3] = y0 + spacing * np.float32(j1 + 1)
        cx, cy = np.float32(0.5) * (out[led, 0] + out[led, 1]), np.float32(0.5) * (out[led, 2] + out[led, 3])
        radius2 = np.float32(0)
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                gx = (height[j, i + 1] - height[j, i - 1]) * half
                gy = (height[j + 1, i] - height[j - 1, i]) * half
                if gx * gx + gy * gy > least * least:
                    dx, dy = x0 + spacing * np.float32(i) - cx, y0 + spacing * np.float32(j) - cy
                    radius2 = max(radius2, dx * dx + dy * dy)
        out[led, 4], out[led, 5] = cx, cy
        out[led, 6] = np.sqrt(radius2) + spacing if i1 >= i0 else np.float32(-1)
        out[led, 7] = peak + spacing * least


@numba.njit(cache=True, fastmath=True, inline="always")
def may_be_hidden(px, py, own, outline, occluder):
    """Return whether the occluder's disc can stand between a point and an LED: a quick, conservative test."""
    zero = np.float32(0)
    radius = occluder[6]
    if radius < zero or occluder[7] <= own:
        return False
    cx, cy = occluder[4] - px, occluder[5] - py
    ax, ay = outline[0] - px, outline[1] - py
    bx, by = outline[2] - px, outline[3] - py
    if ax * by - ay * bx < zero:
        ax, ay, bx, by = bx, by, ax, ay
    distance2 = cx * cx + cy * cy
    if distance2 <= radius * radius:
        return True
    # beside the wedge that the LED spans, or behind
    a_side, b_side = ax * cy - ay * cx, bx * cy - by * cx
    a2, b2 = ax * ax + ay * ay, bx * bx + by * by
    if a_side < zero and a_side * a_side > radius * radius * a2:
        return False
    if b_side > zero and b_side * b_side > radius * radius * b2:
        return False
    along = cx * (ax + bx) + cy * (ay + by)
    if along < zero and along * along > radius * radius * ((ax + bx) ** 2 + (ay + by) ** 2):
        return False
    # over its top
    near = np.sqrt(distance2) - radius
    lowest = outline[4] - own
    return not (lowest > zero and (occluder[7] - own) ** 2 * max(a2, b2) < lowest * lowest * near * near)


@numba.njit(cache=True, fastmath=True, inline="always")
def _height_at(height, columns, u, v):
    """Bilinear height at lattice coordinates (u, v), which must lie inside the lattice; `height` is flat."""
    i, j = np.int64(u), np.int64(v)
    fu, fv = u - np.float32(i), v - np.float32(j)
    at = np.uint64(j * columns + i)
    below = np.uint64(j * columns + i + columns)
    one = np.uint64(1)
    upper = height[at] + (height[at + one] - height[at]) * fu
    lower = height[below] + (height[below + one] - height[below]) * fu
    return upper + (lower - upper) * fv


@numba.njit(cache=True, fastmath=True)
def _steepest(height, columns, u, v, du, dv, own, t_in, t_out, steps):
    """Return the greatest (height − own)/t on lattice coordinates (u, v) + t (du, dv), t in [t_in, t_out]."""
    half = np.float32(0.5)
    step = (t_out - t_in) / np.float32(steps)
    best_rise, best_t = np.float32(-1e9), np.float32(1)
    t = t_in + half * step
    for _ in range(steps):
        rise = _height_at(height, columns, u + t * du, v + t * dv) - own
        if rise * best_t > best_rise * t:
            best_rise, best_t = rise, t
        t += step
    for _ in range(2):
        step *= half
        center = best_t
        for side in range(2):
            t = min(max(center + (step if side else -step), t_in), t_out)
            rise = _height_at(height, columns, u + t * du, v + t * dv) - own
            if rise * best_t > best_rise * t:
                best_rise, best_t = rise, t
    return best_rise / best_t


@numba.njit(cache=True, fastmath=True, inline="always")
def _open_irradiance(px, py, pz, nx, ny, nz, nodes, led):
    """Return the irradiance from an LED in full view, and how far its lowest node is above the tangent plane.

    Nodes lie side by side, and their number is the array's own, so that the loop runs in vector registers.
    """
    zero = np.float32(0)
    total, lowest = zero, np.float32(1e9)
    if nodes[led, 6, 0] == zero:
        qx, qy, qz = nodes[led, 0, 0] - px, nodes[led, 1, 0] - py, nodes[led, 2, 0] - pz
        r2 = qx * qx + qy * qy + qz * qz
        lowest = nx * qx + ny * qy + nz * qz
        total = lowest / (r2 * np.sqrt(r2))
    else:
        for k in range(nodes.shape[2]):
            qx, qy, qz = nodes[led, 0, k] - px, nodes[led, 1, k] - py, nodes[led, 2, k] - pz
            r2 = qx * qx + qy * qy + qz * qz
            front = nx * qx + ny * qy + nz * qz
            away = -(nodes[led, 3, k] * qx + nodes[led, 4, k] * qy + nodes[led, 5, k] * qz)
            lowest = front if front < lowest else lowest
            total += nodes[led, 6, k] * front * (away if away > zero else zero) / (r2 * r2)
    return total, lowest


@numba.njit(cache=True, fastmath=True)
def visible_parts(
    px, py, pz, nx, ny, nz, height, columns, x0, y0, spacing, occluder, strips, begin, end, step, parts
):
    """Fill parts[k] with the visible interval of each strip; return whether anything is hidden."""
    zero, one, half, tiny = np.float32(0), np.float32(1), np.float32(0.5), np.float32(1e-6)
    inverse_spacing = one / spacing
    own = -pz
    u, v = (px - x0) * inverse_spacing, (py - y0) * inverse_spacing
    hidden = False
    for k in range(begin, end):
        ax, ay, az = strips[k, 0] - px, strips[k, 1] - py, strips[k, 2] - pz
        bx, by, bz = strips[k, 3] - px, strips[k, 4] - py, strips[k, 5] - pz
        s0, s1 = zero, one
        # above the tangent plane
        front_a, front_b = nx * ax + ny * ay + nz * az, nx * bx + ny * by + nz * bz
        if front_a < zero or front_b < zero:
            if front_a <= zero and front_b <= zero:
                s1 = zero
            elif front_a < zero:
                s0 = front_a / (front_a - front_b)
            else:
                s1 = front_a / (front_a - front_b)
        if s1 > s0:
            # above the horizon: only what lies within the occluder's bounds is walked over
            mx, my = half * (ax + bx), half * (ay + by)
            ix = one / (mx if abs(mx) > tiny else tiny)
            iy = one / (my if abs(my) > tiny else tiny)
            ta, tb = (occluder[0] - px) * ix, (occluder[1] - px) * ix
            tc, td = (occluder[2] - py) * iy, (occluder[3] - py) * iy
            distance = np.sqrt(mx * mx + my * my) + tiny
            t_in = max(max(min(ta, tb), min(tc, td)), spacing / distance)
            t_out = min(min(max(ta, tb), max(tc, td)), one)
            lowest = -(az + s0 * (bz - az))
            if lowest > zero:
                t_out = min(t_out, (occluder[7] - own) / lowest)
            if t_in < t_out:
                steps = np.int32((t_out - t_in) * distance / step) + 2
                du, dv = mx * inverse_spacing, my * inverse_spacing
                slope = _steepest(height, columns, u, v, du, dv, own, t_in, t_out, steps)
                above_a = -az - slope * np.sqrt(ax * ax + ay * ay) / distance
                above_b = -bz - slope * np.sqrt(bx * bx + by * by) / distance
                if above_a <= zero and above_b <= zero:
                    s1 = zero
                elif above_a < zero:
                    s0 = max(s0, above_a / (above_a - above_b))
                elif above_b < zero:
                    s1 = min(s1, above_a / (above_a - above_b))
        parts[k - begin, 0], parts[k - begin, 1] = s0, s1
        hidden |= s0 > zero or s1 < one
    return hidden


@numba.njit(cache=True, fastmath=True)
def _partial_irradiance(px, py, pz, nx, ny, nz, strips, begin, end, parts):
    """Return the irradiance from the visible intervals of an LED's strips."""
    zero = np.float32(0)
    gauss = (np.float32(0.11270167), np.float32(0.5), np.float32(0.88729833))
    weight = (np.float32(5 / 18), np.float32(8 / 18), np.float32(5 / 18))
    total = zero
    for k in range(begin, end):
        s0, s1 = parts[k - begin, 0], parts[k - begin, 1]
        if s1 <= s0:
            continue
        ax, ay, az = strips[k, 0] - px, strips[k, 1] - py, strips[k, 2] - pz
        if strips[k, 9] == 0:
            r2 = ax * ax + ay * ay + az * az
            total += max(nx * ax + ny * ay + nz * az, zero) / (r2 * np.sqrt(r2))
            continue
        ex, ey, ez = strips[k, 3] - strips[k, 0], strips[k, 4] - strips[k, 1], strips[k, 5] - strips[k, 2]
        part = zero
        for g in range(3):
            w = s0 + (s1 - s0) * gauss[g]
            qx, qy, qz = ax + w * ex, ay + w * ey, az + w * ez
            r2 = qx * qx + qy * qy + qz * qz
            away = -(strips[k, 6] * qx + strips[k, 7] * qy + strips[k, 8] * qz)
            part += weight[g] * max(nx * qx + ny * qy + nz * qz, zero) * max(away, zero) / (r2 * r2)
        total += part * (s1 - s0) * strips[k, 9]
    return total


@numba.njit(cache=True, fastmath=True)
def _coarse_irradiance(positions, normals, changed, nodes, reference, apart, smooth, ratio):
    """Fill ratio[row, column, led]: light in full view over the undeformed membrane's, for every apart-th vertex.

    `smooth` says where that may be interpolated: where the surface is nearly flat and sees the whole front of the LED.
    """
    zero, one = np.float32(0), np.float32(1)
    rows, columns, leds = smooth.shape
    for row in range(rows):
        for column in range(columns):
            j, i = row * apart, column * apart
            px, py, pz = positions[j, i, 0], positions[j, i, 1], positions[j, i, 2]
            nx, ny, nz = normals[j, i, 0], normals[j, i, 1], normals[j, i, 2]
            gentle = nz < np.float32(-GENTLE_NORMAL)
            for led in range(leds):
                before, total, lowest = reference[j, i, led], one, one
                smooth[row, column, led] = False
                if not gentle or before <= zero:
                    continue
                ratio[row, column, led] = one
                if changed[j, i]:
                    total, lowest = _open_irradiance(px, py, pz, nx, ny, nz, nodes, led)
                    ratio[row, column, led] = total / before
                smooth[row, column, led] = lowest > zero


@numba.njit(cache=True, fastmath=True)
def _irradiance(
    positions,
    normals,
    changed,
    height,
    x0,
    y0,
    spacing,
    strips,
    first_strip,
    nodes,
    outlines,
    step,
    apart,
    out,
    share,
):
    """Overwrite out[row, column, led] (irradiance per unit radiance, sr) where the surface changed or may be shadowed.

    Only every fourth vertex surely walks to the horizon; then every second, then all. Vertices are skipped where those
    around them see the whole LED, and, where the surface is nearly flat and so the shadow soft, every second vertex
    gives the others its visible share of the LED. Light in full view, too, is interpolated where the surface is nearly
    flat: as the ratio to what `out` holds at first, the undeformed membrane's, for every apart-th vertex (0: never).
    """
    zero, one = np.float32(0), np.float32(1)
    rows, columns, _ = positions.shape
    leds = len(outlines)
    flat_height = height.ravel()
    occluders = np.empty((leds, 8), np.float32)
    occluders_of(height, x0, y0, spacing, outlines, occluders)
    parts = np.empty((len(strips), 2), np.float32)
    # The visible share of each LED; negative where it says nothing about the neighbours.
    share[:] = one
    cell = max(apart, 1)
    smooth = np.zeros(((rows - 1) // cell + 1, (columns - 1) // cell + 1, leds), np.bool_)
    ratio = np.empty(smooth.shape, np.float32)
    if apart > 0:
        _coarse_irradiance(positions, normals, changed, nodes, out, apart, smooth, ratio)
    inverse_cell = one / np.float32(cell)
    for stride in (4, 2, 1):
        for j in range(0, rows, stride):
            for i in range(0, columns, stride):
                if stride < 4 and i % (2 * stride) == 0 and j % (2 * stride) == 0:
                    continue
                px, py, pz = positions[j, i, 0], positions[j, i, 1], positions[j, i, 2]
                nx, ny, nz = normals[j, i, 0], normals[j, i, 1], normals[j, i, 2]
                gentle = nz < np.float32(-GENTLE_NORMAL)
                west, north = i - i % (2 * stride), j - j % (2 * stride)
                east = min(i + i % (2 * stride), columns - 1)
                south = min(j + j % (2 * stride), rows - 1)
                row, column = min(j // cell, smooth.shape[0] - 2), min(i // cell, smooth.shape[1] - 2)
                fu = np.float32(i - column * cell) * inverse_cell
                fv = np.float32(j - row * cell) * inverse_cell
                within = gentle and changed[j, i] and fu <= one and fv <= one
                for led in range(leds):
                    doubtful = may_be_hidden(px, py, -pz, outlines[led], occluders[led])
                    if not changed[j, i] and not doubtful:
                        continue
                    total, lowest = out[j, i, led], one
                    if (
                        within
                        and smooth[row, column, led]
                        and smooth[row, column + 1, led]
                        and smooth[row + 1, column, led]
                        and smooth[row + 1, column + 1, led]
                    ):
                        upper = ratio[row, column, led]
                        upper += (ratio[row, column + 1, led] - upper) * fu
                        lower = ratio[row + 1, column, led]
                        lower += (ratio[row + 1, column + 1, led] - lower) * fu
                        total *= upper + (lower - upper) * fv
                    elif changed[j, i]:
                        total, lowest = _open_irradiance(px, py, pz, nx, ny, nz, nodes, led)
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
                    begin, end = first_strip[led], first_strip[led + 1]
                    hidden = visible_parts(
                        px, py, pz, nx, ny, nz, flat_height, columns, x0, y0, spacing, occluders[led], strips,
                        begin, end, step, parts,
                    )  # fmt: skip
                    if hidden:
                        partial = _partial_irradiance(px, py, pz, nx, ny, nz, strips, begin, end, parts)
                        out[j, i, led] = partial
                        share[j, i, led] = min(partial / total, SHADED) if gentle and lowest > zero else -one
                    else:
                        out[j, i, led] = total


def direct_light(
    surface: Surface, samples: LedSamples, detail: ShadowDetail, reference: np.ndarray | None
) -> Light:
    """Return the light of each LED on the surface.

    Where the contact neither moved the surface nor can shadow it, `reference` (the irradiance of the undeformed
    membrane) is taken; without a reference every vertex is computed.
    """
    lattice = surface.lattice
    if reference is None:
        shape = (lattice.rows, lattice.columns)
        changed, out = np.ones(shape, bool), np.zeros((*shape, len(samples.outlines)), np.float32)
    else:
        changed, out = surface.changed, reference.copy()
    visible = np.empty_like(out)
    _irradiance(
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
        0 if reference is None else smooth_stride(lattice.spacing_mm),
        out,
        visible,
    )
    return Light(out, visible)
