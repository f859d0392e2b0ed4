"""The order of a mesh's vertices in which sparse Cholesky factors stay small, those that can be touched at the end."""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gelgap.sim.mesh.pad import GelMesh

# Vertices up to this far outside of what the indenter passes over can touch it, since the gel bulges.
_TOUCHING_MARGIN_MM = 0.4


def ordered_for_elimination(mesh: GelMesh, touchable: NDArray[np.int64]) -> GelMesh:
    """Renumber the vertices in reverse order of elimination.

    The `touchable` ones come first: the contact problem is condensed onto them; and MuJoCo, which eliminates from the
    last vertex to the first, takes as long to update its factor for a contact as there are vertices that depend on the
    contact's. The rest follow in reverse order of elimination, the bonded ones at the end.
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
    moving = np.setdiff1d(np.arange(count), mesh.bottom)
    elimination = elimination_order(pairs[moving][:, moving], np.flatnonzero(np.isin(moving, touchable)))
    order = np.concatenate([moving[elimination[::-1]], mesh.bottom])
    number = np.empty(count, dtype=np.int32)
    number[order] = np.arange(count, dtype=np.int32)
    return GelMesh(vertices[order], number[tetrahedra], mesh.symmetric)


def touchable(
    mesh: GelMesh, penetration_radius_mm: float, segments_mm: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Return the surface vertices that an indenter can touch.

    They lie within its penetration radius, and a margin, of straight `segments_mm` (n, 2, 2), from start to end, along
    which it travels over the plane. What friction drags along is touched no further out.
    """
    distance_mm = _distance_to_segments(mesh.vertices_mm[mesh.surface, :2], segments_mm)
    return mesh.surface[distance_mm <= penetration_radius_mm + _TOUCHING_MARGIN_MM]


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


def elimination_order(graph: sparse.csr_array, last: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the order in which to eliminate the vertices of a mesh, `last` (k,) at the end.

    `graph` (n, n) has an entry for every pair of vertices that share a tetrahedron. The others are ordered by METIS'
    nested dissection (Karypis & Kumar 1998, SIAM J. Sci. Comput. 20:359), which is the same whenever it is asked.
    """
    import pymetis

    inner = np.setdiff1d(np.arange(graph.shape[0]), last)
    neighbours = sparse.csr_array(graph[inner][:, inner])
    neighbours.setdiag(0)
    neighbours.eliminate_zeros()
    dissected, _ = pymetis.nested_dissection(pymetis.CSRAdjacency(neighbours.indptr, neighbours.indices))
    return np.concatenate([inner[np.asarray(dissected)], last])
