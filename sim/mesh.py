"""The mesh of a contact problem: fine where the gel is touched, prisms of tetrahedra, ordered for elimination.

Plane cells around the contact axis (half a disc, mirrored for a whole one, cut along the pad's edges) are stacked in
layers of prisms, which are split into tetrahedra that do not lock.
"""

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np
import pymetis
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from gelgap.sim.blocks import Cells, Coarsening, split_blocks, split_cells
from gelgap.sim.grading import Sizes, sizes_along
from gelgap.sim.indenter import Floats, Ints, Sphere
from gelgap.sim.problem import MESHES, ContactProblem
from gelgap.sim.scene import PadEdges

if TYPE_CHECKING:
    from gelgap.sim.fronts import Group

# Chosen beside the references; the file says what each does.
_SIZES = SimpleNamespace(**MESHES["mesh"])


@dataclass(frozen=True)
class GelMesh:
    """Tetrahedra of a pad: the outer membrane at z = 0, the bonded bottom at z = −thickness, contact axis at x = y = 0.

    `vertices_mm` is (n, 3), `tetrahedra` (m, 4). If `symmetric`, only y ≥ 0 is meshed and y = 0 is a plane of symmetry.
    """

    vertices_mm: Floats
    tetrahedra: NDArray[np.int32]
    symmetric: bool

    @property
    def surface(self) -> Ints:
        """Indices of the vertices of the outer membrane."""
        return np.flatnonzero(self.vertices_mm[:, 2] > -1e-9)

    @property
    def bottom(self) -> Ints:
        """Indices of the vertices that are bonded to the backing."""
        return np.flatnonzero(self.vertices_mm[:, 2] < self.vertices_mm[:, 2].min() + 1e-9)

    @property
    def neighbours(self) -> sparse.csr_array:
        """Which vertices share a tetrahedron, (n, n), each with itself as well."""
        count, corners = len(self.vertices_mm), self.tetrahedra
        pairs = np.repeat(corners, 4, axis=1).ravel(), np.tile(corners, 4).ravel()
        return sparse.coo_array((np.ones(corners.size * 4, bool), pairs), shape=(count, count)).tocsr()

    @property
    def symmetry_plane(self) -> Ints:
        """Indices of the vertices on the plane of symmetry, none for a whole pad."""
        if not self.symmetric:
            return np.empty(0, dtype=np.int64)
        return np.flatnonzero(np.abs(self.vertices_mm[:, 1]) < 1e-9)


@dataclass(frozen=True)
class DiscGrid:
    """How a disc is divided: a square core of cells, then rings that coarsen beyond `fine_radius_mm`.

    `spacing_mm` is the distance of the vertices up to there, `sectors` the number of cells around half a circle, a
    multiple of 4; each coarser ring is `ring_growth` wider than the one before, none wider than `largest_mm`. The
    disc's centre is drawn out into the line from (x, 0) to (x, 0), x in `axis_mm`, turned by `direction` (cos, sin).
    With `sizes` the rings are as wide as these want them instead, and the core is of `spacing_mm` all the same.
    """

    radius_mm: float
    fine_radius_mm: float
    spacing_mm: float
    sectors: int
    ring_growth: float = 1.5
    largest_mm: float = 2.5
    axis_mm: tuple[float, float] = (0.0, 0.0)
    direction: tuple[float, float] = (1.0, 0.0)
    sizes: Sizes | None = None


# The forecast of what a solve takes counts on the mesh that the solve then has: 0.15 of 2.3 s of a box at `draft`.
@lru_cache(maxsize=4)
def mesh_for(problem: ContactProblem) -> GelMesh:
    """Mesh the gel finely where it will be touched, at the spacing that the largest contact needs."""
    mesh = unordered_mesh(problem)
    return ordered_for_elimination(mesh, touchable(mesh, problem))


def unordered_mesh(problem: ContactProblem) -> GelMesh:
    """Return the mesh of `mesh_for` before its vertices are put in the order of elimination."""
    size, thickness = problem.mesh_size, problem.thickness_mm
    last_mm = _SIZES.last_layer * thickness / max(1.0, problem.contact_width)

    def layers_mm(finest_mm: float) -> Floats:
        return layer_heights_mm(thickness, _SIZES.first_layer * finest_mm, size.layer_growth, last_mm)

    if problem.is_round:
        grid, finest_mm = _around_axis(problem)
        return pad_mesh(grid, layers_mm(finest_mm), problem.pad_mm, symmetric=problem.symmetric)
    lines, coarsening = _lines_and_blocks(problem)
    layers = layers_mm(coarsening.finest_mm / _SIZES.finest_block)
    return GelMesh(*split_blocks(lines, layers, coarsening), problem.symmetric)


