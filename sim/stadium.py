"""A mesh that follows the contact's path: the half disc of `mesh.py`, cut across the path and drawn out along it.

All plane cells are quadrilaterals, which do not lock; a polygon with a fifth corner does, a little. Their size is the
contact's own; layers are thin at the membrane and at the base, where the gel that a wide contact squeezes out shears most.
"""

import math
from dataclasses import dataclass

import numpy as np

from gelgap.sim.mesh import (
    Cells,
    DiscGrid,
    GelMesh,
    Ints,
    Points,
    _cut,
    _split_prisms,
    half_disc,
    ordered_for_elimination,
)
from gelgap.sim.problem import ContactProblem


@dataclass(frozen=True)
class PathMeshSize:
    """How fine a mesh is, by what the contact and the gel give.

    A contact, by the radius at which the indenter cuts the rest membrane, is `across` cells wide, and `sectors` around
    half a circle; beyond it each ring is `ring_growth` wider than the one before. The first layer has `first_layer` of a
    cell's width, each further one is `layer_growth` thicker, up to `largest_layer` of the gel's thickness, and so from the
    base up, from `base_layer` of the thickness.
    """

    across: float
    sectors: int
    ring_growth: float = 1.8
    first_layer: float = 0.55
    layer_growth: float = 1.8
    largest_layer: float = 0.22
    base_layer: float = 0.1


# A contact wider than this many thicknesses of the gel needs no coarser cells: strains at its rim are as wide as the gel
# is thick.
_WIDEST_CONTACT_THICKNESSES = 0.566
_FINE_MARGIN = 1.15  # of the penetration radius
_DISC_THICKNESSES = 3.3
_BESIDE_WIDE_CONTACT_THICKNESSES = 4.0
_LARGEST_CELL = 0.83  # of the thickness
_TOUCHING_MARGIN = 0.3  # of the penetration radius
_MOST_TOUCHING_MARGIN_MM = 0.4


def stadium_mesh(problem: ContactProblem, size: PathMeshSize) -> GelMesh:
    """Mesh the gel around the path of a problem, in the order of elimination."""
    thickness, radius = problem.thickness_mm, max(problem.penetration_radius_mm, 1e-3)
    cell = min(radius, _WIDEST_CONTACT_THICKNESSES * thickness) / size.across
    low, high, aside, direction = straightest(problem.segments_mm[:, :, :2])
    fine_radius = _FINE_MARGIN * radius + aside + cell
    reach = max(_DISC_THICKNESSES * thickness, 1.5 * fine_radius)
    if problem.contact_width > 1:
        reach = max(reach, radius + aside + _BESIDE_WIDE_CONTACT_THICKNESSES * thickness)
    sectors = 4 * round(size.sectors * (radius + aside) / radius / 4)
    grid = DiscGrid(reach, fine_radius, cell, sectors, size.ring_growth, _LARGEST_CELL * thickness)
    plane, quads = half_stadium(grid, low, high)
    cells: Cells = list(quads)
    if not problem.symmetric:
        off_axis = plane[:, 1] > 0
        image = np.where(off_axis, len(plane) + np.cumsum(off_axis) - 1, np.arange(len(plane)))
        plane, cells = np.concatenate([plane, plane[off_axis] * [1, -1]]), [*quads, *image[quads][:, ::-1]]
        cosine, sine = direction
        plane = plane @ np.array([[cosine, sine], [-sine, cosine]])
    if problem.pad_mm is not None:
        x_min, x_max, y_min, y_max = problem.pad_mm
        edges = [(0, 1.0, x_max), (0, -1.0, -x_min), (1, 1.0, y_max)]
        if not problem.symmetric:
            edges.append((1, -1.0, -y_min))
        for axis, sign, distance in edges:
            plane, cells = _cut(plane, cells, axis, sign, distance)
    vertices, tetrahedra = _split_prisms(plane, cells, layers_mm(thickness, size.first_layer * cell, size))
    mesh = GelMesh(vertices, tetrahedra, problem.symmetric)
    return ordered_for_elimination(mesh, touchable(mesh, problem))


