"""The condensed contact problem against MuJoCo's own solver of the same."""

from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from gelgap.sim import contact_newton
from gelgap.sim.elastomer import Elastomer
from gelgap.sim.indenters.sphere import Sphere
from gelgap.sim.material import mesh_moduli
from gelgap.sim.mesh.for_problem import mesh_for
from gelgap.sim.mujoco_model import build_gel_model
from gelgap.sim.newton import StaticNewton, solve
from gelgap.sim.problem import ContactProblem
from gelgap.sim.scene import Scene, Sharing

GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=0.5)
# A load step down, one further, and two sideways, in which nodes slide.
COMMANDS_MM = ((0.0, 0.0, -0.1), (0.0, 0.0, -0.3), (0.08, 0.0, -0.3), (0.16, 0.0, -0.3))


def _problem(mount_stiffness_n_per_mm: float | None = None) -> ContactProblem:
    scene = Scene(GEL, Sphere(), "draft", Sharing())
    problem = scene.problem(None, ((0.0, 0.0, -0.3), (0.16, 0.0, -0.3)), (-1, 0))
    return replace(problem, mount_stiffness_n_per_mm=mount_stiffness_n_per_mm)


def _newton(problem: ContactProblem, *, condensed: bool) -> StaticNewton:
    moduli = mesh_moduli(problem.moduli, problem.mesh_size.stiffness, problem.contact_width)
    return StaticNewton(build_gel_model(problem, mesh_for(problem), moduli), problem, condensed=condensed)


@pytest.mark.parametrize("mount_stiffness_n_per_mm", [None, 2.0])
def test_mujoco_takes_the_condensed_solution_and_finds_the_same_alone(
    mount_stiffness_n_per_mm: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = _problem(mount_stiffness_n_per_mm)
    condensed, alone = (_newton(problem, condensed=switch) for switch in (True, False))
    gone_on = []
    fwd_constraint = condensed._mujoco.mj_fwdConstraint

    def counted(model: object, data: object) -> None:
        fwd_constraint(model, data)
        gone_on.append(int(data.solver_niter[0]))

    monkeypatch.setattr(condensed._mujoco, "mj_fwdConstraint", counted)
    for command_mm in COMMANDS_MM:
        for newton in (condensed, alone):
            assert newton.load_step(np.array(command_mm), 30) == (True, False)
        assert condensed.iterations == alone.iterations
        np.testing.assert_allclose(condensed.indenter_force_n, alone.indenter_force_n, atol=1e-9)
        np.testing.assert_allclose(condensed.vertices_mm(), alone.vertices_mm(), atol=1e-8)
    assert len(gone_on) == condensed.iterations
    assert not any(gone_on)


def test_a_solve_takes_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    threads = []
    condense = contact_newton.Condensation.condense

    def noted(self: contact_newton.Condensation, *arguments: np.ndarray) -> object:
        threads.extend(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")
        return condense(self, *arguments)

    monkeypatch.setattr(contact_newton.Condensation, "condense", noted)
    with threadpool_limits(2, user_api="blas"):
        solve(replace(_problem(), waypoints_mm=((0.0, 0.0, -0.05),), parents=(-1,)))
        assert {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"} == {2}
    assert set(threads) == {1}


def test_mujoco_goes_on_from_a_start_that_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = _problem()
    right, wrong = (_newton(problem, condensed=True) for _ in range(2))
    right.load_step(np.array(COMMANDS_MM[0]), 30)
    acceleration = contact_newton.ContactNewton.acceleration
    monkeypatch.setattr(contact_newton.ContactNewton, "acceleration", lambda self: 0.7 * acceleration(self))
    wrong.load_step(np.array(COMMANDS_MM[0]), 30)
    assert wrong.data.solver_niter[0] > 0
    np.testing.assert_allclose(wrong.indenter_force_n, right.indenter_force_n, atol=1e-9)


@pytest.mark.parametrize("stiffness", [-1e6, np.nan])
def test_where_there_is_no_factor_mujoco_solves_alone(
    stiffness: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = _problem()
    right, failing = (_newton(problem, condensed=True) for _ in range(2))
    right.load_step(np.array(COMMANDS_MM[0]), 30)
    condense = contact_newton.Condensation.condense

    def with_another_diagonal(
        self: contact_newton.Condensation, values: np.ndarray, *others: np.ndarray
    ) -> object:
        return condense(self, values, others[0] + stiffness, others[1])

    monkeypatch.setattr(contact_newton.Condensation, "condense", with_another_diagonal)
    failing.load_step(np.array(COMMANDS_MM[0]), 30)
    np.testing.assert_allclose(failing.indenter_force_n, right.indenter_force_n, atol=1e-9)
