"""Tetrahedra between lines along x and y, in blocks that are finer near a contact and coarser beside and below it.

Cells between lines that cross the whole gel are as narrow far from the contact as under it. Blocks of several of them
leave 0.25 to 0.7 of the vertices, and a drag of an ellipsoid takes half of the time.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.indenter import Floats

# Numbers of the lines between which a block lies: x first, y first, x last, y last.
Block = tuple[int, int, int, int]
Node = tuple[int, int]


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
    """Stack layers of blocks, `layers_mm` their z from 0 down; return vertices (n, 3) and tetrahedra (m, 4).

    A block gets a vertex in its centre and one in the centre of each face, which are joined to the edges of the face.
    Where smaller blocks lie above a block, their lower faces are its upper ones.
    """
    x, y = lines
    vertices: list[tuple[float, float, float]] = []
    number: dict[Hashable, int] = {}
    tetrahedra: list[tuple[int, int, int, int]] = []

    def vertex(key: Hashable, at_x: float, at_y: float, at_z: float) -> int:
        if key not in number:
            number[key] = len(vertices)
            vertices.append((at_x, at_y, at_z))
        return number[key]

    def corner(level: int, node: Node) -> int:
        return vertex((level, *node), x[node[0]], y[node[1]], layers_mm[level])

    above = blocks_between(lines, coarsening, 0.0)
    above_corners = _corners(lines, above)
    for layer, (top_mm, bottom_mm) in enumerate(pairwise(layers_mm)):
        blocks = blocks_between(lines, coarsening, -top_mm)
        is_corner = _corners(lines, blocks)
        owner = np.empty(is_corner.shape, dtype=np.int64)
        for index, (i, j, k, m) in enumerate(blocks):
            owner[i:k, j:m] = index
        upper: list[list[Block]] = [[] for _ in blocks]
        for block in above:
            upper[owner[block[0], block[1]]].append(block)
        for block, on_top in zip(blocks, upper, strict=True):
            i, j, k, m = block
            at_x, at_y, at_z = (x[i] + x[k]) / 2, (y[j] + y[m]) / 2, (top_mm + bottom_mm) / 2
            body = vertex((layer, block), at_x, at_y, at_z)
            around = _around(block, is_corner)
            faces = [((layer + 1, block, "level"), (at_x, at_y, bottom_mm), layer + 1, around, [])]
            for own in on_top:
                a, b, c, d = own
                place = (x[a] + x[c]) / 2, (y[b] + y[d]) / 2, top_mm
                faces.append(((layer, own, "level"), place, layer, _around(own, above_corners), []))
            for start, end in zip(around, [*around[1:], around[0]], strict=True):
                place = (x[start[0]] + x[end[0]]) / 2, (y[start[1]] + y[end[1]]) / 2, at_z
                key = (layer, *sorted((start, end)))
                faces.append((key, place, layer + 1, [start, end], _between(end, start, above_corners)))
            for key, place, level, ring, ring_above in faces:
                centre = vertex(key, *place)
                edges = [corner(level, node) for node in ring] + [corner(layer, node) for node in ring_above]
                tetrahedra += [
                    (a, b, centre, body) for a, b in zip(edges, [*edges[1:], edges[0]], strict=True)
                ]
        above, above_corners = blocks, is_corner
    return _outwards(np.array(vertices), np.array(tetrahedra, dtype=np.int32))


def _corners(lines: Sequence[Floats], blocks: list[Block]) -> NDArray[np.bool_]:
    """Return which crossings of lines are corners of blocks."""
    is_corner = np.zeros((len(lines[0]), len(lines[1])), dtype=bool)
    i, j, k, m = np.array(blocks).T
    is_corner[np.concatenate([i, i, k, k]), np.concatenate([j, m, j, m])] = True
    return is_corner


def _around(block: Block, is_corner: NDArray[np.bool_]) -> list[Node]:
    """Return the corners on a block's sides, its own and those of smaller neighbours, counterclockwise."""
    i, j, k, m = block
    own = [(i, j), (k, j), (k, m), (i, m)]
    return [
        node
        for start, end in zip(own, [*own[1:], own[0]], strict=True)
        for node in _between(start, end, is_corner)[:-1]
    ]


def _between(start: Node, end: Node, is_corner: NDArray[np.bool_]) -> list[Node]:
    """Return the corners on a line from start to end, with both."""
    (i, j), (k, m) = start, end
    steps = max(abs(k - i), abs(m - j))
    nodes = [(i + (k - i) // steps * n, j + (m - j) // steps * n) for n in range(steps + 1)]
    return [node for node in nodes if is_corner[node]]


def _outwards(vertices: Floats, tetrahedra: NDArray[np.int32]) -> tuple[Floats, NDArray[np.int32]]:
    """Order each tetrahedron's corners so that its volume is positive."""
    corners = vertices[tetrahedra]
    negative = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
    tetrahedra[negative] = tetrahedra[negative][:, [1, 0, 2, 3]]
    return vertices, tetrahedra
