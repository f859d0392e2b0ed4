"""Estimates of a pose's error: what makes them larger, whom they flag, and membranes that lie on themselves."""

from dataclasses import replace

import numpy as np
import pytest

from gelgap.render import surface
from gelgap.sim import Cylinder, Elastomer, Pose, Sphere, Surface, load_indenter, solve_pose, solve_poses
from gelgap.sim.estimate import CAUSES, LARGEST_ESTIMATE, Diagnostics, causes_of_error, diagnose
from gelgap.sim.membrane import FOLDED_AREA, grid_axes, is_folded
from gelgap.sim.plan import plan_visit
from gelgap.sim.problem import ContactProblem
from gelgap.sim.solution import Record, Solution, SolveDiagnostics

GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=0.5, strain_energy="stable-neo-hookean")


def _problem(depth_mm: float = 0.6, quality: str = "draft") -> ContactProblem:
    return plan_visit(GEL, Sphere(), [Pose(depth_mm=depth_mm)], quality).solves[0].problem


def _record(
    depth_mm: float = 0.6, force_n: tuple[float, float, float] = (0.0, 0.0, -0.4), tz_n_mm: float = 0.0
) -> Record:
    return Record(
        displacement_mm=np.zeros((1, 3), np.float32),
        normal_force_n=np.zeros(1, np.float32),
        contact_force_n=np.zeros((1, 3), np.float32),
        indenter_mm=np.array([0.0, 0.0, -depth_mm]),
        torque_n_mm=np.array([0.0, 0.0, tz_n_mm]),
        force_n=np.array(force_n),
        converged=True,
        diagnostics=SolveDiagnostics(elastic_energy_mj=0.5),
    )


def _solution(problem: ContactProblem, *records: Record) -> Solution:
    return Solution(problem, (np.zeros((1, 2)),), records)


def _causes(problem: ContactProblem, record: Record, radius_mm: float) -> dict[str, float]:
    return dict(zip(CAUSES, causes_of_error(_solution(problem, record), 0, radius_mm), strict=True))


def _found(record: Record, radius_mm: float, ratio: float = 1.0) -> Diagnostics:
    return diagnose(_solution(_problem(), record), 0, radius_mm, 1.0, ratio, GEL)


def test_an_estimate_grows_with_what_makes_a_mesh_inexact() -> None:
    usual = _causes(_problem(), _record(), 0.7)
    assert _causes(_problem(), _record(), 0.2)["few in contact"] > 4 * usual["few in contact"]
    assert _causes(_problem(), _record(force_n=(0.3, 0.0, -0.4)), 0.7)["sideways"] > usual["sideways"] == 0
    assert _causes(_problem(0.01), _record(), 0.7)["stiff mesh"] > 2 * usual["stiff mesh"]
    finer = _causes(_problem(quality="fine"), _record(), 0.7)
    assert all(finer[cause] <= usual[cause] for cause in CAUSES)
    assert finer["cells"] < 0.5 * usual["cells"]


def test_forces_errors_and_energy_are_those_of_the_gel_and_not_of_the_solved_one() -> None:
    one, three = (_found(_record(tz_n_mm=0.1), 0.7, ratio) for ratio in (1.0, 3.0))
    assert three.fz_error_n == pytest.approx(3 * one.fz_error_n)
    assert three.shear_error_n == pytest.approx(3 * one.shear_error_n)
    assert three.tz_error_n_mm == pytest.approx(3 * one.tz_error_n_mm)
    assert three.elastic_energy_mj == pytest.approx(1.5)
    assert three.membrane_error_mm == one.membrane_error_mm > 0
    assert three.contact_radius_error_mm == one.contact_radius_error_mm > 0
    assert 0.001 < one.fz_error_n / 0.4 < LARGEST_ESTIMATE["draft"]


def test_a_contact_of_hardly_a_cell_is_flagged_and_one_of_many_is_not() -> None:
    resolved, hardly = (_found(_record(), radius) for radius in (0.9, 0.05))
    assert hardly.coarse
    assert not resolved.coarse


def test_a_contact_wide_beside_gel_that_hardly_gives_is_coarse() -> None:
    nearly = GEL.model_copy(update={"poisson_ratio": 0.4999})
    (solve,) = plan_visit(nearly, Sphere(diameter_mm=20.0), [Pose(depth_mm=0.6)], "draft").solves
    wide, narrow = (
        diagnose(_solution(solve.problem, _record()), 0, radius_mm, 1.0, 1.0, nearly)
        for radius_mm in (6.0, 2.0)
    )
    assert wide.coarse
    assert not narrow.coarse
    # Lubrication theory without friction has 2.05 (a/h)² (ν − 0.49) more force.
    assert wide.fz_error_n > 0.4 * 2.05 * 4 * 0.0099


def test_a_shallow_press_of_compressible_gel_is_less_certain() -> None:
    pose, thick = Pose(depth_mm=0.05), {"thickness_mm": 10.0, "pad_size_mm": (60.0, 60.0), "friction": 0.0}
    for energy, off in (("isochoric", 0.09), ("stable-neo-hookean", 0.02)):
        gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.3, strain_energy=energy, **thick)
        found = solve_pose(gel, Sphere(diameter_mm=6.0), pose, "draft")
        hertz_n = 4 * 0.3 / (3 * (1 - 0.3**2)) * 3**0.5 * 0.05**1.5
        assert found.diagnostics.fz_error_n > off / 2 * hertz_n
        assert -found.force_n[2] / hertz_n - 1 < 2 * found.diagnostics.fz_error_n / hertz_n + 0.03


