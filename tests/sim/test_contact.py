"""The condensed contact problem against MuJoCo's own solver of the same."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from gelgap.sim import contact
from gelgap.sim.indenter import Sphere
from gelgap.sim.newton import POLICY, StaticNewton, solve
from gelgap.sim.problem import ContactProblem
from gelgap.sim.scene import Elastomer, Scene, Sharing
from gelgap.sim.shapes import Cylinder

GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=0.5)
# A load step down, one further, and two sideways, in which nodes slide.
PLACES_MM = ((0.0, 0.0, -0.1), (0.0, 0.0, -0.3), (0.08, 0.0, -0.3), (0.16, 0.0, -0.3))
COMMANDS = tuple((*place, 0.0, 0.0, 0.0) for place in PLACES_MM)


NEW_TANGENTS = replace(POLICY, kept_tangent_ratio=0.0, most_patience=0)
"""Every iteration is MuJoCo's with the tangent of its state."""


pytestmark = [pytest.mark.usefixtures("coarse"), pytest.mark.numerical]


def _problem(mount_stiffness_n_per_mm: float | None = None) -> ContactProblem:
    scene = Scene(GEL, Sphere(), "draft", Sharing())
    problem = ContactProblem.of(scene, None, ((0.0, 0.0, -0.3), (0.16, 0.0, -0.3)), (-1, 0))
    return replace(problem, mount_stiffness_n_per_mm=mount_stiffness_n_per_mm)


def _off_mujocos_own(pad: StaticNewton) -> float:
    """Return how far the solution of the last iteration is from the one that MuJoCo finds from rest, over its size."""
    model, data = pad.gel.model, pad.data
    found, force_n = data.qacc.copy(), pad.indenter_force_n
    model.opt.solver, model.opt.iterations, model.opt.tolerance = mujoco.mjtSolver.mjSOL_NEWTON, 100, 0
    data.qacc_warmstart[:] = 0
    mujoco.mj_fwdConstraint(model, data)
    np.testing.assert_allclose(pad.indenter_force_n, force_n, atol=1e-9)
    model.opt.solver, model.opt.iterations = mujoco.mjtSolver.mjSOL_CG, 1
    return float(np.abs(data.qacc - found).max() / np.abs(found).max())


@pytest.mark.parametrize("mount_stiffness_n_per_mm", [None, 2.0])
def test_mujoco_takes_the_condensed_solution_and_finds_the_same_alone(
    mount_stiffness_n_per_mm: float | None,
) -> None:
    pad = StaticNewton(_problem(mount_stiffness_n_per_mm), NEW_TANGENTS)
    for command in COMMANDS:
        assert pad.load_step(np.array(command), 1)[0] is False
        assert np.linalg.norm(pad.indenter_force_n) > 0
        assert _off_mujocos_own(pad) < 1e-6
        pad.load_step(np.array(command), 30)


def test_mujoco_starts_from_nothing_else() -> None:
    """Sideways on a mount, its own estimate without contacts looked better, and it ended there, without a force."""
    gel = Elastomer(young_modulus_mpa=0.7, poisson_ratio=0.49, friction=0.24, mount_stiffness_n_per_mm=20.0)
    way = ((0.0, 0.0, -0.1), (0.1, 0.0, -0.1))
    problem = ContactProblem.of(Scene(gel, Sphere(), "draft", Sharing()), None, way, (-1, 0))
    press, drag = StaticNewton(problem, NEW_TANGENTS).follow_waypoints().records
    assert press.converged
    assert drag.converged
    assert 0.5 * press.force_n[2] > drag.force_n[2] > 2 * press.force_n[2]


