"""A pad's mesh: layers of prisms on plane cells, split into tetrahedra that do not lock."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.mesh.plane import Cells, DiscGrid, Points, cut, graded_positions_mm, half_disc, mirrored
from gelgap.sim.problem import PadEdges


@dataclass(frozen=True)
class GelMesh:
    """Tetrahedra of a pad: the outer membrane at z = 0, the bonded bottom at z = −thickness, contact axis at x = y = 0.

    `vertices_mm` is (n, 3), `tetrahedra` (m, 4). If `symmetric`, only y ≥ 0 is meshed and y = 0 is a plane of symmetry.
    """

    vertices_mm: NDArray[np.float64]
    tetrahedra: NDArray[np.int32]
    symmetric: bool

    @property
    def surface(self) -> NDArray[np.int64]:
        """Indices of the vertices of the outer membrane."""
        return np.flatnonzero(self.vertices_mm[:, 2] > -1e-9)

    @property
    def bottom(self) -> NDArray[np.int64]:
        """Indices of the vertices that are bonded to the backing."""
        return np.flatnonzero(self.vertices_mm[:, 2] < self.vertices_mm[:, 2].min() + 1e-9)

    @property
    def symmetry_plane(self) -> NDArray[np.int64]:
        """Indices of the vertices on the plane of symmetry, none for a whole pad."""
        if not self.symmetric:
            return np.empty(0, dtype=np.int64)
        return np.flatnonzero(np.abs(self.vertices_mm[:, 1]) < 1e-9)


def pad_mesh(grid: DiscGrid, layers_mm: Points, pad_mm: PadEdges | None, *, symmetric: bool) -> GelMesh:
    """Mesh the part of the pad that lies within a disc around the contact axis.

    `layers_mm` are the z of the layers from 0 down; `pad_mm` is (x min, x max, y min, y max), on whose edges the axis
    may lie, or None for a pad without edges. If the scene is `symmetric` about y = 0, only y ≥ 0 is meshed.
    """
    plane, quads = half_disc(grid)
    plane, cells = (plane, list(quads)) if symmetric else mirrored(plane, quads)
    if pad_mm is not None:
        x_min, x_max, y_min, y_max = pad_mm
        edges = [(0, 1.0, x_max), (0, -1.0, -x_min), (1, 1.0, y_max)]
        if not symmetric:
            edges.append((1, -1.0, -y_min))
        for axis, sign, distance in edges:
            plane, cells = cut(plane, cells, axis, sign, distance)
    vertices, tetrahedra = _split_prisms(plane, cells, layers_mm)
    return GelMesh(vertices, tetrahedra, symmetric)


def layer_heights_mm(thickness_mm: float, first_mm: float, growth: float) -> Points:
    """Return the z of the layers from the membrane (0) down to the backing: the first, then thicker with depth.

    All are scaled down a little so that their number is whole.
    """
    return -graded_positions_mm(
        thickness_mm, first_mm / growth, 0.0, growth, largest_mm=max(first_mm, 0.28 * thickness_mm)
    )


def _split_prisms(plane: Points, cells: Cells, layers_mm: Points) -> tuple[Points, NDArray[np.int32]]:
    """Stack layers of prisms on plane cells and split each; return vertices (n, 3) and tetrahedra (m, 4).

    A prism gets a vertex in its centre and one in the centre of each face: 24 tetrahedra if it is a hexahedron.
    """
    count, levels = len(plane), len(layers_mm)
    start = np.concatenate(cells)
    end = np.concatenate([np.roll(cell, -1) for cell in cells])
    cell = np.repeat(np.arange(len(cells)), [len(corners) for corners in cells])
    sides, side = np.unique(np.sort(np.stack([start, end], 1), axis=1), axis=0, return_inverse=True)
    centre = np.stack([np.bincount(cell, plane[start, axis]) / np.bincount(cell) for axis in (0, 1)], 1)
    middle = 0.5 * (layers_mm[:-1] + layers_mm[1:])
    blocks = [
        (plane, layers_mm),
        (centre, layers_mm),
        (plane[sides].mean(axis=1), middle),
        (centre, middle),
    ]
    vertices = np.concatenate(
        [np.column_stack([np.tile(xy, (len(z), 1)), np.repeat(z, len(xy))]) for xy, z in blocks]
    )
    first = np.cumsum([0, *(len(xy) * len(z) for xy, z in blocks)])
    tetrahedra = []
    for level in range(levels - 1):
        a, b = level * count + start, level * count + end
        below_a, below_b = a + count, b + count
        top = first[1] + level * len(cells) + cell
        face = first[2] + level * len(sides) + side.ravel()
        body = first[3] + level * len(cells) + cell
        tetrahedra += [
            np.stack(corners, axis=1)
            for corners in (
                (b, a, top, body),
                (below_a, below_b, top + len(cells), body),
                (a, b, face, body),
                (b, below_b, face, body),
                (below_b, below_a, face, body),
                (below_a, a, face, body),
            )
        ]
    return vertices, np.concatenate(tetrahedra).astype(np.int32)
