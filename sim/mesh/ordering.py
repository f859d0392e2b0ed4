"""The order of a mesh's vertices in which MuJoCo's sparse Cholesky factor stays small and is cheap to update."""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import maximum_bipartite_matching
from scipy.sparse.linalg import SuperLU, splu

from gelgap.sim.mesh.pad import GelMesh

# Parts of the mesh this small are ordered by minimum degree.
_LEAF = 100
_DIRECTIONS = 8


def ordered_for_elimination(
    mesh: GelMesh, penetration_radius_mm: float, segments_mm: NDArray[np.float64]
) -> GelMesh:
    """Renumber the vertices in reverse order of elimination.

    MuJoCo eliminates from the last vertex to the first, and an update of the factor for a contact takes as long as
    there are vertices that depend on the contact's. So surface vertices within the penetration radius of the straight
    `segments_mm` (n, 2, 2), along which the indenter travels over the plane, are numbered first, the nearest at the
    front; the rest follow in reverse order of elimination, the bonded ones at the end.
    """
    vertices, tetrahedra = mesh.vertices_mm, mesh.tetrahedra
    count = len(vertices)
    pairs = sparse.coo_array(
        (
            np.ones(16 * len(tetrahedra)),
            (np.repeat(tetrahedra, 4, axis=1).ravel(), np.tile(tetrahedra, 4).ravel()),
        ),
        shape=(count, count),
    ).tocsr()
    group = np.full(count, 1)
    distance = _distance_to_segments(vertices[:, :2], segments_mm)
    group[mesh.surface[distance[mesh.surface] <= penetration_radius_mm]] = 0
    group[mesh.bottom] = 2
    moving = np.flatnonzero(group < 2)
    touched = np.flatnonzero(group[moving] == 0)
    last = touched[np.argsort(-distance[moving][touched], kind="stable")]
    elimination = elimination_order(pairs[moving][:, moving], vertices[moving], last=last)
    order = np.concatenate([moving[elimination[::-1]], np.flatnonzero(group == 2)])
    number = np.empty(count, dtype=np.int32)
    number[order] = np.arange(count, dtype=np.int32)
    return GelMesh(vertices[order], number[tetrahedra], mesh.symmetric)


def _distance_to_segments(
    points_mm: NDArray[np.float64], segments_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distance of each point (k, 2) from the nearest of segments (n, 2, 2), each from start to end."""
    distance = np.full(len(points_mm), np.inf)
    for start, end in segments_mm:
        along = end - start
        share = np.clip((points_mm - start) @ along / max(along @ along, 1e-12), 0, 1)
        distance = np.minimum(distance, np.linalg.norm(points_mm - start - share[:, None] * along, axis=1))
    return distance


def elimination_order(
    graph: sparse.csr_array, points_mm: NDArray[np.float64], last: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the order in which to eliminate the vertices of a mesh around the z axis, `last` (k,) at the end.

    `graph` (n, n) has an entry for every pair of vertices that share a tetrahedron, `points_mm` is (n, 3). Minimum
    degree competes with nested dissection (George 1973, SIAM J. Numer. Anal. 10:345): the mesh is halved by few
    vertices, which are eliminated after its halves, and these likewise. Cuts through the median of the points along
    upright planes, cylinders and levels are tried, each with the smallest set of vertices that separates its sides.
    """
    inner = np.setdiff1d(np.arange(len(points_mm)), last)
    dissected: list[NDArray[np.int64]] = []
    _dissect(graph, points_mm, inner, dissected)
    by_degree = inner[_minimum_degree(graph[inner][:, inner])]
    orders = [np.concatenate([order, last]) for order in (np.concatenate(dissected), by_degree)]
    return min(orders, key=lambda order: factor_work(graph[order][:, order]))


def factor_work(graph: sparse.csr_array) -> float:
    """Return what eliminating the vertices of a graph in their order costs: the sum of its columns' squared lengths."""
    return float((np.diff(_factors(graph, "NATURAL").L.indptr).astype(float) ** 2).sum())


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
    return np.argsort(_factors(graph, "MMD_AT_PLUS_A").perm_c)


def _factors(graph: sparse.csr_array, ordering: str) -> SuperLU:
    dominant = graph + sparse.diags_array(graph.sum(axis=0))
    options = {"SymmetricMode": True}
    return splu(dominant.tocsc(), permc_spec=ordering, diag_pivot_thresh=0.0, options=options)
