"""Layers of prisms around a contact axis, cut off at the pad's edges, and split into tetrahedra that do not lock."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Corners of each plane cell, counterclockwise.
Cells = Sequence[NDArray[np.int64]]

# A vertex that a pad's edge misses by less than this share of a cell is moved onto it.
_SNAP = 0.35


@dataclass(frozen=True)
class GelMesh:
    """Tetrahedra of a pad: the outer membrane at z = 0, the bonded bottom at z = −thickness, contact axis at x = y = 0.

    `half` says that only y ≥ 0 is meshed and that y = 0 is a plane of symmetry.
    """

    vertices_mm: NDArray[np.float64]
    tetrahedra: NDArray[np.int32]
    half: bool

    @property
    def surface(self) -> NDArray[np.int64]:
        """Indices of the vertices of the outer membrane."""
        return np.flatnonzero(self.vertices_mm[:, 2] > -1e-9)

    @property
    def bottom(self) -> NDArray[np.int64]:
        return np.flatnonzero(self.vertices_mm[:, 2] < self.vertices_mm[:, 2].min() + 1e-9)

    @property
    def symmetry_plane(self) -> NDArray[np.int64]:
        """Indices of the vertices on the plane of symmetry, none for a whole pad."""
        if not self.half:
            return np.empty(0, dtype=np.int64)
        return np.flatnonzero(np.abs(self.vertices_mm[:, 1]) < 1e-9)


def ordered_for_elimination(mesh: GelMesh, contact_mm: float, ways_mm: NDArray[np.float64]) -> GelMesh:
    """Renumber the vertices so that MuJoCo's sparse Cholesky factor fills little and is cheap to update.

    MuJoCo eliminates from the last vertex to the first, and an update of the factor for a contact takes as long as
    there are vertices that depend on the contact's. So surface vertices within `contact_mm` of where the indenter goes,
    the straight `ways_mm` (n, 2, 2) in the plane, are numbered first, the nearest at the front; the rest follow in
    reverse order of elimination, the bonded ones at the end.
    """
    from scipy import sparse

    from gelgap.sim.elimination import elimination_order

    vertices, tetrahedra = mesh.vertices_mm, mesh.tetrahedra
    count = len(vertices)
    pairs = sparse.coo_array(
        (
            np.ones(16 * len(tetrahedra)),
            (np.repeat(tetrahedra, 4, axis=1).ravel(), np.tile(tetrahedra, 4).ravel()),
        ),
        shape=(count, count),
    ).tocsr()
    place = np.full(count, 1)
    distance = _distance_to_ways(vertices[:, :2], ways_mm)
    place[mesh.surface[distance[mesh.surface] <= contact_mm]] = 0
    place[mesh.bottom] = 2
    moving = np.flatnonzero(place < 2)
    touched = np.flatnonzero(place[moving] == 0)
    last = touched[np.argsort(-distance[moving][touched], kind="stable")]
    elimination = elimination_order(pairs[moving][:, moving], vertices[moving], last=last)
    order = np.concatenate([moving[elimination[::-1]], np.flatnonzero(place == 2)])
    number = np.empty(count, dtype=np.int32)
    number[order] = np.arange(count, dtype=np.int32)
    return GelMesh(vertices_mm=vertices[order], tetrahedra=number[tetrahedra], half=mesh.half)


def _distance_to_ways(points_mm: NDArray[np.float64], ways_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far each point (k, 2) is from the nearest of the straight ways (n, 2, 2), from start to end."""
    distance = np.full(len(points_mm), np.inf)
    for start, end in ways_mm:
        along = end - start
        share = np.clip((points_mm - start) @ along / max(along @ along, 1e-12), 0, 1)
        distance = np.minimum(distance, np.linalg.norm(points_mm - start - share[:, None] * along, axis=1))
    return distance


def half_disc_mesh(
    radius_mm: float,
    fine_radius_mm: float,
    spacing_mm: float,
    layers_mm: NDArray[np.float64],
    sectors: int,
    ring_growth: float = 1.5,
) -> GelMesh:
    """Mesh half a disc, y ≥ 0: a square core of cells, then rings that coarsen beyond `fine_radius_mm`.

    `sectors` is the number of cells around the half circle, a multiple of 4; `layers_mm` the z of the layers from 0
    down; the coarser rings are each `ring_growth` wider than the one before.
    """
    plane, quads = _half_disc(radius_mm, fine_radius_mm, spacing_mm, sectors, ring_growth)
    return _crossed(plane, tuple(quads), layers_mm, half=True)