def _around_axis(problem: ContactProblem) -> tuple[DiscGrid, float]:
    """Return how the disc of a contact that is round is divided, and the width of its finest cells."""
    size, thickness, spacing = problem.mesh_size, problem.thickness_mm, problem.cell_mm
    contact = min(problem.half_cut_mm)
    *axis, aside, direction = straightest_line(problem.segments[:, :, :2])
    fine_radius = _SIZES.fine_margin * contact + aside + spacing
    radius = max(_SIZES.disc_thicknesses * thickness, _SIZES.smallest_disc * fine_radius)
    if problem.contact_width > 1:
        radius = max(radius, contact + aside + _SIZES.beside_wide_contact_thicknesses * thickness)
    sizes, finest = None, spacing
    if not isinstance(problem.indenter, Sphere):
        # From the ends of the line that the axis is drawn out to, the rim on its way is nearer by up to its length.
        swept_mm = axis[0] - axis[1] - aside, aside
        sizes = sizes_along(problem, 0, _SIZES.largest_cell * thickness, swept_mm)
        # The core is to end before the contact does.
        spacing, finest = min(spacing, float(sizes.at(np.zeros(1))[0])), float(sizes.size_mm.min())
    grid = DiscGrid(
        radius,
        fine_radius,
        spacing,
        sectors=4 * round(size.sectors * (contact + aside) / contact / 4),
        ring_growth=size.ring_growth,
        largest_mm=_SIZES.largest_cell * thickness,
        axis_mm=(axis[0], axis[1]),
        direction=direction,
        sizes=sizes,
    )
    return grid, finest


def _lines_and_blocks(problem: ContactProblem) -> tuple[list[Floats], Coarsening]:
    """Return lines along x and y between which cells lie, for any contact, and which of them become one."""
    thickness, points = problem.thickness_mm, problem.segments.reshape(-1, 6)
    cut_mm = problem.cut_mm
    beside = _SIZES.beside_wide_contact_thicknesses if problem.contact_width > 1 else _SIZES.disc_thicknesses
    lines, box, finest = [], [], np.inf
    for axis in (0, 1):
        swept_mm = float(points[:, axis].min()), float(points[:, axis].max())
        sizes = sizes_along(problem, axis, _SIZES.largest_cell * thickness, swept_mm)
        start, end = cut_mm[axis] + swept_mm + [-beside * thickness, beside * thickness]
        if problem.pad_mm is not None:
            start, end = max(start, problem.pad_mm[2 * axis]), min(end, problem.pad_mm[2 * axis + 1])
        if axis == 1 and problem.symmetric:
            start = 0.0
        # A line through the axis, so that a mirrored scene has the mirrored mesh.
        parts = itertools.pairwise([start, 0.0, end] if start < 0 < end else [start, end])
        lines.append(np.unique(np.concatenate([sizes.positions_mm(*part) for part in parts])))
        box.append(cut_mm[axis] + swept_mm + [-problem.cell_mm, problem.cell_mm])
        finest = min(finest, float(sizes.size_mm.min()))
    growth = _SIZES.block_growth * math.log(problem.mesh_size.ring_growth)
    return lines, Coarsening(
        np.array(box), _SIZES.finest_block * finest, growth, _SIZES.largest_cell * thickness
    )


def straightest_line(segments_mm: Floats) -> tuple[float, float, float, tuple[float, float]]:
    """Return the straight line through the origin that segments (n, 2, 2) keep nearest to.

    From where to where they go along it, how far they leave it, and its direction (2,).
    """
    points = segments_mm.reshape(-1, 2)
    direction = np.linalg.svd(points, full_matrices=False)[2][0] if points.any() else np.array([1.0, 0.0])
    direction = direction.round(12) * (1.0 if direction @ points.sum(axis=0) >= 0 else -1.0) + 0.0
    along, across = points @ direction, points @ np.array([-direction[1], direction[0]])
    low, high, aside = min(along.min(), 0.0), max(along.max(), 0.0), np.abs(across).max()
    return float(low), float(high), float(aside), (float(direction[0]), float(direction[1]))


