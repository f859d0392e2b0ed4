"""What a deformed membrane hides of an LED from one of its own points: the tangent plane and the horizon.

Of each strip of an LED a point sees what lies above its own tangent plane and above its horizon, the steepest slope
that the deformed height field shows on the way to the strip.
"""

from typing import NamedTuple

import numba
import numpy as np

from gelgap.render.surface import Grid

# A horizon below this slope is not looked for: an LED's light from there is negligible.
SMALLEST_SLOPE = 0.01
# The part of the membrane that can hide an LED: its bounds in mm, the disc around them and its greatest height.
# Where nothing is steep enough to hide the LED, `exists` is false and the bounds are reversed.
OCCLUDER = np.dtype(
    [("exists", np.bool_)]
    + [
        (name, np.float32)
        for name in ("x_low", "x_high", "y_low", "y_high", "center_x", "center_y", "radius", "top")
    ],
    align=True,
)


class Vertex(NamedTuple):
    """A point of the membrane in mm, and its unit normal towards the camera."""

    x: float
    y: float
    z: float
    nx: float
    ny: float
    nz: float


class HeightField(NamedTuple):
    """Heights of a surface above the points of a grid, row after row."""

    height_mm: np.ndarray  # (rows * columns,)
    columns: int
    grid: Grid


class Ray(NamedTuple):
    """A horizontal ray in cells of a height field: (u, v) + t (du, dv); slopes are those of heights above `height`."""

    u: float
    v: float
    du: float
    dv: float
    height: float


@numba.njit(cache=True, error_model="numpy", fastmath=True, inline="always")
def vertex_at(surface, row, column):
    """Return a vertex of a `Surface`."""
    position, normal = surface.positions_mm[row, column], surface.normals[row, column]
    return Vertex(position[0], position[1], position[2], normal[0], normal[1], normal[2])


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _smallest_slope(surface, top, outlines, led):
    """Return the slope of the lowest ray that can reach an LED from a grid whose greatest height is `top`."""
    grid = surface.grid
    rows, columns = surface.height_mm.shape
    x0, y0, spacing = grid.x0_mm, grid.y0_mm, grid.spacing_mm
    x1, y1 = x0 + spacing * np.float32(columns - 1), y0 + spacing * np.float32(rows - 1)
    left, right = outlines.left_mm[led], outlines.right_mm[led]
    mx, my = np.float32(0.5) * (left[0] + right[0]), np.float32(0.5) * (left[1] + right[1])
    ux, uy = mx - left[0], my - left[1]
    fx, fy = max(abs(mx - x0), abs(mx - x1)), max(abs(my - y0), abs(my - y1))
    farthest = np.sqrt(fx * fx + fy * fy) + np.sqrt(ux * ux + uy * uy)
    return max(np.float32(0.9) * (outlines.lowest_mm[led] - top) / farthest, np.float32(SMALLEST_SLOPE))


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _find_occluder(surface, least, occluder):
    """Fill in what can hide an LED that no ray below the slope `least` can reach.

    At the horizon a ray touches the surface, so the surface there is as steep as the ray. Only what is steeper than the
    lowest ray matters.
    """
    height, grid = surface.height_mm, surface.grid
    x0, y0, spacing = grid.x0_mm, grid.y0_mm, grid.spacing_mm
    rows, columns = height.shape
    half = np.float32(0.5) / spacing
    i0, i1, j0, j1 = columns, -1, rows, -1
    peak = np.float32(0)
    # Two cells from the edge, so that a walk within the bounds never leaves the grid.
    for j in range(2, rows - 2):
        for i in range(2, columns - 2):
            gx = (height[j, i + 1] - height[j, i - 1]) * half
            gy = (height[j + 1, i] - height[j - 1, i]) * half
            if gx * gx + gy * gy > least * least:
                i0, i1, j0, j1 = min(i0, i), max(i1, i), min(j0, j), max(j1, j)
                peak = max(peak, height[j, i])
    occluder.exists = i1 >= i0
    occluder.x_low, occluder.x_high = x0 + spacing * np.float32(i0 - 1), x0 + spacing * np.float32(i1 + 1)
    occluder.y_low, occluder.y_high = y0 + spacing * np.float32(j0 - 1), y0 + spacing * np.float32(j1 + 1)
    cx = np.float32(0.5) * (occluder.x_low + occluder.x_high)
    cy = np.float32(0.5) * (occluder.y_low + occluder.y_high)
    radius2 = np.float32(0)
    for j in range(j0, j1 + 1):
        for i in range(i0, i1 + 1):
            gx = (height[j, i + 1] - height[j, i - 1]) * half
            gy = (height[j + 1, i] - height[j - 1, i]) * half
            if gx * gx + gy * gy > least * least:
                dx, dy = x0 + spacing * np.float32(i) - cx, y0 + spacing * np.float32(j) - cy
                radius2 = max(radius2, dx * dx + dy * dy)
    occluder.center_x, occluder.center_y = cx, cy
    occluder.radius, occluder.top = np.sqrt(radius2) + spacing, peak + spacing * least


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def find_occluders(surface, outlines):
    """Return what can hide each LED, as an array of `OCCLUDER`."""
    height = surface.height_mm
    top = np.float32(0)
    for j in range(height.shape[0]):
        for i in range(height.shape[1]):
            top = max(top, height[j, i])
    occluders = np.empty(len(outlines.lowest_mm), OCCLUDER)
    for led in range(len(occluders)):
        _find_occluder(surface, _smallest_slope(surface, top, outlines, led), occluders[led])
    return occluders


