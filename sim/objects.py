"""Everyday objects made by code, by the heights of what each shows to the gel, and several bodies as one."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.indenter import Floats, Indenter
from gelgap.sim.surface import Surface, grid_under

Place = tuple[float, float, float]
_SPACING_MM = 0.04
_HALF_MM = 3.6
_RELIEF_MM, _DEEPEST_MM = 0.8, 1.0
# From so far away, the points of a body nearest to points all around it are spread over all of it.
_FAR_MM = 1e3
_ROUNDINGS = ("edge_radius_mm", "tip_radius_mm", "radius_mm")
# Creases of several bodies are filled by a ball of this radius at most.
_LARGEST_FILL_MM = 0.2
# Letters by the corners of their strokes in a box of 1 × 1, y down.
_LETTERS = {
    "G": [[(0.9, 0.1), (0.1, 0.1), (0.1, 0.9), (0.9, 0.9), (0.9, 0.5), (0.5, 0.5)]],
    "E": [[(0.9, 0.1), (0.1, 0.1), (0.1, 0.9), (0.9, 0.9)], [(0.1, 0.5), (0.7, 0.5)]],
    "L": [[(0.1, 0.1), (0.1, 0.9), (0.9, 0.9)]],
}


def object_surface(name: str, edge_radius_mm: float = 0.2, **fields: Any) -> Surface:
    """Return an object of that name as a body; its relief, or at least 1 mm of it, can be pressed in."""
    count = round(_HALF_MM / _SPACING_MM)
    place = np.arange(-count, count + 1) * _SPACING_MM
    heights_mm = OBJECTS[name](*np.meshgrid(place, place))
    relief_mm = float(np.ptp(heights_mm[np.isfinite(heights_mm)]))
    fields |= {"height_mm": 2 * max(relief_mm, _DEEPEST_MM), "edge_radius_mm": edge_radius_mm}
    return Surface.of(heights_mm, _SPACING_MM, **fields)


def sum_surface(parts: Sequence[tuple[Indenter, Place]], **fields: Any) -> Surface:
    """Return bodies as one, each with its place (x, y, z): of its axis, and how high its lowest point is.

    It is pressed no deeper than the part that is first at its own limit. Fields are those of `Surface`; without
    `edge_radius_mm` a ball of 0.2 mm, or of the sharpest part's radius, fills creases. ValueError if the bodies are
    further apart than the largest surface is wide, or thinner than its rounding.
    """
    lowest_mm = min(z for _, (_, _, z) in parts)
    triangles_mm, deepest_mm = [], np.inf
    for body, (x, y, z) in parts:
        vertices, triangles = surface_mesh_mm(body)
        place = [x, y, z - lowest_mm + body.origin_height_mm]
        triangles_mm.append((vertices + place)[triangles])
        deepest_mm = min(deepest_mm, z - lowest_mm + body.deepest_mm)
    heights_mm, spacing_mm = grid_under(np.concatenate(triangles_mm))
    radii_mm = [getattr(body, name) for body, _ in parts for name in _ROUNDINGS if hasattr(body, name)]
    fields = {"edge_radius_mm": min([_LARGEST_FILL_MM, *radii_mm]), **fields}
    return Surface.of(heights_mm, spacing_mm, height_mm=round(2 * deepest_mm, 9), **fields)


def surface_mesh_mm(body: Indenter, subdivisions: int = 5) -> tuple[Floats, NDArray[np.int64]]:
    """Return vertices (n, 3) and triangles (m, 3) of a body around its origin: all of it if it is convex.

    Then it is the hull of what is nearest to points far around it, of which there are 10 · 4^subdivisions + 2.
    """
    from trimesh.convex import convex_hull
    from trimesh.creation import icosphere

    if isinstance(body, Surface):
        return body.mesh_mm
    around = np.array(icosphere(subdivisions, _FAR_MM).vertices)
    hull = convex_hull(body.project(around).points_mm)
    return np.array(hull.vertices), np.array(hull.faces)


def _solid(inside: NDArray[np.bool_]) -> Floats:
    """Return a relief whose faces are `inside`, on a plate a relief's height further up."""
    return np.where(inside, 0.0, _RELIEF_MM)


def _balls(
    x: Floats, y: Floats, centres: list[tuple[float, float]], radius_mm: float, cap_mm: float
) -> Floats:
    """Return balls that stand out of a plate by `cap_mm`."""
    height = np.full(x.shape, cap_mm)
    for u, v in centres:
        square = (x - u) ** 2 + (y - v) ** 2
        ball = radius_mm - np.sqrt(np.maximum(radius_mm**2 - square, 0.0))
        height = np.minimum(height, np.where(square < radius_mm**2, ball, cap_mm))
    return height