def pad_mesh(
    pad_mm: tuple[float, float, float, float],
    radius_mm: float,
    fine_radius_mm: float,
    spacing_mm: float,
    layers_mm: NDArray[np.float64],
    sectors: int,
    *,
    half: bool,
    ring_growth: float = 1.5,
) -> GelMesh:
    """Mesh the part of the pad (x min, x max, y min, y max) within `radius_mm` of the axis: a disc cut at the edges.

    The axis may lie on an edge of the pad. `sectors` is the number of cells around half a circle; of a pad that is
    symmetric to y = 0, `half` meshes y ≥ 0 alone. Beyond `fine_radius_mm` each ring is `ring_growth` wider than the one
    before.
    """
    x_min, x_max, y_min, y_max = pad_mm
    plane, quads = _half_disc(radius_mm, fine_radius_mm, spacing_mm, sectors, ring_growth)
    cells = list(quads)
    edges = [(0, 1.0, x_max), (0, -1.0, -x_min), (1, 1.0, y_max)]
    if not half:
        plane, cells = _mirrored(plane, quads)
        edges.append((1, -1.0, -y_min))
    for axis, sign, distance in edges:
        plane, cells = _cut(plane, cells, axis, sign, distance)
    return _crossed(plane, cells, layers_mm, half=half)


def graded_spacings(
    length_mm: float, spacing_mm: float, fine_mm: float, growth: float = 1.5, largest_mm: float = 2.5
) -> NDArray[np.float64]:
    """Return positions from 0 to `length_mm`: equal up to `fine_mm`, then growing by `growth` a cell."""
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


def layer_depths(thickness_mm: float, first_mm: float, growth: float) -> NDArray[np.float64]:
    """Return the z of the layers from the membrane (0) down to the backing: the first, then thicker with depth.

    All are scaled down a little so that their number is whole.
    """
    return -graded_spacings(
        thickness_mm, first_mm / growth, 0.0, growth, largest_mm=max(first_mm, 0.28 * thickness_mm)
    )


def _butterfly(
    core_cells: int, core_mm: float, rings_mm: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Half a disc of quadrilaterals: 2k × k core cells, bent from a square towards a circle, then rings of 4k cells."""
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


def half_disc_hexahedra(
    radius_mm: float, fine_radius_mm: float, spacing_mm: float, layers_mm: NDArray[np.float64], sectors: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the nodes (n, 3) and hexahedra (m, 8) that `half_disc_mesh` splits."""
    plane, quads = _half_disc(radius_mm, fine_radius_mm, spacing_mm, sectors)
    points = np.concatenate([np.column_stack([plane, np.full(len(plane), z)]) for z in layers_mm])
    hexes = [
        np.concatenate([quads + (layer + 1) * len(plane), quads + layer * len(plane)], axis=1)
        for layer in range(len(layers_mm) - 1)
    ]
    return points, np.concatenate(hexes)


def _half_disc(
    radius_mm: float, fine_radius_mm: float, spacing_mm: float, sectors: int, growth: float = 1.5
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    core_cells = sectors // 4
    core_mm = 1.1 * core_cells * spacing_mm
    rings = core_mm + graded_spacings(radius_mm - core_mm, spacing_mm, fine_radius_mm - core_mm, growth)
    return _butterfly(core_cells, core_mm, rings[1:])


def _mirrored(
    plane: NDArray[np.float64], cells: NDArray[np.int64]
) -> tuple[NDArray[np.float64], list[NDArray[np.int64]]]:
    """Add the mirror image of a half plane's cells in y = 0."""
    off_axis = plane[:, 1] > 0
    image = np.where(off_axis, len(plane) + np.cumsum(off_axis) - 1, np.arange(len(plane)))
    return np.concatenate([plane, plane[off_axis] * [1, -1]]), [*cells, *image[cells][:, ::-1]]


def _cut(
    plane: NDArray[np.float64], cells: Cells, axis: int, sign: float, distance: float
) -> tuple[NDArray[np.float64], list[NDArray[np.int64]]]:
    """Cut away what lies beyond the line sign · coordinate = distance, once vertices near it are moved onto it."""
    plane = _snapped(plane, cells, axis, sign, distance)
    beyond = sign * plane[:, axis] - distance
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
                    point[axis] = sign * distance
                    crossing[edge] = len(points)
                    points.append(point)
                corners.append(crossing[edge])
        kept.append(np.array(corners))
    used = np.unique(np.concatenate(kept))
    number = np.full(len(points), -1)
    number[used] = np.arange(len(used))
    return np.array(points)[used], [number[cell] for cell in kept]


def _snapped(
    plane: NDArray[np.float64], cells: Cells, axis: int, sign: float, distance: float
) -> NDArray[np.float64]:
    """Move vertices onto the line where it would cut off less than `_SNAP` of an edge."""
    start = np.concatenate(cells)
    end = np.concatenate([np.roll(cell, -1) for cell in cells])
    beyond = sign * plane[:, axis] - distance
    crosses = beyond[start] * beyond[end] < 0
    start, end = start[crosses], end[crosses]
    share = beyond[start] / (beyond[start] - beyond[end])
    moved = np.concatenate([start[share < _SNAP], end[share > 1 - _SNAP]])
    plane = plane.copy()
    plane[moved, axis] = sign * distance
    return plane


def _crossed(
    plane: NDArray[np.float64], cells: Cells, layers_mm: NDArray[np.float64], *, half: bool
) -> GelMesh:
    """Stack layers of prisms on plane cells, and split each prism so that it does not lock.

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
    return GelMesh(vertices_mm=vertices, tetrahedra=np.concatenate(tetrahedra).astype(np.int32), half=half)
