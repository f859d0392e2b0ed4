"""Names of the version before still answer, and say what replaces them."""

import numpy as np
import pytest

from gelgap.sim import (
    Elastomer,
    Pose,
    SolvedPath,
    Sphere,
    known_pace,
    measured_pace,
    plan_path,
    solve_in_full,
)
from gelgap.sim.plan import plan_visit

GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.5)


def test_the_time_estimate() -> None:
    (solve,) = plan_visit(GEL, Sphere(), (Pose(depth_mm=0.2),), "draft").solves
    for former in (known_pace, measured_pace):
        with pytest.warns(DeprecationWarning, match=r"Solve\.expected_core_s"):
            assert former().solve_s(solve.problem) == solve.expected_core_s


def test_the_solved_path() -> None:
    with pytest.warns(DeprecationWarning, match=r"gelgap\.domains\.LibraryPlan"):
        plan = plan_path(GEL, Sphere())
    assert max(pose.depth_mm for pose in plan.poses) == 1.0
    with pytest.warns(DeprecationWarning, match=r"gelgap\.domains\.PoseLibrary"):
        path = SolvedPath.from_solutions(plan, {})
    pose = Pose(depth_mm=0.2)
    found, exact = path.pose(GEL, pose), solve_in_full(GEL, Sphere(), pose, "draft")
    np.testing.assert_array_equal(found.pressure_mpa, exact.pressure_mpa)