def _hexagon(x: Floats, y: Floats) -> Floats:
    turns = np.radians([0, 60, 120])
    return np.max([np.abs(x * np.cos(turn) + y * np.sin(turn)) for turn in turns], axis=0)


def _stroke(x: Floats, y: Floats, start: tuple[float, float], end: tuple[float, float]) -> Floats:
    """Return how far places are from a line between two points."""
    (x0, y0), (x1, y1) = start, end
    along = np.clip(((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / ((x1 - x0) ** 2 + (y1 - y0) ** 2), 0, 1)
    return np.hypot(x - x0 - along * (x1 - x0), y - y0 - along * (y1 - y0))


def _ring(x: Floats, y: Floats) -> Floats:
    off = np.hypot(x, y) - 2.4
    return np.where(np.abs(off) < 0.8, 0.8 - np.sqrt(np.maximum(0.64 - off**2, 0)), np.inf)


def _key(x: Floats, y: Floats) -> Floats:
    """Return the bitting of a key that lies on its side."""
    depth = np.interp(
        x,
        [-3, -2.4, -1.8, -1.2, -0.6, 0, 0.6, 1.2, 1.8, 2.4],
        [0.9, 0.2, 0.2, 1.0, 1.0, 0.4, 0.4, 1.2, 1.2, 0.3],
    )
    inside = (np.abs(x) < 3.0) & (y > -2.2) & (y < depth)
    return np.where(inside, np.where(np.abs(y + 0.7) < 0.3, 0.4, 0.0), np.inf)


def _coin(x: Floats, y: Floats) -> Floats:
    radius, square = np.hypot(x, y), np.maximum(np.abs(x), np.abs(y))
    height = np.where(
        (radius > 2.7) | (_stroke(x, y, (-1.2, 0.9), (1.2, 0.9)) < 0.3) | (square < 0.7), 0.0, 0.3
    )
    return np.where(radius < 3.3, height, np.inf)


def _screw(x: Floats, y: Floats) -> Floats:
    """Return a round head with a cross in it."""
    cross = np.minimum(np.abs(x), np.abs(y)) < 0.4
    radius = np.hypot(x, y)
    dome = 9.0 - np.sqrt(np.maximum(81.0 - radius**2, 0.0))
    return np.where(radius < 2.8, np.where(cross & (radius < 1.8), dome + 0.8, dome), np.inf)


def _lattice(x: Floats, y: Floats) -> Floats:
    """Return wires of 0.8 mm, 1.8 mm apart, that cross."""
    wires = [0.4 - np.sqrt(np.maximum(0.16 - ((c + 0.9) % 1.8 - 0.9) ** 2, 0.0)) for c in (x, y)]
    return np.minimum(wires[0], wires[1] + 0.1)


def _letters(x: Floats, y: Floats) -> Floats:
    inside = np.zeros(x.shape, dtype=bool)
    for place, letter in enumerate("GEL"):
        u, v = (x + 3.4) / 2.1 - 1.1 * place, (y + 1.8) / 3.6
        for corners in _LETTERS[letter]:
            for start, end in pairwise(corners):
                inside |= _stroke(u, v, start, end) < 0.13
    return _solid(inside)


OBJECTS: dict[str, Callable[[Floats, Floats], Floats]] = {
    "ring": _ring,
    "two-balls": lambda x, y: _balls(x, y, [(-1.4, 0.0), (1.4, 0.0)], 1.3, 1.2),
    "nut": lambda x, y: np.where((_hexagon(x, y) < 2.7) & (np.hypot(x, y) > 1.5), 0.0, np.inf),
    "key": _key,
    "knurl": lambda x, y: 0.25 * (2 - np.cos(np.pi * (x + y) / 1.1) - np.cos(np.pi * (x - y) / 1.1)),
    "coin": _coin,
    "screw": _screw,
    "braille": lambda x, y: _balls(x, y, [(-1.25, -2.3), (-1.25, 0.0), (1.25, 0.0), (-1.25, 2.3)], 0.9, 0.5),
    "step": lambda x, y: _solid(x < 0),
    "corner": lambda x, y: _solid((x < 0) & (y < 0)),
    "lattice": _lattice,
    "letters": _letters,
}
