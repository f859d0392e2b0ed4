"""Tetrahedra of a pad: cells of its plane, stacked in layers and joined to larger ones where the gel needs no finer.

Under a contact cells are as small as it needs. Deeper several of them become one, and so do thin layers where cells are
wide. A touch of a thick pad (scene 34 of `benchmark stability`) has 10,800 instead of 15,900 vertices so.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.indenter import Floats, Ints

# Corners of each plane cell, counterclockwise.
Cells = Sequence[Ints]
# Numbers of the lines between which a block lies: x first, y first, x last, y last.
Block = tuple[int, int, int, int]

# Where the directions to its neighbours add up to less, a corner of a face lies on a straight line between them.
_STRAIGHT = 1e-6


@dataclass(frozen=True)
class Coarsening:
    """How wide a block may be: `finest_mm` at a box, and `growth` wider per mm away from it, up to `largest_mm`.

    `box_mm` is ((x min, x max), (y min, y max)), at the membrane.
    """

    box_mm: Floats
    finest_mm: float
    growth: float
    largest_mm: float

    def widest_mm(self, low_mm: Floats, high_mm: Floats, depth_mm: float) -> float:
        """Return how wide a block between two corners (2,) may be at a depth; 0 where every line counts."""
        beside_mm = np.maximum(0.0, np.maximum(self.box_mm[:, 0] - high_mm, low_mm - self.box_mm[:, 1]))
        away_mm = float(np.hypot(np.hypot(*beside_mm), depth_mm))
        return min(self.finest_mm + self.growth * away_mm, self.largest_mm) if away_mm > 0 else 0.0


def blocks_between(lines: Sequence[Floats], coarsening: Coarsening, depth_mm: float) -> list[Block]:
    """Halve what lies between the first and last lines along x and y, until no block is too wide.

    Which line halves a block depends on the lines alone, so that blocks deeper in the gel consist of whole ones above.
    """
    x, y = lines
    waiting, blocks = [(0, 0, len(x) - 1, len(y) - 1)], []
    while waiting:
        block = i, j, k, m = waiting.pop()
        low, high = np.array([x[i], y[j]]), np.array([x[k], y[m]])
        width = np.where([k - i > 1, m - j > 1], high - low, 0.0)
        axis = int(width.round(9).argmax())
        if width[axis] <= coarsening.widest_mm(low, high, depth_mm):
            blocks.append(block)
            continue
        first, last = block[axis], block[axis + 2]
        inner = lines[axis][first + 1 : last]
        from_middle = np.abs(inner - (low[axis] + high[axis]) / 2).round(9)
        # Of two that are as near, the one nearer to the axis, so that mirrored lines have mirrored blocks.
        half = first + 1 + int(np.lexsort([np.abs(inner), from_middle])[0])
        waiting += [(i, j, half, m), (half, j, k, m)] if axis == 0 else [(i, j, k, half), (i, half, k, m)]
    return blocks


def split_blocks(
    lines: Sequence[Floats], layers_mm: Floats, coarsening: Coarsening
) -> tuple[Floats, NDArray[np.int32]]:
    """Stack layers of blocks between lines, and split them as `split_cells` does."""
    x, y = lines
    plane = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    node = np.arange(len(plane)).reshape(len(x), len(y))
    cells = np.stack([node[:-1, :-1], node[1:, :-1], node[1:, 1:], node[:-1, 1:]], axis=-1).reshape(-1, 4)
    groups = np.empty((len(layers_mm) - 1, len(x) - 1, len(y) - 1), dtype=np.int64)
    for layer, top_mm in enumerate(layers_mm[:-1]):
        for number, (i, j, k, m) in enumerate(blocks_between(lines, coarsening, -top_mm)):
            groups[layer, i:k, j:m] = number
    return split_cells(plane, list(cells), layers_mm, groups.reshape(len(layers_mm) - 1, -1))


def split_cells(
    plane: Floats, cells: Cells, layers_mm: Floats, groups: Ints
) -> tuple[Floats, NDArray[np.int32]]:
    """Stack layers of cells of a plane, `layers_mm` their z from 0 down; return vertices (n, 3) and tetrahedra (m, 4).

    In each layer the cells of one of its `groups` (layers, cells) are one, and groups consist of whole ones of the
    layer above. A cell gets a vertex in its centre and one in the centre of each face that it shares with one other,
    and a tetrahedron at each edge of each face: 24 if it is a hexahedron among equals.
    """
    sides, count = _sides(plane, cells), len(plane)
    owner = _joined_layers(plane, sides, -layers_mm, groups)
    pair, edge, ends = _small_faces(sides, owner, count)
    names, face = np.unique(np.sort(pair, axis=1), axis=0, return_inverse=True)
    # What is left of a face's edges is its rim.
    rim, times = np.unique(np.stack([face.ravel(), edge], axis=1), axis=0, return_counts=True)
    face, edge = rim[times == 1].T
    chain, chain_ends = _chains(ends, np.unique(edge))
    face, chain = np.unique(np.stack([face, chain[edge]], axis=1), axis=0).T
    nodes, corners = np.unique(chain_ends[chain], return_inverse=True)
    corners = corners.reshape(-1, 2)
    points = np.column_stack([plane[nodes % count], layers_mm[nodes // count]])
    centres = _centres(points, corners, face)
    first_body = len(points) + len(centres)
    on_face = np.column_stack([corners, len(points) + face])
    tetrahedra = np.concatenate(
        [np.column_stack([on_face, first_body + own[face]])[own[face] >= 0] for own in names.T]
    )
    vertices = np.concatenate([points, centres, _middles(centres, names)])
    tetrahedra = tetrahedra.astype(np.int32)
    # Corners are ordered so that volumes are positive.
    places = vertices[tetrahedra]
    negative = np.linalg.det(places[:, 1:] - places[:, :1]) < 0
    tetrahedra[negative] = tetrahedra[negative][:, [1, 0, 2, 3]]
    return vertices, tetrahedra


class _Sides(NamedTuple):
    """Sides of plane cells: their `ends` (s, 2), and the cells (s, 2) that each is between.

    At the rim a number below −2 stands for the second cell, the same along a straight line. `start`, `end`, `cell` and
    `side` are of the sides cell by cell, counterclockwise.
    """

    ends: Ints
    cells: Ints
    start: Ints
    end: Ints
    cell: Ints
    side: Ints


def _sides(plane: Floats, cells: Cells) -> _Sides:
    start = np.concatenate(cells)
    end = np.concatenate([np.roll(cell, -1) for cell in cells])
    cell = np.repeat(np.arange(len(cells)), [len(corners) for corners in cells])
    ends, side = np.unique(np.sort(np.stack([start, end], 1), axis=1), axis=0, return_inverse=True)
    side = side.ravel()
    of_side = np.full((len(ends), 2), -3)
    of_side[side[::-1], 0] = cell[::-1]
    inner = of_side[side, 0] != cell
    of_side[side[inner], 1] = cell[inner]
    rim, line = plane[ends], of_side[:, 1]
    for axis in (0, 1):
        along = (line < 0) & (np.abs(np.diff(rim[:, :, axis], axis=1)[:, 0]) < _STRAIGHT)
        _, found = np.unique(rim[along, 0, axis].round(6), return_inverse=True)
        line[along] = line.min() - 1 - found
    return _Sides(ends, of_side, start, end, cell, side)


def _small_faces(sides: _Sides, owner: Ints, count: int) -> tuple[Ints, Ints, Ints]:
    """Return what parts of faces, between different cells, are bounded by: pairs of cells (n, 2) and an edge (n,) each.

    −1 is above the membrane, −2 below the backing. Also the ends (e, 2) of all edges, along sides and upright; a node
    is numbered by level and then by its place among `count` of the plane.
    """
    levels, number = len(owner) + 1, len(sides.ends)
    outside = np.full((1, owner.shape[1]), -1)
    level = np.stack([np.vstack([outside, owner]), np.vstack([owner, outside - 1])], axis=-1)[:, sides.cell]
    second = sides.cells[:, 1]
    upright = np.stack(
        [owner[:, sides.cells[:, 0]], np.where(second >= 0, owner[:, second], second)], axis=-1
    )
    along = number * np.arange(levels)[:, None] + np.arange(number)
    standing = levels * number + count * np.arange(levels - 1)[:, None, None] + sides.ends
    pairs = np.concatenate([level.reshape(-1, 2), np.tile(upright.reshape(-1, 2), (4, 1))])
    edges = [along[:, sides.side], along[:-1], along[1:], standing[..., 0], standing[..., 1]]
    apart = pairs[:, 0] != pairs[:, 1]
    along_ends = (count * np.arange(levels)[:, None, None] + sides.ends).reshape(-1, 2)
    ends = np.concatenate([along_ends, np.arange((levels - 1) * count)[:, None] + [0, count]])
    return pairs[apart], np.concatenate([own.ravel() for own in edges])[apart], ends


def _joined_layers(plane: Floats, sides: _Sides, depth_mm: Floats, groups: Ints) -> Ints:
    """Return which cell each part is in, (layers, cells), with layers joined up to half as high as a cell is wide."""
    a, b = plane[sides.start], plane[sides.end]
    area = np.bincount(sides.cell, a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    length = np.linalg.norm(b - a, axis=1)
    across = sides.cells[sides.side].sum(axis=1) - sides.cell  # below 0 beyond the rim
    owner, height = np.empty_like(groups), np.zeros(0)
    for layer, group in enumerate(groups):
        _, group = np.unique(group, return_inverse=True)
        number, count = group.max() + 1, len(height)
        rim = (across < 0) | (group[np.maximum(across, 0)] != group[sides.cell])
        around = np.bincount(group[sides.cell[rim]], length[rim], number)
        # Rounded, so that mirrored cells are joined alike.
        highest_mm = (2 * np.bincount(group, area) / around).round(9) + 1e-9
        high = np.full(number, depth_mm[layer + 1] - depth_mm[layer])
        new = count + np.arange(number)
        if layer:
            last, above = owner[layer - 1], np.empty(number, dtype=np.int64)
            above[group] = last
            parts = np.bincount(group, minlength=number)
            same = (np.bincount(group, last != above[group]) == 0) & (parts == np.bincount(last)[above])
            joins = same & (height[above] + high <= highest_mm)
            new = np.where(joins, above, count + np.cumsum(~joins) - 1)
            high += np.where(joins, height[above], 0.0)
        owner[layer] = new[group]
        height = np.concatenate([height, np.empty(max(0, new.max() + 1 - count))])
        height[new] = high
    return owner


def _chains(ends: Ints, edges: Ints) -> tuple[Ints, Ints]:
    """Join `edges` that alone meet at a node; return of each the number of its chain, and the ends of chains (c, 2).

    `ends` (n, 2) are the nodes of all edges.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    used = ends[edges]
    inner = np.bincount(used.ravel())[used] == 2
    # At a node within a chain two edges meet.
    by_node = np.argsort(used[inner], kind="stable")
    first, second = np.nonzero(inner)[0][by_node].reshape(-1, 2).T
    joined = coo_array((np.ones(len(first)), (first, second)), shape=(len(edges), len(edges)))
    of_edge = connected_components(joined, directed=False)[1]
    chain = np.full(len(ends), -1)
    chain[edges] = of_edge
    edge, side = np.nonzero(~inner)
    by_chain = np.argsort(of_edge[edge], kind="stable")
    return chain, used[edge, side][by_chain].reshape(-1, 2)


