"""An order of elimination that keeps the sparse factor of a mesh's stiffness small: geometric nested dissection."""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import maximum_bipartite_matching
from scipy.sparse.linalg import splu

# Parts of the mesh this small are ordered by minimum degree.
_LEAF = 100
_DIRECTIONS = 8


def elimination_order(graph: sparse.csr_array, points_mm: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the order in which to eliminate the vertices of a mesh around the z axis.

    `graph` (n, n) has an entry for every pair of vertices that share a tetrahedron, `points_mm` is (n, 3). The mesh is
    halved by few vertices, which are eliminated last, its halves likewise (George 1973, SIAM J. Numer. Anal. 10:345).
    Cuts through the median of the points along upright planes, cylinders and levels are tried, each with the smallest
    set of vertices that separates its sides.
    """
    order: list[NDArray[np.int64]] = []
    _dissect(graph.tocsr(), points_mm, np.arange(len(points_mm)), order)
    return np.concatenate(order)


def _dissect(
    graph: sparse.csr_array,
    points_mm: NDArray[np.float64],
    nodes: NDArray[np.int64],
    order: list[NDArray[np.int64]],
) -> None:
    if len(nodes) <= _LEAF:
        order.append(nodes[_minimum_degree(graph[nodes][:, nodes])])
        return
    own = graph[nodes][:, nodes]
    cuts = (_cut(own, along) for along in _coordinates(points_mm[nodes]))
    side = min(cuts, key=_cost)
    _dissect(graph, points_mm, nodes[side < 0], order)
    _dissect(graph, points_mm, nodes[side > 0], order)
    order.append(nodes[side == 0])


def _coordinates(points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z = points_mm.T
    turns = np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS
    return np.stack([*(x * np.cos(turn) + y * np.sin(turn) for turn in turns), np.hypot(x, y), z])


def _cost(side: NDArray[np.int8]) -> float:
    imbalance = abs(int(side.sum())) / len(side)
    return np.count_nonzero(side == 0) * (1 + imbalance)


def _cut(graph: sparse.csr_array, along: NDArray[np.float64]) -> NDArray[np.int8]:
    """Return each vertex's side, −1 or 1, of the median along a coordinate, and 0 for those that separate the sides."""
    side = np.full(len(along), -1, dtype=np.int8)
    side[np.argsort(along, kind="stable")[len(along) // 2 :]] = 1
    below, above = np.flatnonzero(side < 0), np.flatnonzero(side > 0)
    across = graph[below][:, above].tocsr()
    rows, columns = _vertex_cover(across)
    side[below[rows]] = 0
    side[above[columns]] = 0
    return side


def _vertex_cover(pairs: sparse.csr_array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the fewest rows and columns that hold all entries (König's theorem)."""
    match = maximum_bipartite_matching(pairs, perm_type="column")
    row_of = np.full(pairs.shape[1], -1)
    row_of[match[match >= 0]] = np.flatnonzero(match >= 0)
    has_pairs = np.diff(pairs.indptr) > 0
    seen_row, seen_column = (match < 0) & has_pairs, np.zeros(pairs.shape[1], dtype=bool)
    stack = list(np.flatnonzero(seen_row))
    while stack:
        row = stack.pop()
        for column in pairs.indices[pairs.indptr[row] : pairs.indptr[row + 1]]:
            if not seen_column[column]:
                seen_column[column] = True
                partner = row_of[column]
                if partner >= 0 and not seen_row[partner]:
                    seen_row[partner] = True
                    stack.append(partner)
    return np.flatnonzero(has_pairs & ~seen_row), np.flatnonzero(seen_column)


def _minimum_degree(graph: sparse.csr_array) -> NDArray[np.int64]:
    dominant = graph + sparse.diags_array(np.asarray(graph.sum(axis=0)).ravel())
    factors = splu(
        dominant.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    return np.argsort(factors.perm_c)
