"""How far the membrane slides over the indenter: nothing where it sticks, all of the way without friction."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gelgap.sim import Cylinder, Elastomer, Pose, Sphere, solve_slip
from gelgap.sim.plan import plan_visit
from gelgap.sim.slip import slip_between

GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=10.0)
PRESS = Pose(depth_mm=0.4)
LEAN = Pose(depth_mm=0.15, twist_deg=2.0, roll_deg=(0.0, 1.0))
DRAG, TWIST = (
    replace(PRESS, shear_x_mm=0.15, shear_y_mm=0.1),
    replace(PRESS, twist_deg=5.0, roll_deg=(0.0, 3.0)),
)


def sizes_mm(slip_mm: np.ndarray) -> np.ndarray:
    """Return the size of the slip wherever the membrane touches."""
    found = np.linalg.norm(slip_mm, axis=-1)
    return found[np.isfinite(found)]


@pytest.mark.parametrize(
    ("body", "pose"),
    [
        (Sphere(), DRAG),
        pytest.param(Sphere(), TWIST, marks=pytest.mark.slow),
        (Cylinder(edge_radius_mm=0.3), LEAN),
    ],
)
def test_what_sticks_goes_where_the_indenter_carries_it(body: Sphere | Cylinder, pose: Pose) -> None:
    found = sizes_mm(solve_slip(GEL, body, pose, "draft").slip_mm)
    assert len(found) > 150
    assert np.median(found) < 2e-3
    assert np.quantile(found, 0.9) < 0.02


def test_without_friction_the_indenter_goes_and_the_membrane_stays(tmp_path: Path) -> None:
    gel = GEL.model_copy(update={"friction": 0.0})
    pose = Pose(depth_mm=0.4, shear_y_mm=-0.5, point_x_mm=1.5)
    found = solve_slip(gel, Sphere(), pose, "draft")
    np.testing.assert_allclose(np.nanmean(found.slip_mm, axis=(0, 1)), [0.0, 0.5, 0.0], atol=0.03)
    touched = found.x_mm[np.isfinite(found.slip_mm).all(axis=-1).any(axis=0)]
    assert touched.mean() == pytest.approx(1.5, abs=0.1)
    found.save(tmp_path / "slip.npz")
    with np.load(tmp_path / "slip.npz") as arrays:
        np.testing.assert_array_equal(arrays["slip_mm"], found.slip_mm)


def test_a_twist_in_full_slip_turns_the_membrane_back() -> None:
    gel, poses = GEL.model_copy(update={"friction": 0.2}), (PRESS, replace(PRESS, twist_deg=20.0))
    plan = plan_visit(gel, Cylinder(edge_radius_mm=0.3), poses, "draft")
    solution = plan.solves[0].run()
    found, state = slip_between(plan, 0, 1, solution), plan.state(1, solution)
    assert state.diagnostics.slip == "gross"
    assert sizes_mm(found.slip_mm).max() == pytest.approx(state.diagnostics.slip_mm, rel=0.1)
    x, y = np.meshgrid(found.x_mm, found.y_mm)
    # Against the turn from +x towards +y, and without a direction of its own.
    assert np.nanmean(x * found.slip_mm[..., 1] - y * found.slip_mm[..., 0]) < -0.1
    np.testing.assert_allclose(np.nanmean(found.slip_mm[..., :2], axis=(0, 1)), 0.0, atol=2e-3)


def test_a_pose_without_contact_has_no_slip() -> None:
    with pytest.raises(ValueError, match="depth_mm = 0: a pose without contact"):
        solve_slip(GEL, Sphere(), Pose(depth_mm=0.0), "draft")
    plan = plan_visit(GEL, Sphere(), (Pose(depth_mm=0.0), PRESS), "draft")
    with pytest.raises(ValueError, match="without contact"):
        slip_between(plan, 0, 1, plan.solves[0].run())