def _centres(points: Floats, edges: Ints, face: Ints) -> Floats:
    """Return the mean (n, 3) of the points where the rim of each face turns, by its `edges` (e, 2) and their `face`."""
    along = points[edges[:, 1]] - points[edges[:, 0]]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    place, at = np.unique((face[:, None] * len(points) + edges).T.ravel(), return_inverse=True)
    turn = np.stack([np.bincount(at, np.concatenate([own, -own])) for own in along.T], axis=1)
    face, corner = np.divmod(place[np.linalg.norm(turn, axis=1) > _STRAIGHT], len(points))
    first = points[corner[np.unique(face, return_index=True)[1]]]
    # From one of them, so that what they have in common their mean has to the last bit.
    from_first = points[corner] - first[face]
    total = np.stack([np.bincount(face, own) for own in from_first.T], axis=1)
    return first + total / np.bincount(face)[:, None]


def _middles(centres: Floats, pairs: Ints) -> Floats:
    """Return the middles (n, 3) of cells, by the centres (f, 3) of faces and the cells (f, 2) that each is between.

    Below a cell lies one alone: its middle is over the centre of that face, at half of its height.
    """
    face, side = np.nonzero(pairs >= 0)
    cell = pairs[face, side]
    order = np.lexsort([centres[face, 2], cell])
    first = np.searchsorted(cell[order], np.arange(cell.max() + 1))
    last = np.append(first[1:], len(order)) - 1
    middle = centres[face[order[first]]]
    middle[:, 2] = (middle[:, 2] + centres[face[order[last]], 2]) / 2
    return middle