def test_a_wide_contact_on_thin_compressible_gel_is_less_certain() -> None:
    gel = GEL.model_copy(update={"poisson_ratio": 0.46, "thickness_mm": 0.3, "strain_energy": "isochoric"})
    problem = plan_visit(gel, Sphere(diameter_mm=50.0), [Pose(depth_mm=0.06)], "draft").solves[0].problem
    solution = _solution(problem, _record(0.06))
    wide_n, narrow_n = (diagnose(solution, 0, radius, 1.0, 1.0, gel).fz_error_n for radius in (1.73, 0.3))
    assert wide_n > 0.04 * 0.4 > narrow_n  # at draft there is 8.8 % more force than in linear elasticity


def test_what_was_dragged_and_drawn_back_is_as_uncertain_as_both_ways() -> None:
    drag = [Pose(depth_mm=0.6, shear_x_mm=x_mm) for x_mm in (0.1, 0.2, 0.3, 0.2, 0.1)]
    problem = plan_visit(GEL, Sphere(), drag, "draft").solves[0].problem
    forces_n = [(fx, 0.0, -0.4) for fx in (0.0, 0.1, 0.2, 0.3, 0.1, 0.0)]
    solution = _solution(problem, *(_record(force_n=force) for force in forces_n))
    shear = [diagnose(solution, k, 0.7, 1.0, 1.0, GEL).shear_error_n for k in range(1, 6)]
    alone = _solution(problem, *[_record(force_n=(0.2, 0.0, -0.4))] * 6)
    assert shear[1] == pytest.approx(diagnose(alone, 2, 0.7, 1.0, 1.0, GEL).shear_error_n)
    assert shear[0] < shear[1] < shear[2] < shear[3] < shear[4] < 1.5 * shear[2]


def test_a_lean_and_a_twist_have_estimates() -> None:
    """A cylinder that leans by 8° and sticks, 0.6 mm deep: Fx is 0.0076 N of 0.92 N too large at `draft`."""
    gel = GEL.model_copy(update={"friction": 10.0})
    upright, leaning = (Cylinder(edge_radius_mm=0.2, tilt_deg=(0.0, lean)) for lean in (0.0, 8.0))
    records = _record(force_n=(-0.033, 0.0, -0.92), tz_n_mm=0.5), _record(force_n=(-0.033, 0.0, -0.92))
    straight, tilted = (
        diagnose(
            _solution(plan_visit(gel, body, [Pose(depth_mm=0.6)], "draft").solves[0].problem, record),
            0,
            1.65,
            1.0,
            1.0,
            gel,
        )
        for body, record in zip((upright, leaning), records, strict=True)
    )
    assert straight.shear_error_n < 0.002
    assert 0.0038 < tilted.shear_error_n < 0.0152
    assert straight.tz_error_n_mm > 0.05
    assert tilted.tz_error_n_mm == 0


def test_a_shallow_pose_on_the_mesh_of_a_deep_one_is_coarse_and_alone_is_not() -> None:
    shared, _ = solve_poses(GEL, Sphere(), [Pose(depth_mm=0.01), Pose(depth_mm=1.0)], "draft")
    (alone,) = solve_poses(GEL, Sphere(), [Pose(depth_mm=0.01)], "draft")
    assert shared.diagnostics.coarse
    assert not alone.diagnostics.coarse
    assert alone.converged
    assert shared.diagnostics.fz_error_n > 2 * alone.diagnostics.fz_error_n


def test_a_shallow_pose_of_a_ring_on_the_mesh_of_a_deep_one_is_coarse_too() -> None:
    problem = plan_visit(GEL, load_indenter("ring"), [Pose(depth_mm=0.4)], "draft").solves[0].problem
    shallow, deep = (diagnose(_solution(problem, _record(d)), 0, 2.6, 1.0, 1.0, GEL) for d in (0.05, 0.4))
    assert shallow.coarse
    assert not deep.coarse
    assert deep.contact_radius_error_mm > problem.cell_mm / 2
    # Where the mesh knows less of how patches share the force, it knows less of the centre that the radius counts from.
    assert shallow.contact_radius_error_mm > 2 * deep.contact_radius_error_mm
    assert 0.02 < shallow.membrane_error_mm / 0.05 < 0.06


def test_a_membrane_that_lies_on_itself_is_folded() -> None:
    x_mm, y_mm = grid_axes()
    flat = np.zeros((len(y_mm), len(x_mm), 3), np.float32)
    for axis, middle in ((0, np.s_[50, 70]), (1, np.s_[40, 30])):
        for moved, folded in ((0.09, False), (0.12, True)):
            displacement = flat.copy()
            displacement[(*middle, axis)] = moved
            assert is_folded(x_mm, y_mm, displacement) == folded
    assert surface.FOLDED_AREA == FOLDED_AREA


def test_a_solved_state_that_is_folded_does_not_count_as_converged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gelgap.sim.solved.is_folded", lambda *_: True)
    (state,) = solve_poses(GEL, Sphere(), [Pose(depth_mm=0.3)], "draft")
    assert state.diagnostics.folded
    assert not state.converged
    assert replace(state.diagnostics, folded=False).residual < 0.01


def test_relief_that_the_mesh_itself_serves_makes_a_round_contact_less_certain() -> None:
    place = np.arange(-30, 31) * 0.05
    square = place**2 + place[:, None] ** 2
    bowl = Surface.of(np.where(square <= 2.25, square / 6, np.inf), 0.05)
    problem = plan_visit(GEL, bowl, [Pose(depth_mm=0.2)], "draft").solves[0].problem
    assert problem.is_round
    served, bridged = (
        diagnose(_solution(own, _record(0.2)), 0, 0.7, 1.0, 1.0, GEL)
        for own in (problem, replace(problem, relief=bowl))
    )
    assert served.fz_error_n > 1.2 * bridged.fz_error_n
