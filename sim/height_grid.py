"""Heights of an underside on a grid: from triangles, with rounded edges, and the signed distance from them."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import grey_dilation

from gelgap.sim.indenter import Floats

# A mesh is looked at this many times as finely as it is kept; where it is steeper, the lower side of a place counts.
_FINER = 3
_STEEP = 2.0


def lower_side_mm(triangles_mm: Floats, half_mm: tuple[float, float], spacing_mm: float) -> Floats:
    """Return the lowest heights (rows, columns) of triangles (n, 3, 3) over a grid with the axis in its middle.

    It reaches at least as far as `half_mm` along x and y; nothing is infinitely high.
    """
    columns, rows = (2 * math.ceil(half / spacing_mm) + 1 for half in half_mm)
    fine_mm, margin = spacing_mm / _FINER, _FINER // 2
    lowest = np.full((rows * _FINER, columns * _FINER), np.inf)
    start = np.array([columns // 2, rows // 2]) * spacing_mm + margin * fine_mm
    scaled = np.array(triangles_mm)
    scaled[:, :, :2] = (scaled[:, :, :2] + start) / fine_mm
    _lower_envelope(scaled, lowest)
    blocks = lowest.reshape(rows, _FINER, columns, _FINER).transpose(0, 2, 1, 3).reshape(rows, columns, -1)
    least, middle = blocks.min(axis=2), blocks[:, :, blocks.shape[2] // 2]
    with np.errstate(invalid="ignore"):
        is_steep = blocks.max(axis=2) - least > _STEEP * spacing_mm
    # A wall stands next to the last place that is solid, so on average at its own.
    return np.where(is_steep, least, middle)


def rolled_mm(heights_mm: Floats, radius_mm: float, spacing_mm: float) -> Floats:
    """Return heights of an underside after a ball has rolled inside of it, and then outside.

    What the ball cannot reach inside, edges and corners, goes; what it cannot reach outside, creases, is filled.
    """
    reach = int(radius_mm / spacing_mm)
    if reach < 1:
        return heights_mm
    x = np.arange(-reach, reach + 1) * spacing_mm
    square = radius_mm**2 - (x[:, None] ** 2 + x**2)
    inside, ball = square >= 0, np.sqrt(np.maximum(square, 0.0))
    # Beyond the grid there is nothing.
    heights = np.pad(heights_mm, 2 * reach, constant_values=np.inf)
    for sign in (1, -1, -1, 1):
        # The highest sum of values around a place and a ball's height there.
        heights = sign * grey_dilation(
            sign * heights, footprint=inside, structure=ball, mode="constant", cval=-np.inf
        )
    return heights[2 * reach : -2 * reach, 2 * reach : -2 * reach]


@njit(cache=True)
def _lower_envelope(triangles: Floats, lowest: Floats) -> None:
    """Lower `lowest` (rows, columns) to triangles (n, 3, 3) over it, whose x and y are in columns and rows."""
    rows, columns = lowest.shape
    for k in range(len(triangles)):
        x, y, z = triangles[k, :, 0], triangles[k, :, 1], triangles[k, :, 2]
        area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
        if abs(area) < 1e-9:
            continue
        for row in range(max(0, math.ceil(y.min() - 1e-6)), min(rows, math.floor(y.max() + 1e-6) + 1)):
            for column in range(
                max(0, math.ceil(x.min() - 1e-6)), min(columns, math.floor(x.max() + 1e-6) + 1)
            ):
                second = ((column - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (row - y[0])) / area
                third = ((x[1] - x[0]) * (row - y[0]) - (column - x[0]) * (y[1] - y[0])) / area
                if second > -1e-6 and third > -1e-6 and second + third < 1 + 1e-6:
                    height = z[0] + second * (z[1] - z[0]) + third * (z[2] - z[0])
                    if height < lowest[row, column]:
                        lowest[row, column] = height


@njit(cache=True)
def signed_distance(
    heights: Floats, low: float, levels: int, outside: float, inside: float
) -> NDArray[np.float32]:
    """Return the distance (rows, columns, levels) from the triangles between heights, in grid spacings as all here.

    The first level lies at `low`, heights are finite. Above the surface the distance is negative. It is exact up to
    `outside` and `inside`, and not larger.
    """
    rows, columns = heights.shape
    found = np.empty((rows, columns, levels), np.float32)
    reach = math.ceil(max(outside, inside))
    for i in range(rows):
        for j in range(columns):
            around = heights[max(0, i - reach) : i + reach + 1, max(0, j - reach) : j + reach + 1]
            lowest, highest = around.min(), around.max()
            for k in range(levels):
                z = low + k
                is_inside = z >= heights[i, j]
                best = inside if is_inside else outside
                if lowest - best < z < highest + best:
                    best = _nearest(heights, i, j, z, best)
                found[i, j, k] = -best if is_inside else best
    return found


@njit(cache=True)
def _nearest(heights: Floats, i: int, j: int, z: float, best: float) -> float:
    """Return how near to place i, j and height z the surface is, or `best` if that is less."""
    rows, columns = heights.shape
    ring = 0
    while ring < best:
        for a in range(max(0, i - 1 - ring), min(rows - 1, i + ring + 1)):
            on_end = a == i - 1 - ring or a == i + ring
            step = 1 if on_end else 2 * ring + 1
            for b in range(j - 1 - ring, j + ring + 1, step):
                if b < 0 or b >= columns - 1:
                    continue
                p, q, r, s = heights[a, b], heights[a, b + 1], heights[a + 1, b], heights[a + 1, b + 1]
                away = max(min(p, q, r, s) - z, z - max(p, q, r, s), 0.0)
                if away >= best:
                    continue
                y, x = float(a - i), float(b - j)
                best = min(best, _from_triangle(x, y, p - z, x + 1, y, q - z, x, y + 1, r - z))
                best = min(best, _from_triangle(x + 1, y + 1, s - z, x + 1, y, q - z, x, y + 1, r - z))
        ring += 1
    return best


@njit(cache=True)
def _from_triangle(ax, ay, az, bx, by, bz, cx, cy, cz):
    """Return how far the origin is from the triangle a, b, c (Ericson 2005, Real-Time Collision Detection, 5.1.5)."""
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - ax, cy - ay, cz - az
    d1, d2 = -(ux * ax + uy * ay + uz * az), -(vx * ax + vy * ay + vz * az)
    d3, d4 = -(ux * bx + uy * by + uz * bz), -(vx * bx + vy * by + vz * bz)
    d5, d6 = -(ux * cx + uy * cy + uz * cz), -(vx * cx + vy * cy + vz * cz)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0 and d2 <= 0:
        s, t = 0.0, 0.0
    elif d3 >= 0 and d4 <= d3:
        s, t = 1.0, 0.0
    elif vc <= 0 <= d1 and d3 <= 0:
        s, t = d1 / (d1 - d3), 0.0
    elif d6 >= 0 and d5 <= d6:
        s, t = 0.0, 1.0
    elif vb <= 0 <= d2 and d6 <= 0:
        s, t = 0.0, d2 / (d2 - d6)
    elif va <= 0 and d4 >= d3 and d5 >= d6:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        s = 1 - t
    else:
        s, t = vb / (va + vb + vc), vc / (va + vb + vc)
    x, y, z = ax + s * ux + t * vx, ay + s * uy + t * vy, az + s * uz + t * vz
    return math.sqrt(x * x + y * y + z * z)


@njit(cache=True)
def interpolated(field: NDArray[np.float32], places: Floats) -> tuple[Floats, Floats]:
    """Return values (n,) and gradients (n, 3) of a field on a grid at places (n, 3) within, by quadratic B-splines.

    They average the field a little, so that kinks become smooth and no wiggles come in.
    """
    values, gradients = np.zeros(len(places)), np.zeros((len(places), 3))
    weight, slope = np.empty((3, 3)), np.empty((3, 3))
    first = np.empty(3, np.int64)
    for n in range(len(places)):
        for axis in range(3):
            nearest = min(max(round(places[n, axis]), 1), field.shape[axis] - 2)
            t = places[n, axis] - nearest
            first[axis] = nearest - 1
            weight[axis, 0], weight[axis, 1], weight[axis, 2] = (
                0.5 * (0.5 - t) ** 2,
                0.75 - t * t,
                0.5 * (0.5 + t) ** 2,
            )
            slope[axis, 0], slope[axis, 1], slope[axis, 2] = t - 0.5, -2 * t, t + 0.5
        for a in range(3):
            for b in range(3):
                for c in range(3):
                    value = field[first[0] + a, first[1] + b, first[2] + c]
                    values[n] += weight[0, a] * weight[1, b] * weight[2, c] * value
                    gradients[n, 0] += slope[0, a] * weight[1, b] * weight[2, c] * value
                    gradients[n, 1] += weight[0, a] * slope[1, b] * weight[2, c] * value
                    gradients[n, 2] += weight[0, a] * weight[1, b] * slope[2, c] * value
    return values, gradients