def touchable(mesh: GelMesh, problem: ContactProblem) -> Ints:
    """Return the surface vertices that the indenter can touch: near the path, by a margin that the contact's size gives."""
    from gelgap.sim import mesh as present

    radius = problem.penetration_radius_mm
    margin = min(_TOUCHING_MARGIN * radius, _MOST_TOUCHING_MARGIN_MM) - present._TOUCHING_MARGIN_MM
    return present.touchable(mesh, radius + margin, problem.segments_mm[:, :, :2])


def straightest(segments_mm: Points) -> tuple[float, float, float, tuple[float, float]]:
    """Return the straight line through the origin that segments (n, 2, 2) keep nearest to.

    From where to where they go along it, how far they leave it, and its direction (2,).
    """
    points = segments_mm.reshape(-1, 2)
    _, _, axes = np.linalg.svd(points, full_matrices=False) if points.any() else (0, 0, np.eye(2))
    direction = axes[0] * (1.0 if axes[0] @ points.sum(0) >= 0 else -1.0)
    if abs(direction[1]) < 1e-9:
        direction = np.array([1.0, 0.0])
    along, across = points @ direction, points @ np.array([-direction[1], direction[0]])
    return (
        float(min(along.min(), 0)),
        float(max(along.max(), 0)),
        float(np.abs(across).max()),
        tuple(direction),
    )


def half_stadium(grid: DiscGrid, low_mm: float, high_mm: float) -> tuple[Points, Ints]:
    """Return the half y ≥ 0 of a disc whose centre is drawn out from (low, 0) to (high, 0): vertices and quadrilaterals."""
    plane, quads = half_disc(grid)
    length = high_mm - low_mm
    if length <= 1e-9:
        return plane, quads
    columns = max(1, round(length / grid.spacing_mm))
    middle = np.flatnonzero(np.abs(plane[:, 0]) < 1e-9)
    middle = middle[np.argsort(plane[middle, 1])]
    ahead = plane[quads, 0].mean(axis=1) > 0
    count, rows = len(plane), len(middle)
    # Column 0 is the cut's left side; the others are new.
    column = np.concatenate([middle[None], count + np.arange(columns * rows).reshape(columns, rows)])
    moved = np.arange(count)
    moved[middle] = column[-1]
    quads = quads.copy()
    quads[ahead] = moved[quads[ahead]]
    between = np.stack([column[:-1, :-1], column[1:, :-1], column[1:, 1:], column[:-1, 1:]], -1).reshape(
        -1, 4
    )
    shifted = plane.copy()
    shifted[:, 0] += np.where(plane[:, 0] > 1e-9, high_mm, low_mm)
    x = np.repeat(low_mm + length * np.arange(1, columns + 1) / columns, rows)
    new = np.column_stack([x, np.tile(plane[middle, 1], columns)])
    return np.concatenate([shifted, new]), np.concatenate([quads, between])


def layers_mm(thickness_mm: float, first_mm: float, size: PathMeshSize) -> Points:
    """Return the z of the layers from the membrane (0) down to the base: they thicken from both, up to a largest.

    What is too much in the end is taken most from the thick ones.
    """
    largest = size.largest_layer * thickness_mm
    upper, lower = [min(first_mm, largest)], [min(size.base_layer * thickness_mm, largest)]
    while sum(upper) + sum(lower) < thickness_mm - 1e-9:
        grow = upper if upper[-1] <= lower[-1] else lower
        grow.append(min(grow[-1] * size.layer_growth, largest))
    thick = np.array([*upper, *lower[::-1]])
    thick -= (thick.sum() - thickness_mm) * thick**2 / (thick**2).sum()
    return -np.concatenate([[0.0], np.cumsum(thick)])
