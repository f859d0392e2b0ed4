"""The gel's factorisation beside CHOLMOD's and SuperLU's: `python -m gelgap.benchmarks.physics.cholesky`, a minute.

An iteration needs A, the stiffness of a pressed gel as MuJoCo has it, condensed onto the vertices near the body.
`sim/fronts.py` stops its elimination there. CHOLMOD (Chen et al. 2008, ACM Trans. Math. Softw. 35:22), through cvxopt,
factorises all of A by its supernodal code, and hands out no condensed matrix. SuperLU is unsymmetric. One thread;
medians of core time, the methods in turn; errors are relative.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import linalg, sparse
from scipy.sparse.linalg import splu
from threadpoolctl import threadpool_limits

from gelgap.adapt.result_table import ResultTable
from gelgap.benchmarks.physics.policy import NEW_TANGENTS, problem_of
from gelgap.sim.fronts import Condensation
from gelgap.sim.indenter import Floats
from gelgap.sim.mesh import elimination_groups
from gelgap.sim.newton import POLICY, StaticNewton

MISSING = "CHOLMOD is not compared: cvxopt, which has it, is not installed (pip install 'gelgap[benchmark]')"
SCENES = (("ball, press", "draft"), ("ball, press", "standard"), ("box, press", "draft"))
TOUCH = np.array([0.0, 0.0, -0.1, 0.0, 0.0, 0.0])
REPEATS = 7


class Gel:
    """The stiffness A of a gel that is pressed a little, its rows and columns in the order of elimination."""

    def __init__(self, scene: str, quality: str) -> None:
        problem = problem_of(scene, quality)
        # The last iteration is one with a new tangent, whose stiffness MuJoCo's data then hold.
        newton = StaticNewton(problem, replace(POLICY, **NEW_TANGENTS))
        newton.load_step(TOUCH, 3)
        data, model = newton.data, newton.gel.model
        starts = np.append(data.efm_K_rowadr, data.nefmK)
        shape = (model.nv, model.nv)
        self.pattern = sparse.csr_array((np.array(data.efm_K_val), data.efm_K_colind, starts), shape=shape)
        self.diagonal = data.M[model.M_rowadr + model.M_rownnz - 1] + data.efm_diag
        self.first_dof = newton.gel.vertex_dof[newton.gel.vertex_dof >= 0][::-1]
        self.groups = elimination_groups(problem)
        if not self.pattern.data.any():
            raise RuntimeError(f"{scene}: MuJoCo's data hold no stiffness")
        self.dofs = (self.first_dof[:, None] + np.arange(3)).ravel()
        whole = self.pattern + sparse.diags_array(self.diagonal)
        self.matrix = sparse.csc_array(sparse.csr_array(whole)[self.dofs][:, self.dofs])
        self.kept = 3 * len(self.groups[-1].columns)
        self.right_side = np.random.default_rng(0).normal(size=len(self.dofs))


class Fronts:
    """gelgap's own: the condensed matrix, and for a whole solution LAPACK's factor of it."""

    name = "gelgap's fronts"

    def __init__(self, gel: Gel) -> None:
        self.gel = gel
        self.condensation = Condensation(gel.pattern, gel.first_dof, gel.groups)

    def condensed(self) -> Floats:
        self.lower = self.condensation.factorise(self.gel.pattern.data, self.gel.diagonal)
        return self.lower

    def factorise(self) -> None:
        self.factor = linalg.cho_factor(self.condensed(), lower=True, check_finite=False)

    def solve(self) -> Floats:
        whole = np.zeros(self.gel.pattern.shape[0])
        whole[self.gel.dofs] = self.gel.right_side
        kept = linalg.cho_solve(self.factor, self.condensation.condense(whole), check_finite=False)
        return self.condensation.expand(kept)[self.gel.dofs]


class Cholmod:
    """CHOLMOD's supernodal factor, in gelgap's order (METIS's, kept vertices last) or in its own (AMD's)."""

    def __init__(self, gel: Gel, *, own_order: bool) -> None:
        from cvxopt import cholmod, matrix, spmatrix

        self.gel, self.cholmod, self.matrix = gel, cholmod, matrix
        self.name = "CHOLMOD, own order" if own_order else "CHOLMOD, same order"
        lower = sparse.coo_array(sparse.tril(gel.matrix))
        rows, columns = (matrix(index.tolist()) for index in lower.coords)
        self.lower = spmatrix(matrix(lower.data), rows, columns, gel.matrix.shape)
        self.order = {} if own_order else {"p": matrix(list(range(len(gel.dofs))))}
        self.symbolic = cholmod.symbolic(self.lower, **self.order)

    def factorise(self) -> None:
        self.cholmod.numeric(self.lower, self.symbolic)

    def solve(self) -> Floats:
        found = self.matrix(self.gel.right_side)
        self.cholmod.solve(self.symbolic, found)
        return np.array(found)[:, 0]


class SuperLU:
    """SciPy's SuperLU in symmetric mode, minimum degree."""

    name = "SuperLU"

    def __init__(self, gel: Gel) -> None:
        self.gel = gel

    def factorise(self) -> None:
        options = {"SymmetricMode": True}
        self.factor = splu(
            self.gel.matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.01, options=options
        )

    def solve(self) -> Floats:
        return self.factor.solve(self.gel.right_side)


