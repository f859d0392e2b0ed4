"""A path gives the poses that were solved, what lies between them, and every modulus, point and direction."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from gelgap.sim import Elastomer, Pose, SolvedPath, SolvePlan, Sphere, plan_path, solve_in_full, solve_pose
from gelgap.sim import solved_path as module

GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.5)
STIFF = GEL.model_copy(update={"young_modulus_mpa": 0.9})


@pytest.fixture(scope="module", autouse=True)
def small_grid() -> Iterator[None]:
    """A path of few poses."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "PATH_DEPTHS_MM", (0.2, 0.4))
        patch.setattr(module, "PATH_TRAVELS_MM", (0.0, 0.2))
        yield


@pytest.fixture(scope="module")
def plan(small_grid: None) -> SolvePlan:
    return plan_path(GEL, Sphere())


@pytest.fixture(scope="module")
def path(plan: SolvePlan) -> SolvedPath:
    return SolvedPath.from_solutions(plan, {solve.key: solve.run() for solve in plan.solves})


def test_solved_poses_are_given_back(plan: SolvePlan, path: SolvedPath) -> None:
    for index, pose in enumerate(plan.poses):
        solution = plan.solves[plan.placements[index].solve].run() if plan.placements[index] else None
        state, given = plan.state(index, solution), path.pose(GEL, pose).state
        np.testing.assert_allclose(given.displacement_mm, state.displacement_mm, atol=1e-6)
        np.testing.assert_allclose(given.force_n, state.force_n, atol=1e-9)
        np.testing.assert_array_equal(given.contact, state.contact)
        assert given.contact_radius_mm == pytest.approx(state.contact_radius_mm)
        assert given.converged == state.converged


def test_a_pose_between_is_near_the_one_solved_by_itself(path: SolvedPath) -> None:
    pose = Pose(depth_mm=0.3, shear_x_mm=0.2)
    given, solved = path.pose(GEL, pose).state, solve_pose(GEL, Sphere(), pose, "draft")
    assert given.force_n[2] == pytest.approx(solved.force_n[2], rel=0.03)
    # At draft, few vertices carry a contact's friction, and where its rim slides is rough.
    np.testing.assert_allclose(given.force_n, solved.force_n, atol=0.08 * np.linalg.norm(solved.force_n))
    assert np.abs(given.displacement_mm - solved.displacement_mm).max() < 0.05


def test_force_is_that_of_the_modulus_where_gels_share_solves(plan: SolvePlan, path: SolvedPath) -> None:
    assert [solve.key for solve in plan_path(STIFF, Sphere()).solves] == [solve.key for solve in plan.solves]
    pose = Pose(depth_mm=0.3, shear_x_mm=0.1)
    soft, stiff = path.pose(GEL, pose), path.pose(STIFF, pose)
    np.testing.assert_allclose(stiff.state.force_n, 3 * soft.state.force_n, rtol=1e-6)
    np.testing.assert_allclose(stiff.pressure_mpa, 3 * soft.pressure_mpa, rtol=1e-5)
    np.testing.assert_array_equal(stiff.state.displacement_mm, soft.state.displacement_mm)


def test_a_gel_on_a_spring_has_a_path_of_its_own(plan: SolvePlan) -> None:
    mounted = {
        gel.young_modulus_mpa: gel.model_copy(update={"mount_stiffness_n_per_mm": 5.0})
        for gel in (GEL, STIFF)
    }
    keys = {tuple(solve.key for solve in plan_path(gel, Sphere()).solves) for gel in (GEL, *mounted.values())}
    assert len(keys) == 3


def test_points_and_directions_move_and_turn_it(path: SolvedPath) -> None:
    along_x = path.pose(GEL, Pose(depth_mm=0.3, shear_x_mm=0.15))
    moved = path.pose(GEL, Pose(depth_mm=0.3, shear_x_mm=0.15, point_x_mm=1.0, point_y_mm=-0.5))
    np.testing.assert_allclose(
        moved.state.displacement_mm[:-5, 10:], along_x.state.displacement_mm[5:, :-10], atol=1e-5
    )
    along_y = path.pose(GEL, Pose(depth_mm=0.3, shear_y_mm=0.15))
    fx, fy, fz = along_x.state.force_n
    np.testing.assert_allclose(along_y.state.force_n, [-fy, fx, fz], atol=1e-9)
    np.testing.assert_allclose(along_y.indenter_mm, along_x.indenter_mm[[1, 0, 2]], atol=1e-9)


def test_pressure_adds_up_to_the_normal_force(path: SolvedPath) -> None:
    for pose in (Pose(depth_mm=0.4), Pose(depth_mm=0.35)):
        solved = path.pose(GEL, pose)
        carried_n = solved.pressure_mpa.sum() * 0.1**2
        assert carried_n == pytest.approx(-solved.state.force_n[2], rel=0.15)


def test_a_pose_alone_is_solved_in_full(path: SolvedPath) -> None:
    solved = solve_in_full(GEL, Sphere(), Pose(depth_mm=0.2), "draft")
    assert solved.indenter_mm[2] == pytest.approx(-0.2)
    assert solved.pressure_mpa.sum() * 0.1**2 == pytest.approx(-solved.state.force_n[2], rel=0.15)
    assert not solve_in_full(GEL, Sphere(), Pose(depth_mm=0.0)).pressure_mpa.any()


def test_without_depth_there_is_no_contact(path: SolvedPath) -> None:
    solved = path.pose(GEL, Pose(depth_mm=0.0))
    assert not solved.state.displacement_mm.any()
    assert not solved.state.force_n.any()


def test_an_equilibrium_that_did_not_converge_flags_the_poses_around_it(path: SolvedPath) -> None:
    flags = path.converged.copy()
    flags[2, 1] = False
    doubtful = replace(path, converged=flags)
    assert not doubtful.pose(GEL, Pose(depth_mm=0.3, shear_x_mm=0.1)).state.converged
    assert doubtful.pose(GEL, Pose(depth_mm=0.1, shear_x_mm=0.1)).state.converged


@pytest.mark.parametrize("pose", [Pose(depth_mm=0.5), Pose(depth_mm=0.3, shear_x_mm=0.3)])
def test_beyond_its_end_it_says_where_that_is(path: SolvedPath, pose: Pose) -> None:
    with pytest.raises(ValueError, match="the path ends at 0"):
        path.pose(GEL, pose)