def test_a_flat_end_lets_go_near_static_friction_and_slides_at_kinetic() -> None:
    """Its rounded flanks change the ratio of the forces by some per cent."""
    travels_mm = (0.04, 0.07, 0.12)
    way = ((0.0, 0.0, -0.1), *((x, 0.0, -0.1) for x in travels_mm))
    ratios = {}
    for static in (None, 0.25, 0.3):
        gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=0.2, static_friction=static)
        scene = Scene(gel, Cylinder(diameter_mm=3.0, edge_radius_mm=0.4), "draft", Sharing())
        records = solve(ContactProblem.of(scene, None, way, range(-1, 3))).records[1:]
        assert all(record.diagnostics.coulomb_excess < 1e-3 for record in records)
        ratios[static] = [-record.force_n[0] / record.force_n[2] for record in records]
    kinetic, low, high = ratios.values()
    assert max(kinetic) == pytest.approx(0.2, rel=0.08)
    assert max(low) == pytest.approx(0.25, rel=0.08)
    assert max(high) == pytest.approx(0.3, rel=0.08)
    assert low[-1] == pytest.approx(high[-1], rel=2e-3)
    # Without static friction the state is moved from earlier on the way: the ratio changes as vertices pass the flanks.
    assert low[-1] == pytest.approx(kinetic[-1], rel=0.04)


def test_kept_tangents_end_where_fresh_ones_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo accepts what is recorded; a node may land a micrometre aside."""
    taken, found = [], []
    factorise = contact.ContactNewton.factorise
    monkeypatch.setattr(
        contact.ContactNewton, "factorise", lambda self: (taken.append(self), factorise(self))
    )
    for policy in (POLICY, NEW_TANGENTS):
        taken.clear()
        pad = StaticNewton(_problem(), policy)
        records = pad.follow_waypoints().records
        assert pad._accepted
        assert all(record.converged and record.diagnostics.residual < 1e-3 for record in records)
        found.append((records, len(taken)))
    (kept, few), (fresh, many) = found
    assert few < 0.75 * many
    for one, other in zip(kept, fresh, strict=True):
        np.testing.assert_allclose(one.force_n, other.force_n, atol=5e-4 * np.linalg.norm(other.force_n))


def test_a_solve_takes_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    threads = []
    factorise = contact.Condensation.factorise

    def noted(self: contact.Condensation, *arguments: np.ndarray) -> object:
        threads.extend(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")
        return factorise(self, *arguments)

    monkeypatch.setattr(contact.Condensation, "factorise", noted)
    with threadpool_limits(2, user_api="blas"):
        solve(replace(_problem(), waypoints_mm=((0.0, 0.0, -0.05),), parents=(-1,)))
        assert {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"} == {2}
    assert set(threads) == {1}


@pytest.mark.parametrize(("share", "stiffness"), [(0.7, 0.0), (1.0, -1e6), (1.0, np.nan)])
def test_a_load_step_without_a_solution_that_mujoco_accepts_fails(
    share: float, stiffness: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither a wrong solution nor a stiffness without a factor is left to MuJoCo, which may take minutes."""
    pad = StaticNewton(_problem())
    factorise, acceleration = contact.Condensation.factorise, contact.ContactNewton.acceleration

    def with_another_diagonal(self: contact.Condensation, values: np.ndarray, diagonal: np.ndarray) -> object:
        return factorise(self, values, diagonal + stiffness)

    monkeypatch.setattr(contact.Condensation, "factorise", with_another_diagonal)
    monkeypatch.setattr(contact.ContactNewton, "acceleration", lambda self: share * acceleration(self))
    assert pad.load_step(np.array(COMMANDS[0]), 30) == (False, False)
    assert pad.iterations == 1
    assert not any(record.converged for record in pad.follow_waypoints().records)


def test_rounding_is_no_reason_to_refuse_a_light_touch_that_slides(monkeypatch: pytest.MonkeyPatch) -> None:
    """The residual's rounding errors are 10⁻¹⁰ of some 10 µN, below which contacts once took 400 increments."""
    taken = []
    increment = contact.ContactNewton._increment
    monkeypatch.setattr(
        contact.ContactNewton,
        "_increment",
        lambda self, *given: taken.append(self) or increment(self, *given),
    )
    pad = StaticNewton(_problem())
    for command in ((0.0, 0.0, -1e-3), (0.05, 0.0, -1e-3)):
        assert pad.load_step(np.array((*command, 0.0, 0.0, 0.0)), 30) == (True, False)
    assert 0 < np.linalg.norm(pad.indenter_force_n) < 2e-5
    assert len(taken) < 10 * pad.iterations