def core_ms(function: Callable[[], Any]) -> float:
    """Return the core milliseconds of a call."""
    started = time.process_time()
    function()
    return 1e3 * (time.process_time() - started)


def methods_for(gel: Gel) -> list[Any]:
    """Return the methods that are installed."""
    try:
        cholmod = [Cholmod(gel, own_order=False), Cholmod(gel, own_order=True)]
    except ImportError:
        cholmod = []
    return [Fronts(gel), *cholmod, SuperLU(gel)]


def measure(gel: Gel) -> list[dict[str, Any]]:
    """Return what each method takes for a gel, and how far off it is."""
    methods = methods_for(gel)
    taken: dict[tuple[str, str], list[float]] = {}
    for _ in range(REPEATS):
        for method in methods:
            steps = {"condense": method.condensed} if isinstance(method, Fronts) else {}
            for step, function in (steps | {"factorise": method.factorise, "solve": method.solve}).items():
                taken.setdefault((method.name, step), []).append(core_ms(function))
    expected = np.tril(schur_complement(gel))
    rows = []
    for method in methods:
        times = {s: statistics.median(ms) for (name, s), ms in taken.items() if name == method.name}
        left = gel.matrix @ method.solve() - gel.right_side
        row = {
            "method": method.name,
            "condensed, ms": times.get("condense", np.nan),
            "whole factor, ms": times["factorise"],
            "one solution, ms": times["solve"],
            "residual": np.linalg.norm(left) / np.linalg.norm(gel.right_side),
        }
        if isinstance(method, Fronts):
            # Some dofs are held by a huge stiffness, beside which no error would be seen.
            scale = 1 / np.sqrt(np.diag(expected))
            off = np.abs(method.condensed() - expected) * scale[:, None] * scale
            row["condensed, error"] = off.max()
        rows.append(row)
    return rows


def schur_complement(gel: Gel) -> Floats:
    """Return the condensed matrix (k, k) by SuperLU: A₂₂ − A₂₁ A₁₁⁻¹ A₁₂."""
    first = len(gel.dofs) - gel.kept
    inner = sparse.csc_array(gel.matrix[:first, :first])
    coupling = gel.matrix[:first, first:]
    corner = gel.matrix[first:, first:].toarray()
    return corner - coupling.T @ splu(inner).solve(coupling.toarray())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=len(SCENES), help="how many of the scenes to measure")
    chosen = parser.parse_args()
    rows = []
    with threadpool_limits(limits=1, user_api="blas"):
        for scene, quality in SCENES[: chosen.scenes]:
            gel = Gel(scene, quality)
            size = f"{scene}, {quality}: {len(gel.dofs)} dofs, {gel.kept} kept"
            rows += [{"matrix": size, **row} for row in measure(gel)]
    exact = {"residual": "{:.0e}", "condensed, error": "{:.0e}"}
    ResultTable.of("Factorisation of a gel's stiffness", pd.DataFrame(rows), formats=exact).show()
    if not any("CHOLMOD" in row["method"] for row in rows):
        print(MISSING)


if __name__ == "__main__":
    main()
