"""Plane cells around the contact axis: half a disc, its mirror image, and cuts along a pad's edges."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Corners of each plane cell, counterclockwise.
Cells = Sequence[NDArray[np.int64]]
Points = NDArray[np.float64]

# A vertex that an edge of the pad misses by less than this share of a cell is moved onto it.
_SNAPPED_SHARE = 0.35


@dataclass(frozen=True)
class DiscGrid:
    """How a disc is divided: a square core of cells, then rings that coarsen beyond `fine_radius_mm`.

    `spacing_mm` is the distance of the vertices up to there, `sectors` the number of cells around half a circle, a
    multiple of 4; each coarser ring is `ring_growth` wider than the one before.
    """

    radius_mm: float
    fine_radius_mm: float
    spacing_mm: float
    sectors: int
    ring_growth: float = 1.5


def half_disc(grid: DiscGrid) -> tuple[Points, NDArray[np.int64]]:
    """Return the vertices (n, 2) and quadrilaterals (m, 4) of the half y ≥ 0 of a disc."""
    core_cells = grid.sectors // 4
    core_mm = 1.1 * core_cells * grid.spacing_mm
    rings = core_mm + graded_positions_mm(
        grid.radius_mm - core_mm, grid.spacing_mm, grid.fine_radius_mm - core_mm, grid.ring_growth
    )
    return _core_and_rings(core_cells, core_mm, rings[1:])


def graded_positions_mm(
    length_mm: float, spacing_mm: float, fine_mm: float, growth: float, largest_mm: float = 2.5
) -> Points:
    """Return positions from 0 to a length: equally spaced up to `fine_mm`, each further spacing `growth` times larger.

    No spacing exceeds `largest_mm`, until all beyond `fine_mm` are stretched so that the last position is the length.
    """
    if length_mm <= 0:
        return np.zeros(1)
    positions, step = [0.0], spacing_mm
    while positions[-1] < length_mm - 1e-9:
        if positions[-1] >= fine_mm - 1e-9:
            step = min(step * growth, largest_mm)
        positions.append(positions[-1] + step)
    axis = np.array(positions)
    start = int(np.searchsorted(axis, fine_mm - 1e-9))
    if start >= len(axis) - 1:
        return axis * (length_mm / axis[-1])
    axis[start:] = axis[start] + (axis[start:] - axis[start]) * (length_mm - axis[start]) / (
        axis[-1] - axis[start]
    )
    return axis


def mirrored(plane: Points, cells: NDArray[np.int64]) -> tuple[Points, list[NDArray[np.int64]]]:
    """Add the mirror image in y = 0 of a half plane's cells."""
    off_axis = plane[:, 1] > 0
    image = np.where(off_axis, len(plane) + np.cumsum(off_axis) - 1, np.arange(len(plane)))
    return np.concatenate([plane, plane[off_axis] * [1, -1]]), [*cells, *image[cells][:, ::-1]]


def cut(
    plane: Points, cells: Cells, axis: int, sign: float, distance_mm: float
) -> tuple[Points, list[NDArray[np.int64]]]:
    """Cut away what lies beyond the line sign · coordinate = distance, once vertices near it are moved onto it."""
    plane = _snapped(plane, cells, axis, sign, distance_mm)
    beyond = sign * plane[:, axis] - distance_mm
    points, crossing, kept = list(plane), {}, []
    for cell in cells:
        if (beyond[cell] >= 0).all():
            continue
        corners = []
        for a, b in zip(cell, np.roll(cell, -1), strict=True):
            if beyond[a] <= 0:
                corners.append(a)
            if beyond[a] * beyond[b] < 0:
                edge = (min(a, b), max(a, b))
                if edge not in crossing:
                    share = beyond[a] / (beyond[a] - beyond[b])
                    point = plane[a] + share * (plane[b] - plane[a])
                    point[axis] = sign * distance_mm
                    crossing[edge] = len(points)
                    points.append(point)
                corners.append(crossing[edge])
        kept.append(np.array(corners))
    used = np.unique(np.concatenate(kept))
    number = np.full(len(points), -1)
    number[used] = np.arange(len(used))
    return np.array(points)[used], [number[cell] for cell in kept]


def _snapped(plane: Points, cells: Cells, axis: int, sign: float, distance_mm: float) -> Points:
    """Move vertices onto the line where it would cut off only a small share of an edge."""
    start = np.concatenate(cells)
    end = np.concatenate([np.roll(cell, -1) for cell in cells])
    beyond = sign * plane[:, axis] - distance_mm
    crosses = beyond[start] * beyond[end] < 0
    start, end = start[crosses], end[crosses]
    share = beyond[start] / (beyond[start] - beyond[end])
    moved = np.concatenate([start[share < _SNAPPED_SHARE], end[share > 1 - _SNAPPED_SHARE]])
    plane = plane.copy()
    plane[moved, axis] = sign * distance_mm
    return plane


def _core_and_rings(core_cells: int, core_mm: float, rings_mm: Points) -> tuple[Points, NDArray[np.int64]]:
    """Mesh half a disc by 2k × k core cells, bent from a square towards a circle, then rings of 4k cells."""
    k = core_cells
    u, v = np.meshgrid(np.linspace(-1, 1, 2 * k + 1), np.linspace(0, 1, k + 1), indexing="ij")
    shell = np.maximum(np.abs(u), np.abs(v))
    scale = np.where(shell > 0, shell, 1.0)
    u1, v1 = u / scale, v / scale
    on_side = np.abs(u1) >= np.abs(v1) - 1e-12
    angle = np.where(on_side, np.where(u1 > 0, v1, 4 - v1), 2 - u1) * np.pi / 4
    square = 0.85 * core_mm * np.stack([u, v], -1)
    circle = core_mm * shell[..., None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    roundness = 0.35 * shell[..., None]
    core = ((1 - roundness) * square + roundness * circle).reshape(-1, 2)
    index = np.arange(len(core)).reshape(2 * k + 1, k + 1)
    quads = [np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], -1).reshape(-1, 4)]
    edge = np.concatenate([index[2 * k, :k], index[::-1, k], index[0, k - 1 :: -1]])
    turn = np.linspace(0, np.pi, len(edge))
    points = [core]
    inner = edge
    for ring, radius in enumerate(rings_mm):
        outer = len(core) + ring * len(edge) + np.arange(len(edge))
        points.append(radius * np.stack([np.cos(turn), np.sin(turn)], -1))
        quads.append(np.stack([inner[:-1], outer[:-1], outer[1:], inner[1:]], -1))
        inner = outer
    plane = np.concatenate(points)
    plane[np.abs(plane) < 1e-12] = 0.0
    return plane, np.concatenate(quads)