def pad_mesh(grid: DiscGrid, layers_mm: Floats, pad_mm: PadEdges | None, *, symmetric: bool) -> GelMesh:
    """Stack the cells of `pad_cells` in layers, `layers_mm` the z of these from 0 down, joined around the axis."""
    plane, cells = pad_cells(grid, pad_mm, symmetric=symmetric)
    groups = np.stack([_groups(grid, plane, cells, -top_mm) for top_mm in layers_mm[:-1]])
    return GelMesh(*split_cells(plane, cells, layers_mm, groups), symmetric)


def _groups(grid: DiscGrid, plane: Floats, cells: Cells, depth_mm: float) -> Ints:
    """Return which plane cells (n,) are one at a depth: those that are nearer to the axis than a share of the depth.

    Along the line that the axis is drawn out to, columns become one by twos.
    """
    low, high = grid.axis_mm
    turned = plane @ np.array(
        [[grid.direction[0], -grid.direction[1]], [grid.direction[1], grid.direction[0]]]
    )
    from_axis_mm = np.hypot(turned[:, 0] - np.clip(turned[:, 0], low, high), turned[:, 1])
    radius_mm = _SIZES.joined_radius * depth_mm
    within = np.array([from_axis_mm[cell].max() for cell in cells]) <= radius_mm
    columns = max(1, round((high - low) / grid.spacing_mm))
    groups = np.arange(len(cells))
    if high - low <= radius_mm:
        groups[within] = -1
        return groups
    width_mm = (high - low) / columns
    joined = 2 ** max(0, math.floor(math.log2(2 * radius_mm / width_mm))) if radius_mm > 0 else 1
    along_mm = np.array([turned[cell, 0].mean() for cell in cells])
    column = np.clip(np.floor((along_mm - low) / width_mm), -1, columns)
    groups[within] = -2 - np.where(column < columns, column // joined, columns)[within]
    return groups


def pad_cells(grid: DiscGrid, pad_mm: PadEdges | None, *, symmetric: bool) -> tuple[Floats, Cells]:
    """Divide the part of the pad within a disc around the contact axis, or around the line it is drawn out to.

    `pad_mm` is (x min, x max, y min, y max), on whose edges the axis may lie, or None for a pad without edges. If the
    scene is `symmetric` about y = 0, only y ≥ 0 is divided.
    """
    plane, cells = half_stadium(grid)
    if not symmetric:
        off_axis = plane[:, 1] > 0
        image = np.where(off_axis, len(plane) + np.cumsum(off_axis) - 1, np.arange(len(plane)))
        plane = np.concatenate([plane, plane[off_axis] * [1, -1]])
        cells = [*cells, *(image[cell][::-1] for cell in cells)]
        cosine, sine = grid.direction
        plane = plane @ np.array([[cosine, sine], [-sine, cosine]])
    if pad_mm is not None:
        x_min, x_max, y_min, y_max = pad_mm
        edges = [(0, 1.0, x_max), (0, -1.0, -x_min), (1, 1.0, y_max)]
        if not symmetric:
            edges.append((1, -1.0, -y_min))
        for axis, sign, distance in edges:
            plane, cells = _cut(plane, cells, axis, sign, distance)
        plane, cells = _merged(plane, cells)
    return plane, cells


def layer_heights_mm(thickness_mm: float, first_mm: float, growth: float, last_mm: float) -> Floats:
    """Return the z of the layers from the membrane (0) down to the backing: they thicken from both towards the middle.

    What they are too thick together is taken from the thickest most.
    """
    largest = max(_SIZES.largest_layer * thickness_mm, first_mm)
    upper, lower = [first_mm], [min(last_mm, largest)]
    while sum(upper) + sum(lower) < thickness_mm - 1e-9:
        grown = upper if upper[-1] <= lower[-1] else lower
        grown.append(min(grown[-1] * growth, largest))
    thick = np.array([*upper, *lower[::-1]])
    thick -= (thick.sum() - thickness_mm) * thick**2 / (thick**2).sum()
    return -np.concatenate([[0.0], np.cumsum(thick)])


def half_disc(grid: DiscGrid) -> tuple[Floats, Ints]:
    """Return the vertices (n, 2) and quadrilaterals (m, 4) of the half y ≥ 0 of a disc.

    A core of 2k × k cells, bent from a square towards a circle, lies within rings of 4k cells, the grid's sectors.
    """
    k = grid.sectors // 4
    core_mm = 1.1 * k * grid.spacing_mm
    if grid.sizes is not None:
        rings_mm = grid.sizes.positions_mm(core_mm, grid.radius_mm)
    else:
        rings_mm = core_mm + _graded_positions_mm(
            grid.radius_mm - core_mm,
            grid.spacing_mm,
            grid.fine_radius_mm - core_mm,
            grid.ring_growth,
            grid.largest_mm,
        )
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
    points, inner = [core], edge
    for ring, radius in enumerate(rings_mm[1:]):
        outer = len(core) + ring * len(edge) + np.arange(len(edge))
        points.append(radius * np.stack([np.cos(turn), np.sin(turn)], -1))
        quads.append(np.stack([inner[:-1], outer[:-1], outer[1:], inner[1:]], -1))
        inner = outer
    plane = np.concatenate(points)
    plane[np.abs(plane) < 1e-12] = 0.0
    return plane, np.concatenate(quads)


def half_stadium(grid: DiscGrid) -> tuple[Floats, Cells]:
    """Return the half y ≥ 0 of a disc cut at x = 0 and drawn out along x, with columns of cells in between.

    Far from the line, where cells are longer than wide, two columns become one: the cells there have a fifth corner.
    """
    plane, quads = half_disc(grid)
    low, high = grid.axis_mm
    if high - low <= 1e-9:
        return plane, list(quads)
    middle = np.flatnonzero(np.abs(plane[:, 0]) < 1e-9)
    middle = middle[np.argsort(plane[middle, 1])]
    y = plane[middle, 1]
    shifted = plane + np.where(plane[:, :1] > 1e-9, [[high, 0.0]], [[low, 0.0]])
    ahead = plane[quads, 0].mean(axis=1) > 0
    columns = max(1, round((high - low) / grid.spacing_mm))
    x = low + (high - low) * np.arange(columns + 1) / columns
    points, count = [shifted], len(shifted)
    cells: list[Ints] = []
    kept = [np.arange(columns + 1)]
    for length in np.diff(y):
        last, width = kept[-1], (high - low) / (len(kept[-1]) - 1)
        kept.append(np.unique([*last[::2], columns]) if length > _SIZES.merged_ratio * width else last)
    number = np.full((len(middle), columns + 1), -1)
    for row, here in enumerate(kept):
        # Column 0 is the cut's left side; the others are new.
        number[row, here] = [middle[row], *range(count, count + len(here) - 1)]
        points.append(np.column_stack([x[here[1:]], np.full(len(here) - 1, y[row])]))
        count += len(here) - 1
    for row, above in enumerate(kept[1:]):
        below = kept[row]
        for left, right in itertools.pairwise(above):
            under = below[(below >= left) & (below <= right)]
            cells.append(np.array([*number[row, under], number[row + 1, right], number[row + 1, left]]))
    moved = np.arange(len(plane))
    moved[middle] = number[:, -1]
    quads = np.where(ahead[:, None], moved[quads], quads)
    return np.concatenate(points), [*quads, *cells]


def _graded_positions_mm(
    length_mm: float, spacing_mm: float, fine_mm: float, growth: float, largest_mm: float = 2.5
) -> Floats:
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


def _cut(plane: Floats, cells: Cells, axis: int, sign: float, distance_mm: float) -> tuple[Floats, Cells]:
    """Cut away what lies beyond the line sign · coordinate = distance.

    Vertices are first moved onto the line where it would cut off only a small share of an edge.
    """
    start = np.concatenate(cells)
    end = np.concatenate([np.roll(cell, -1) for cell in cells])
    beyond = sign * plane[:, axis] - distance_mm
    crosses = beyond[start] * beyond[end] < 0
    start, end = start[crosses], end[crosses]
    share = beyond[start] / (beyond[start] - beyond[end])
    moved = np.concatenate([start[share < _SIZES.snapped_share], end[share > 1 - _SIZES.snapped_share]])
    plane = plane.copy()
    plane[moved, axis] = sign * distance_mm
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


def _merged(plane: Floats, cells: Cells) -> tuple[Floats, Cells]:
    """Make one vertex of those that two edges have moved onto the same corner of the pad."""
    _, first, place = np.unique(plane.round(9), axis=0, return_index=True, return_inverse=True)
    number = np.cumsum(np.isin(np.arange(len(plane)), first)) - 1
    cells = [number[first[place.ravel()[cell]]] for cell in cells]
    cells = [corners[corners != np.roll(corners, 1)] for corners in cells]
    return plane[np.sort(first)], [corners for corners in cells if len(corners) > 2]


def touchable(mesh: GelMesh, problem: ContactProblem) -> Ints:
    """Return the surface vertices that the indenter can touch.

    They lie within its penetration radius, and a margin, of the segments along which it travels over the plane, or as
    near to the body at its deepest, if it is not one of revolution. What friction drags along is touched no further.
    """
    points_mm, radius_mm = mesh.vertices_mm[mesh.surface, :2], problem.penetration_radius_mm
    margin_mm = min(_SIZES.touching_margin * radius_mm, _SIZES.largest_touching_margin_mm)
    beyond_mm = np.full(len(points_mm), np.inf)
    # Of the rest membrane, from the indenter's origin at its deepest.
    height_mm = problem.depth_mm - problem.indenter.origin_height_mm
    for start, end in problem.segments[:, :, :2]:
        along = end - start
        if problem.is_round:
            share = np.clip((points_mm - start) @ along / max(along @ along, 1e-12), 0, 1)
            from_axis_mm = np.linalg.norm(points_mm - start - share[:, None] * along, axis=1)
            beyond_mm = np.minimum(beyond_mm, from_axis_mm - radius_mm)
            continue
        for share in np.linspace(0, 1, 1 + math.ceil(np.hypot(*along) / _SIZES.touching_step_mm)):
            aside = points_mm - start - share * along
            from_origin = np.column_stack([aside, np.full(len(aside), height_mm)])
            for body, _ in problem.stands:
                beyond_mm = np.minimum(beyond_mm, body.project(from_origin).distance_mm)
    return mesh.surface[beyond_mm <= margin_mm]


def ordered_for_elimination(mesh: GelMesh, touchable: Ints) -> GelMesh:
    """Renumber the vertices in reverse order of elimination.

    The `touchable` ones come first, since the contact problem is condensed onto them; the bonded ones are at the end.
    """
    count = len(mesh.vertices_mm)
    moving = np.setdiff1d(np.arange(count), mesh.bottom)
    graph = mesh.neighbours[moving][:, moving]
    elimination = elimination_order(graph, np.flatnonzero(np.isin(moving, touchable)))
    order = np.concatenate([moving[elimination[::-1]], mesh.bottom])
    number = np.empty(count, dtype=np.int32)
    number[order] = np.arange(count, dtype=np.int32)
    return GelMesh(mesh.vertices_mm[order], number[mesh.tetrahedra], mesh.symmetric)


@lru_cache(maxsize=4)
def elimination_groups(problem: ContactProblem) -> "list[Group]":
    """Return the groups in which a problem's mesh is eliminated; its vertices are numbered in reverse order of that."""
    # Compiled code, which a mesh alone does not load.
    from gelgap.sim.fronts import assembly_tree

    mesh = mesh_for(problem)
    order = np.arange(len(mesh.vertices_mm) - len(mesh.bottom))[::-1]
    return assembly_tree(mesh.neighbours[order][:, order], len(touchable(mesh, problem)))


def elimination_order(graph: sparse.csr_array, last: Ints) -> Ints:
    """Return the order in which to eliminate the vertices of a mesh, `last` (k,) at the end.

    `graph` (n, n) has an entry for every pair of vertices that share a tetrahedron. The others are ordered by METIS'
    nested dissection (Karypis & Kumar 1998, SIAM J. Sci. Comput. 20:359), which is the same whenever it is asked. It
    fails on some meshes; these get SuperLU's minimum degree, with up to 1.5 times the operations of a ball's mesh.
    """
    inner = np.setdiff1d(np.arange(graph.shape[0]), last)
    neighbours = sparse.csr_array(graph[inner][:, inner])
    neighbours.setdiag(0)
    neighbours.eliminate_zeros()
    try:
        adjacency = pymetis.CSRAdjacency(neighbours.indptr, neighbours.indices)
        ordered = np.asarray(pymetis.nested_dissection(adjacency)[0])
    except RuntimeError:
        dominant = neighbours.astype(float) + sparse.diags_array(1.0 + np.diff(neighbours.indptr))
        ordered = np.argsort(splu(dominant.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0).perm_c)
    return np.concatenate([inner[ordered], last])
