"""How far the membrane slides over the indenter: nothing where it sticks, all of the way without friction."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gelgap.sim import Cylinder, Elastomer, Pose, Sphere, solve_pose, solve_poses

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
    found = sizes_mm(solve_pose(GEL, body, pose, "draft").slip().slip_mm)
    assert len(found) > 150
    assert np.median(found) < 2e-3
    assert np.quantile(found, 0.9) < 0.02


def test_without_friction_the_indenter_goes_and_the_membrane_stays(tmp_path: Path) -> None:
    gel = GEL.model_copy(update={"friction": 0.0})
    pose = Pose(depth_mm=0.4, shear_y_mm=-0.5, point_x_mm=1.5)
    found = solve_pose(gel, Sphere(), pose, "draft").slip()
    np.testing.assert_allclose(np.nanmean(found.slip_mm, axis=(0, 1)), [0.0, 0.5, 0.0], atol=0.03)
    touched = found.x_mm[np.isfinite(found.slip_mm).all(axis=-1).any(axis=0)]
    assert touched.mean() == pytest.approx(1.5, abs=0.1)
    found.save(tmp_path / "slip.npz")
    with np.load(tmp_path / "slip.npz") as arrays:
        np.testing.assert_array_equal(arrays["slip_mm"], found.slip_mm)


def test_a_twist_in_full_slip_turns_the_membrane_back() -> None:
    gel, pose = GEL.model_copy(update={"friction": 0.2}), replace(PRESS, twist_deg=20.0)
    state = solve_pose(gel, Cylinder(edge_radius_mm=0.3), pose, "draft")
    found = state.slip()
    assert state.diagnostics.slip == "gross"
    assert sizes_mm(found.slip_mm).max() == pytest.approx(state.diagnostics.slip_mm, rel=0.1)
    x, y = np.meshgrid(found.x_mm, found.y_mm)
    # Against the turn from +x towards +y, and without a direction of its own.
    assert np.nanmean(x * found.slip_mm[..., 1] - y * found.slip_mm[..., 0]) < -0.1
    np.testing.assert_allclose(np.nanmean(found.slip_mm[..., :2], axis=(0, 1)), 0.0, atol=2e-3)


def test_slip_counts_from_the_press_before_the_travel() -> None:
    pressed, dragged, back = solve_poses(GEL, Sphere(), (PRESS, DRAG, PRESS), "draft")
    assert not sizes_mm(pressed.slip().slip_mm).any()
    assert sizes_mm(back.slip().slip_mm).any()
    alone = solve_pose(GEL, Sphere(), DRAG, "draft")
    np.testing.assert_array_equal(dragged.slip().slip_mm, alone.slip().slip_mm)


@pytest.mark.parametrize("poses", [(Pose(depth_mm=0.0),), (Pose(depth_mm=0.0), DRAG)])
def test_a_pose_without_contact_has_no_slip(poses: tuple[Pose, ...]) -> None:
    with pytest.raises(ValueError, match=r"depth_mm = 0.*: a pose without contact"):
        solve_poses(GEL, Sphere(), poses, "draft")[-1].slip()
