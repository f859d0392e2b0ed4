"""Tetrahedra of a pad: cells of its plane, stacked in layers and joined to larger ones where the gel needs no finer.

Under a contact cells are as small as it needs. Deeper several of them become one, and so do thin layers where cells are
wide. A touch of a thick pad (scene 34 of `benchmark stability`) has 9,400 instead of 15,900 vertices so.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.indenter import Floats

Ints = NDArray[np.int64]
# Corners of each plane cell, counterclockwise.
Cells = Sequence[Ints]
# Numbers of the lines between which a block lies: x first, y first, x last, y last.
Block = tuple[int, int, int, int]

# Layers are joined in cells that are no higher then than this share of their half width.
_HIGHEST_SHARE = 1.0
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
    and four or more tetrahedra at each: 24 if it is a hexahedron among equals.
    """
    start = np.concatenate(cells)
    end = np.concatenate([np.roll(cell, -1) for cell in cells])
    cell = np.repeat(np.arange(len(cells)), [len(corners) for corners in cells])
    sides, side = np.unique(np.sort(np.stack([start, end], 1), axis=1), axis=0, return_inverse=True)
    side = side.ravel()
    owner = _joined_layers(plane, (start, end, cell, side), -layers_mm, groups)
    levels, count, number = len(layers_mm), len(plane), len(sides)
    # Of each side the cells on both sides; of one at the rim its straight line instead of the second.
    order = np.argsort(side, kind="stable")
    first = np.searchsorted(side[order], np.arange(number))
    inner = np.bincount(side) == 2
    one = cell[order[first]]
    other = np.where(inner, cell[order[np.minimum(first + 1, len(order) - 1)]], -1)
    beyond = -3 - _lines_at_rim(plane[sides], inner)
    # Small faces, between what they lie, and what they are bounded by: edges along sides, then upright ones.
    outside = np.full((1, len(cells)), -1)
    level_faces = np.stack([np.vstack([outside, owner]), np.vstack([owner, outside - 1])], axis=-1)
    upright = np.stack([owner[:, one], np.where(inner, owner[:, other], beyond)], axis=-1)
    flat, above = np.arange(levels)[:, None], np.arange(levels - 1)[:, None]
    first_upright = levels * number
    of_cell = np.split(side, np.cumsum([len(corners) for corners in cells])[:-1])
    between, edges = [], []
    for own, corners in zip(level_faces.transpose(1, 0, 2), of_cell, strict=True):
        apart = own[:, 0] != own[:, 1]
        bounds = (flat * number + corners)[apart]
        between.append(np.repeat(own[apart], len(corners), axis=0))
        edges.append(bounds.ravel())
    apart = upright[..., 0] != upright[..., 1]
    standing = first_upright + above[..., None] * count + sides
    bounds = np.stack(
        [
            above * number + np.arange(number),
            (above + 1) * number + np.arange(number),
            standing[..., 0],
            standing[..., 1],
        ],
        axis=-1,
    )[apart]
    between.append(np.repeat(upright[apart], 4, axis=0))
    edges.append(bounds.ravel())
    pairs = np.sort(np.concatenate(between), axis=1)
    # Level faces and upright ones between the same two cells never meet, since groups are nested.
    low, span = pairs.min(), pairs.max() - pairs.min() + 1
    face = (pairs[:, 0] - low) * span + pairs[:, 1] - low
    edge = np.concatenate(edges)
    # What is left of a face's edges is its rim.
    rim, times = np.unique(np.stack([face, edge], axis=1), axis=0, return_counts=True)
    face, edge = rim[times == 1].T
    ends = np.empty((first_upright + (levels - 1) * count, 2), dtype=np.int64)
    ends[:first_upright] = (np.arange(levels)[:, None, None] * count + sides).reshape(-1, 2)
    ends[first_upright:, 0] = np.arange((levels - 1) * count)
    ends[first_upright:, 1] = ends[first_upright:, 0] + count
    chain, chain_ends = _chains(ends, np.unique(edge))
    face, chain = np.unique(np.stack([face, chain[edge]], axis=1), axis=0).T
    names, face = np.unique(face, return_inverse=True)
    neighbours = np.stack(np.divmod(names, span), axis=1) + low
    nodes, corners = np.unique(chain_ends[chain], return_inverse=True)
    corners = corners.reshape(-1, 2)
    points = np.column_stack([plane[nodes % count], layers_mm[nodes // count]])
    centre = _centres(points, corners, face)
    inside = neighbours >= 0
    at_face, body = np.concatenate(
        [np.stack([np.flatnonzero(own), neighbours[own, k]]) for k, own in enumerate(inside.T)], axis=1
    )
    # Below a cell lies one alone.
    order = np.lexsort([centre[at_face, 2], body])
    lowest, highest = (np.searchsorted(body[order], np.arange(owner.max() + 1) + up) - up for up in (0, 1))
    middle = centre[at_face[order[lowest]]]
    middle[:, 2] = (middle[:, 2] + centre[at_face[order[highest]], 2]) / 2
    tetrahedra = []
    for k in (0, 1):
        own = inside[face, k]
        tetrahedra.append(
            np.column_stack(
                [corners[own], len(points) + face[own], len(points) + len(centre) + neighbours[face[own], k]]
            )
        )
    return _outwards(np.concatenate([points, centre, middle]), np.concatenate(tetrahedra).astype(np.int32))


def _joined_layers(
    plane: Floats, edges: tuple[Ints, Ints, Ints, Ints], depth_mm: Floats, groups: Ints
) -> Ints:
    """Return which cell each part of it is in, (layers, cells), once layers are joined where groups are wide."""
    start, end, cell, side = edges
    a, b = plane[start], plane[end]
    area = np.bincount(cell, a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    length = np.linalg.norm(b - a, axis=1)
    owner, count, height = np.empty_like(groups), 0, np.zeros(0)
    for layer, group in enumerate(groups):
        _, group = np.unique(group, return_inverse=True)
        number = group.max() + 1
        both = np.full((side.max() + 1, 2), -1)
        np.maximum.at(both[:, 0], side, group[cell])
        both[:, 1] = number
        np.minimum.at(both[:, 1], side, group[cell])
        rim = (both[side, 0] != both[side, 1]) | (np.bincount(side)[side] == 1)
        half_width_mm = np.bincount(group, area) / np.bincount(group[cell[rim]], length[rim]) * 2
        thick = depth_mm[layer + 1] - depth_mm[layer]
        new, own = count + np.arange(number), np.full(number, thick)
        if layer:
            last = owner[layer - 1]
            above = np.zeros(number, dtype=np.int64)
            above[group] = last
            same = (np.bincount(group, last != above[group]) == 0) & (
                np.bincount(group, minlength=number) == np.bincount(last, minlength=count)[above]
            )
            # Rounded, so that mirrored cells are joined alike.
            joins = same & (height[above] + thick <= (_HIGHEST_SHARE * half_width_mm).round(9) + 1e-9)
            new = np.where(joins, above, count + np.cumsum(~joins) - 1)
            own = np.where(joins, height[above] + thick, thick)
        owner[layer] = new[group]
        count = max(count, int(new.max()) + 1)
        height = np.concatenate([height, np.zeros(count - len(height))])
        height[new] = own
    return owner


def _lines_at_rim(sides: Floats, inner: NDArray[np.bool_]) -> Ints:
    """Return for each side (n, 2, 2) which straight line along x or y it lies on, 0 for none."""
    line = np.zeros(len(sides), dtype=np.int64)
    for axis in (0, 1):
        along = ~inner & (np.abs(np.diff(sides[:, :, axis], axis=1)[:, 0]) < 1e-9)
        _, found = np.unique(sides[along, 0, axis].round(6), return_inverse=True)
        line[along] = line.max() + 1 + found
    return line


def _chains(ends: Ints, edges: Ints) -> tuple[Ints, Ints]:
    """Join `edges` that alone meet at a node; return of each the number of its chain, and the ends of chains (c, 2).

    `ends` (n, 2) are the nodes of all edges.
    """
    used = ends[edges]
    times = np.bincount(used.ravel())
    chain = np.full(len(ends), -1)
    whole = (times[used] != 2).all(axis=1)
    chain[edges[whole]] = np.arange(whole.sum())
    chain_ends = used[whole].tolist()
    at_node: dict[int, list[int]] = {}
    for edge in edges[~whole].tolist():
        for node in ends[edge].tolist():
            at_node.setdefault(node, []).append(edge)
    for edge in edges[~whole].tolist():
        if chain[edge] >= 0:
            continue
        chain[edge], way = len(chain_ends), []
        for node in ends[edge].tolist():
            last = edge
            while times[node] == 2:
                last = next(other for other in at_node[node] if other != last)
                if chain[last] >= 0:
                    break
                chain[last] = len(chain_ends)
                node = int(ends[last].sum()) - node
            way.append(node)
        chain_ends.append(way)
    return chain, np.array(chain_ends)


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


def _outwards(vertices: Floats, tetrahedra: NDArray[np.int32]) -> tuple[Floats, NDArray[np.int32]]:
    """Order each tetrahedron's corners so that its volume is positive."""
    corners = vertices[tetrahedra]
    negative = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
    tetrahedra[negative] = tetrahedra[negative][:, [1, 0, 2, 3]]
    return vertices, tetrahedra
