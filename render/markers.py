"""The markers on the membrane as the camera sees them: which of them a pixel may show, and how much of it."""

from typing import NamedTuple

import numba
import numpy as np

from gelgap.render.rasterizer import NOWHERE_MM
from gelgap.render.sensor import LARGEST_PITCH_MM, Markers, marker_rest_mm

# Cells of markers that are no grid: by the width of a marker, so that those that touch lose 2 % of their area at
# most, and at most along the longer side.
_CELLS_PER_MARKER, _MOST_CELLS = 16, 1000


class MarkerCells(NamedTuple):
    """The undeformed membrane in cells, each with the only marker that it may show; a missing one is far away.

    The cell of a point is `first` + `per_mm` × (x, y), rounded down. A marker of a grid has one cell, any other many.
    Beyond `reach_mm` from its centre a marker covers nothing.
    """

    centers_mm: np.ndarray  # float32 (rows, columns, 2)
    first: np.ndarray  # float32 (2,)
    per_mm: np.ndarray  # float32 (2,)
    radius_mm: np.float32
    reach_mm: np.float32
    are_squares: bool


def marker_cells(markers: Markers) -> MarkerCells | None:
    """Return the cells of a sensor's markers; None if it has none."""
    rest_mm = marker_rest_mm(markers)
    if np.isnan(rest_mm).all():
        return None
    if markers.positions_mm or markers.layout != "grid":
        centers_mm, first, per_mm = _cells_of_list(rest_mm[~np.isnan(rest_mm[..., 0])], markers)
    else:
        centers_mm = np.nan_to_num(rest_mm, nan=-NOWHERE_MM)
        per_mm = 1 / np.broadcast_to(markers.pitch_mm, 2)
        first = np.array([markers.columns, markers.rows]) / 2 - np.array(markers.offset_mm) * per_mm
    radius_mm = np.float32(markers.diameter_mm / 2)
    reach_mm = radius_mm + np.float32(0.2 * min(markers.spacing_mm, LARGEST_PITCH_MM))
    return MarkerCells(
        centers_mm.astype(np.float32),
        first.astype(np.float32),
        per_mm.astype(np.float32),
        radius_mm,
        reach_mm,
        markers.shape == "square",
    )


def _cells_of_list(points_mm: np.ndarray, markers: Markers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return small cells around markers (n, 2), each with the marker that is nearest to its middle."""
    from scipy.spatial import cKDTree

    low = points_mm.min(0) - markers.diameter_mm
    high = points_mm.max(0) + markers.diameter_mm
    cell_mm = max(markers.diameter_mm / _CELLS_PER_MARKER, (high - low).max() / _MOST_CELLS)
    columns, rows = np.ceil((high - low) / cell_mm).astype(int)
    middles = low + (np.indices((rows, columns))[::-1].transpose(1, 2, 0) + 0.5) * cell_mm
    nearest = cKDTree(points_mm).query(middles, p=markers.norm)[1]
    return points_mm[nearest], -low / cell_mm, np.full(2, 1 / cell_mm)


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _one_more(values, out):
    """Copy (h, w) values to (h + 1, w + 1), continued linearly."""
    out[:-1, :-1] = values
    out[:-1, -1] = out[:-1, -2] + (out[:-1, -2] - out[:-1, -3])
    out[-1] = out[-2] + (out[-2] - out[-3])


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _round_coverage(x, y, x_below, y_below, from_x, from_y, radius, reach, coverage):
    """Fill how much of each pixel of a row the nearest marker covers; `from_x` and `from_y` lead there from its centre.

    Beyond `reach`, as where the next pixel sees no membrane, it covers nothing. Rows of coordinates have one pixel
    more. Without a branch, so that the loop runs in vector registers. A ramp of one pixel at a disc's edge adds π/12 to
    its area, a third at 1 px across: so its disc has r² − 1/12 for r², and below r² = 1/3 it is a cone that is lower.
    """
    half, zero, one, tiny = np.float32(0.5), np.float32(0), np.float32(1), np.float32(1e-9)
    for i in range(len(coverage)):
        away_x, away_y = from_x[i] + np.float32(1e-6), from_y[i]  # the very centre has a direction, too
        along_row = away_x * (x[i + 1] - x[i]) + away_y * (y[i + 1] - y[i])
        along_column = away_x * (x_below[i] - x[i]) + away_y * (y_below[i] - y[i])
        distance = np.sqrt(away_x * away_x + away_y * away_y) + tiny
        per_pixel = distance / (np.sqrt(along_row * along_row + along_column * along_column) + tiny)
        area = (radius * per_pixel) ** 2
        inner2, peak = area - np.float32(1 / 12), np.float32(3) * area
        inner = np.sqrt(inner2 if inner2 > half * half else half * half)
        covered = half + inner - distance * per_pixel if distance < reach else zero
        covered = covered if covered > zero else zero
        coverage[i] = (covered if covered < one else one) * (peak if peak < one else one)


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _square_coverage(x, y, x_below, y_below, from_x, from_y, half_side, reach, coverage):
    """Fill the same for squares along x and y."""
    half, zero, one, tiny = np.float32(0.5), np.float32(0), np.float32(1), np.float32(1e-9)
    for i in range(len(coverage)):
        away_x, away_y = abs(from_x[i]), abs(from_y[i])
        wide = np.sqrt((x[i + 1] - x[i]) ** 2 + (x_below[i] - x[i]) ** 2) + tiny
        high = np.sqrt((y[i + 1] - y[i]) ** 2 + (y_below[i] - y[i]) ** 2) + tiny
        across = max(min(half + (half_side - away_x) / wide, half_side / wide / half, one), zero)
        along = max(min(half + (half_side - away_y) / high, half_side / high / half, one), zero)
        coverage[i] = across * along if max(away_x, away_y) < reach else zero


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def paint_markers(geometry, centers_mm, first, per_mm, radius, reach, square, ratio, out):
    """Multiply the picture by the markers' relative reflectance, anti-aliased by the markers' size in pixels.

    A marker stays within its own cells.
    """
    height, width, _ = geometry.shape
    rows, columns, _ = centers_mm.shape
    zero, one = np.float32(0), np.float32(1)
    last_column, last_row = np.float32(columns - 1), np.float32(rows - 1)
    centers = centers_mm.ravel()
    x, y = np.empty((height + 1, width + 1), np.float32), np.empty((height + 1, width + 1), np.float32)
    _one_more(geometry[:, :, 0], x)
    _one_more(geometry[:, :, 1], y)
    from_x, from_y = np.empty(width, np.float32), np.empty(width, np.float32)
    coverage = np.empty(width, np.float32)
    for j in range(height):
        for i in range(width):
            column = np.int64(min(max(x[j, i] * per_mm[0] + first[0], zero), last_column))
            row = np.int64(min(max(y[j, i] * per_mm[1] + first[1], zero), last_row))
            marker = np.uint64(2 * (row * columns + column))
            from_x[i], from_y[i] = x[j, i] - centers[marker], y[j, i] - centers[marker + np.uint64(1)]
        if square:
            _square_coverage(x[j], y[j], x[j + 1], y[j + 1], from_x, from_y, radius, reach, coverage)
        else:
            _round_coverage(x[j], y[j], x[j + 1], y[j + 1], from_x, from_y, radius, reach, coverage)
        for i in range(width):
            if coverage[i] > zero:
                for k in range(3):
                    out[j, i, k] *= one + coverage[i] * (ratio[k] - one)