@numba.njit(cache=True, error_model="numpy", fastmath=True, inline="always")
def may_be_hidden(vertex, outlines, led, occluder):
    """Return whether the occluder's disc can stand between a vertex and an LED: a quick, conservative test."""
    zero = np.float32(0)
    own_height = -vertex.z
    if not occluder.exists or occluder.top <= own_height:
        return False
    radius = occluder.radius
    cx, cy = occluder.center_x - vertex.x, occluder.center_y - vertex.y
    ax, ay = outlines.left_mm[led, 0] - vertex.x, outlines.left_mm[led, 1] - vertex.y
    bx, by = outlines.right_mm[led, 0] - vertex.x, outlines.right_mm[led, 1] - vertex.y
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
    lowest = outlines.lowest_mm[led] - own_height
    return not (
        lowest > zero and (occluder.top - own_height) ** 2 * max(a2, b2) < lowest * lowest * near * near
    )


@numba.njit(cache=True, error_model="numpy", fastmath=True, inline="always")
def _height_at(field, u, v):
    """Return the bilinear height at coordinates (u, v) in cells, which must lie inside the grid."""
    height, columns = field.height_mm, field.columns
    i, j = np.int32(u), np.int32(v)
    fu, fv = u - np.float32(i), v - np.float32(j)
    at = np.uint64(np.int64(j) * columns + np.int64(i))
    below = at + np.uint64(columns)
    one = np.uint64(1)
    upper = height[at] + (height[at + one] - height[at]) * fu
    lower = height[below] + (height[below + one] - height[below]) * fu
    return upper + (lower - upper) * fv


@numba.njit(cache=True, error_model="numpy", fastmath=True, inline="always")
def _steepest(field, ray, t_in, t_out, steps, enough):
    """Return the steepest slope, in mm per unit of t, from a ray's start up to the field at t in [t_in, t_out].

    The first slope that is `enough` will do.
    """
    half = np.float32(0.5)
    step = (t_out - t_in) / np.float32(steps)
    best_rise, best_t = np.float32(-1e9), np.float32(1)
    t = t_in + half * step
    for _ in range(steps):
        rise = _height_at(field, ray.u + t * ray.du, ray.v + t * ray.dv) - ray.height
        if rise * best_t > best_rise * t:
            best_rise, best_t = rise, t
            if rise >= enough * t:
                return rise / t
        t += step
    for _ in range(2):
        step *= half
        center = best_t
        for side in range(2):
            t = min(max(center + (step if side else -step), t_in), t_out)
            rise = _height_at(field, ray.u + t * ray.du, ray.v + t * ray.dv) - ray.height
            if rise * best_t > best_rise * t:
                best_rise, best_t = rise, t
    return best_rise / best_t


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def visible_parts(vertex, field, occluder, strips, step_mm, parts):
    """Fill the (start, end) in `parts` of what a vertex sees of an LED's strips, 0…1 from low to high.

    Return whether anything is hidden.
    """
    zero, one, half, tiny = np.float32(0), np.float32(1), np.float32(0.5), np.float32(1e-6)
    grid = field.grid
    inverse_spacing = one / grid.spacing_mm
    own_height = -vertex.z
    px, py, pz = vertex.x, vertex.y, vertex.z
    nx, ny, nz = vertex.nx, vertex.ny, vertex.nz
    u, v = (px - grid.x0_mm) * inverse_spacing, (py - grid.y0_mm) * inverse_spacing
    hidden = False
    for k in range(len(strips)):
        strip = strips[k]
        ax, ay, az = strip.low_x - px, strip.low_y - py, strip.low_z - pz
        bx, by, bz = strip.high_x - px, strip.high_y - py, strip.high_z - pz
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
            ta, tb = (occluder.x_low - px) * ix, (occluder.x_high - px) * ix
            tc, td = (occluder.y_low - py) * iy, (occluder.y_high - py) * iy
            distance = np.sqrt(mx * mx + my * my) + tiny
            t_in = max(max(min(ta, tb), min(tc, td)), grid.spacing_mm / distance)
            t_out = min(min(max(ta, tb), max(tc, td)), one)
            lowest = -(az + s0 * (bz - az))
            if lowest > zero:
                t_out = min(t_out, (occluder.top - own_height) / lowest)
            if t_in < t_out:
                steps = np.int32((t_out - t_in) * distance / step_mm) + 2
                ray = Ray(u, v, mx * inverse_spacing, my * inverse_spacing, own_height)
                far_a, far_b = np.sqrt(ax * ax + ay * ay) / distance, np.sqrt(bx * bx + by * by) / distance
                slope = _steepest(field, ray, t_in, t_out, steps, max(-az / far_a, -bz / far_b))
                above_a, above_b = -az - slope * far_a, -bz - slope * far_b
                if above_a <= zero and above_b <= zero:
                    s1 = zero
                elif above_a < zero:
                    s0 = max(s0, above_a / (above_a - above_b))
                elif above_b < zero:
                    s1 = min(s1, above_a / (above_a - above_b))
        parts[k, 0], parts[k, 1] = s0, s1
        hidden |= s0 > zero or s1 < one
    return hidden
