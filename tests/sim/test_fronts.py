"""The condensation of a sparse equation against a solver of whole ones."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

from gelgap.sim.fronts import Condensation, assembly_tree
from gelgap.sim.mesh import DiscGrid, GelMesh, layer_heights_mm, ordered_for_elimination, pad_mesh

pytestmark = pytest.mark.numerical

KEPT = 12
FOREIGN_DOFS = 3


@pytest.fixture(scope="module")
def mesh() -> GelMesh:
    """A half disc whose first vertices are the nearest to its centre."""
    grid = DiscGrid(6.0, 1.5, 0.5, 6, 1.8)
    mesh = pad_mesh(grid, layer_heights_mm(2.0, 0.4, 1.5, 0.3), None, symmetric=True)
    nearest = np.argsort(np.hypot(*mesh.vertices_mm[mesh.surface, :2].T))[:KEPT]
    return ordered_for_elimination(mesh, mesh.surface[nearest])


def _first_dof(mesh: GelMesh) -> np.ndarray:
    return FOREIGN_DOFS + 3 * np.arange(len(mesh.vertices_mm))


def _graph(mesh: GelMesh) -> sparse.csr_array:
    """Return which vertices are coupled, in the order of elimination."""
    return mesh.neighbours[::-1][:, ::-1]


def _stiffness(mesh: GelMesh, rng: np.random.Generator) -> tuple[sparse.csr_array, np.ndarray]:
    """Return a positive definite matrix with the mesh's couplings, behind dofs that belong to no vertex; a diagonal."""
    dofs = FOREIGN_DOFS + 3 * mesh.tetrahedra[:, :, None] + np.arange(3)
    dofs = dofs.reshape(len(dofs), 12)
    factors = rng.normal(size=(len(dofs), 12, 12))
    blocks = factors @ factors.transpose(0, 2, 1)
    rows, columns = np.broadcast_arrays(dofs[:, :, None], dofs[:, None, :])
    count = FOREIGN_DOFS + 3 * len(mesh.vertices_mm)
    matrix = sparse.coo_array((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(count, count)).tocsr()
    return matrix, rng.uniform(0.5, 2.0, count)


def test_what_is_condensed_and_expanded_solves_the_whole_equation(mesh: GelMesh) -> None:
    rng = np.random.default_rng(0)
    matrix, diagonal = _stiffness(mesh, rng)
    condensation = Condensation(matrix, _first_dof(mesh)[::-1], assembly_tree(_graph(mesh), KEPT))
    np.testing.assert_array_equal(np.sort(condensation.kept_dofs), FOREIGN_DOFS + np.arange(3 * KEPT))
    # Twice, with other values, since memory is used again; each time for two right sides.
    for scale in (1.0, 3.0):
        whole = scale * matrix + sparse.diags_array(diagonal)
        condensed = condensation.factorise(scale * matrix.data, diagonal)
        for right_side in rng.normal(size=(2, len(diagonal))):
            force = condensation.condense(right_side)
            kept = np.linalg.solve(np.tril(condensed) + np.tril(condensed, -1).T, force)
            expected = spsolve(whole.tocsc(), right_side)
            found = condensation.expand(kept)
            np.testing.assert_allclose(found[FOREIGN_DOFS:], expected[FOREIGN_DOFS:], rtol=1e-9, atol=1e-12)


def test_a_matrix_that_is_not_positive_definite_is_refused(mesh: GelMesh) -> None:
    matrix, diagonal = _stiffness(mesh, np.random.default_rng(1))
    condensation = Condensation(matrix, _first_dof(mesh)[::-1], assembly_tree(_graph(mesh), KEPT))
    diagonal[-1] = -1e6
    with pytest.raises(np.linalg.LinAlgError, match="positive definite"):
        condensation.factorise(matrix.data, diagonal)


def test_what_is_not_finite_leaves_nothing_behind(mesh: GelMesh) -> None:
    matrix, diagonal = _stiffness(mesh, np.random.default_rng(2))
    spoiled, fresh = (
        Condensation(matrix, _first_dof(mesh)[::-1], assembly_tree(_graph(mesh), KEPT)) for _ in range(2)
    )
    assert not np.isfinite(spoiled.factorise(matrix.data, diagonal * np.nan)).all()
    spoiled.condense(diagonal * np.nan)
    lower, expected = (one.factorise(matrix.data, diagonal) for one in (spoiled, fresh))
    np.testing.assert_array_equal(lower, expected)
    np.testing.assert_array_equal(*(one.condense(diagonal) for one in (spoiled, fresh)))


def test_compiled_code_that_another_process_has_cached_is_right(tmp_path: Path) -> None:
    """LAPACK lies elsewhere in each process."""
    script = (
        "import numpy as np; from scipy import sparse; from gelgap.sim import fronts\n"
        "matrix = sparse.csr_array(np.full((9, 9), 0.1) + np.eye(9))\n"
        "groups = fronts.assembly_tree(sparse.csr_array(np.ones((3, 3))), 1)\n"
        "condensation = fronts.Condensation(matrix, np.arange(0, 9, 3), groups)\n"
        "lower = condensation.factorise(matrix.data, np.zeros(9))\n"
        "force = condensation.condense(np.arange(9.0))\n"
        "kept = np.linalg.solve(lower + np.tril(lower, -1).T, force)\n"
        "np.testing.assert_allclose(matrix @ condensation.expand(kept), np.arange(9.0), atol=1e-12)\n"
        "print(sum(fronts._eliminate.stats.cache_hits.values()))\n"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    hits = [
        subprocess.run(
            [sys.executable, "-c", script], env=environment, capture_output=True, check=True
        ).stdout
        for _ in range(2)
    ]
    assert [int(hit) for hit in hits] == [0, 1]


def test_groups_hold_each_vertex_once_and_pass_their_rows_on(mesh: GelMesh) -> None:
    count, graph = len(mesh.vertices_mm), _graph(mesh)
    groups = assembly_tree(graph, KEPT)
    np.testing.assert_array_equal(
        np.sort(np.concatenate([group.columns for group in groups])), np.arange(count)
    )
    np.testing.assert_array_equal(groups[-1].columns, np.arange(count - KEPT, count))
    children = [child for group in groups for child in group.children]
    assert sorted(children) == list(range(len(groups) - 1))
    for number, group in enumerate(groups):
        held = np.concatenate([group.columns, group.rows])
        assert all(child < number for child in group.children)
        for child in group.children:
            assert np.isin(groups[child].rows, held).all()
        coupled = graph[group.columns].indices
        assert np.isin(
            coupled[coupled >= group.columns.min()], np.concatenate([held, *_within(groups, number)])
        ).all()


def _within(groups: list, number: int) -> list[np.ndarray]:
    """Return the columns of all groups below one."""
    found = []
    for child in groups[number].children:
        found += [groups[child].columns, *_within(groups, child)]
    return found
