"""Solved scenes: signs, theory, symmetry, scaling, convergence, bad input."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gelgap.sim import press
from gelgap.sim.indenter import Sphere
from gelgap.sim.membrane import MembraneState
from gelgap.sim.path import ContactPath, ForcePath
from gelgap.sim.press import (
    bonded_layer_force_n,
    expected_force_n,
    path_on_gel,
    pose_for_force,
    solve_pose,
    solve_poses,
)
from gelgap.sim.scene import Elastomer, Pose, Sharing
from gelgap.sim.shapes import Cylinder
from gelgap.sim.solution import cached_files

pytestmark = pytest.mark.numerical

GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.8)
BALL = Sphere()
ALONE = Sharing(cache=False)


@pytest.fixture(scope="module")
def descent() -> tuple[MembraneState, ...]:
    poses = (*(Pose(depth_mm=depth) for depth in (0.1, 0.2, 0.4)), Pose(depth_mm=0.4, shear_x_mm=0.2))
    return solve_poses(GEL, BALL, poses, "draft")


def test_all_states_converge_and_are_finite(descent: tuple[MembraneState, ...]) -> None:
    for state in descent:
        assert state.converged
        assert np.isfinite(state.displacement_mm).all()
        assert np.isfinite(state.force_n).all()


def test_diagnostics_say_how_good_and_what_slips(descent: tuple[MembraneState, ...]) -> None:
    for state in descent:
        assert 0 <= state.diagnostics.residual < 1e-2
        assert 0 < state.diagnostics.min_volume_ratio <= 1
        assert 0 <= state.diagnostics.sticking_fraction <= 1
    energies = [state.diagnostics.elastic_energy_mj for state in descent]
    assert 0 < energies[0] < energies[1] < energies[2] < energies[3]
    assert descent[3].diagnostics.slip_mm < 0.2


def test_pressing_gives_negative_fz_that_grows_with_depth(descent: tuple[MembraneState, ...]) -> None:
    normal = [state.force_n[2] for state in descent[:3]]
    assert normal[0] < 0
    assert np.all(np.diff(normal) < 0)


def test_a_centred_press_has_no_sideways_force(descent: tuple[MembraneState, ...]) -> None:
    alone = solve_pose(GEL, BALL, Pose(depth_mm=0.2), "draft")
    assert np.abs(alone.force_n[:2]).max() < 1e-6 * abs(alone.force_n[2])
    for state in descent[:3]:  # on a mesh that is drawn out along the drag
        assert np.abs(state.force_n[:2]).max() < 5e-3 * abs(state.force_n[2])


def test_dragging_to_positive_x_gives_positive_fx(descent: tuple[MembraneState, ...]) -> None:
    force = descent[3].force_n
    assert force[0] > 0
    assert abs(force[1]) < 1e-6
    assert np.hypot(*force[:2]) < 0.8 * 1.1 * abs(force[2])


@pytest.mark.usefixtures("coarse")
def test_the_force_to_expect_is_a_solved_presss_within_a_quarter() -> None:
    softly = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.8, mount_stiffness_n_per_mm=1.0)
    for gel in (GEL, softly):
        solved_n = -solve_pose(gel, BALL, Pose(depth_mm=0.6), "draft").force_n[2]
        assert 0.75 * solved_n < expected_force_n(gel, BALL, 0.6) < 1.1 * solved_n


def test_the_press_agrees_with_the_bonded_layer_at_small_depth(descent: tuple[MembraneState, ...]) -> None:
    theory = bonded_layer_force_n(GEL.young_modulus_mpa, BALL.radius_mm, GEL.thickness_mm, 0.2)
    assert -descent[1].force_n[2] == pytest.approx(theory, rel=0.1)


def test_the_surface_in_contact_is_the_sphere(descent: tuple[MembraneState, ...]) -> None:
    state = descent[2]
    rest = np.stack([*np.meshgrid(state.x_mm, state.y_mm), np.zeros(state.contact.shape)], axis=-1)
    position = (rest + state.displacement_mm)[state.contact]
    assert state.contact.sum() > 50
    distance = np.linalg.norm(position - [0, 0, BALL.radius_mm - 0.4], axis=1)
    np.testing.assert_allclose(distance, BALL.radius_mm, atol=1e-4)


def test_the_contact_radius_grows_within_the_geometric_one(descent: tuple[MembraneState, ...]) -> None:
    radii = [state.contact_radius_mm for state in descent[:3]]
    assert np.all(np.diff(radii) > 0)
    for radius, depth in zip(radii, (0.1, 0.2, 0.4), strict=True):
        assert 0.5 * np.sqrt(BALL.radius_mm * depth) < radius < np.sqrt(2 * BALL.radius_mm * depth)


def test_directions_on_an_interior_point_are_rotations() -> None:
    along_x, along_y, back = (
        solve_pose(GEL, BALL, Pose(depth_mm=0.2, shear_x_mm=x, shear_y_mm=y), "draft")
        for x, y in ((0.1, 0.0), (0.0, 0.1), (-0.1, 0.0))
    )
    fx, fy, fz = along_x.force_n
    np.testing.assert_allclose(along_y.force_n, [-fy, fx, fz], atol=1e-12)
    np.testing.assert_allclose(back.force_n, [-fx, -fy, fz], atol=1e-12)
    np.testing.assert_allclose(back.displacement_mm[:, ::-1, 0], -along_x.displacement_mm[..., 0], atol=2e-5)
    np.testing.assert_allclose(back.displacement_mm[:, ::-1, 2], along_x.displacement_mm[..., 2], atol=2e-5)


def test_force_scales_with_the_modulus_and_shape_does_not() -> None:
    pose = Pose(depth_mm=0.2)
    soft, hard = (
        solve_pose(GEL.model_copy(update={"young_modulus_mpa": modulus}), BALL, pose, "draft", sharing)
        for modulus, sharing in ((0.3, None), (3.0, Sharing(modulus=False)))
    )
    np.testing.assert_allclose(hard.force_n[2], 10 * soft.force_n[2], rtol=5e-3)
    np.testing.assert_allclose(hard.displacement_mm, soft.displacement_mm, atol=2e-3)


@pytest.mark.usefixtures("coarse")
def test_a_mirrored_scene_near_a_corner_has_the_mirrored_force() -> None:
    nothing_shared = Sharing(translation=False, reflection=False, path=False, cache=False)
    one, other = (
        solve_pose(
            GEL,
            BALL,
            Pose(0.3, sign * 0.1, 0.05, point_x_mm=sign * 10.5, point_y_mm=9.0),
            "draft",
            nothing_shared,
        )
        for sign in (1, -1)
    )
    np.testing.assert_allclose(other.force_n, one.force_n * [-1, 1, 1], rtol=1e-2)


def test_a_soft_mount_takes_part_of_the_way() -> None:
    pose = Pose(depth_mm=0.2)
    rigid = solve_pose(GEL, BALL, pose, "draft")
    mounted = solve_pose(GEL.model_copy(update={"mount_stiffness_n_per_mm": 1.0}), BALL, pose, "draft")
    assert mounted.converged
    assert abs(mounted.force_n[2]) < abs(rigid.force_n[2])
    reached = -mounted.displacement_mm[..., 2].min()
    assert reached == pytest.approx(0.2 + mounted.force_n[2] / 1.0, abs=3e-3)


def test_a_contact_on_the_pads_rim_is_about_half_a_contact() -> None:
    inside, on_rim = (solve_pose(GEL, BALL, Pose(depth_mm=0.4, point_y_mm=y), "draft") for y in (0.0, 10.0))
    assert on_rim.converged
    assert 0.3 < on_rim.force_n[2] / inside.force_n[2] < 0.55
    assert on_rim.force_n[1] < -0.1 * abs(on_rim.force_n[2])
    assert abs(on_rim.force_n[0]) < 1e-3 * abs(on_rim.force_n[2])
    assert on_rim.contact_radius_mm == pytest.approx(inside.contact_radius_mm, rel=0.15)
    assert np.isfinite(on_rim.displacement_mm).all()


def test_friction_survives_a_slide_over_the_rim() -> None:
    gel = Elastomer(young_modulus_mpa=0.01, poisson_ratio=0.3, friction=1.5, thickness_mm=6.0)
    poses = tuple(Pose(depth_mm=2.4, point_x_mm=12.0, shear_x_mm=travel) for travel in (0.0, 0.5, 1.0, 1.5))
    states = solve_poses(gel, Sphere(diameter_mm=10.0), poses, "draft")
    assert all(state.converged for state in states)
    # Load steps a fifth as long give 0.0203 N, and `standard` 0.0202 N.
    assert states[-1].force_n[0] == pytest.approx(0.0203, rel=0.03)


def test_a_drag_near_the_brink_of_sliding_bears_its_load_and_is_flagged_where_it_folds() -> None:
    gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=0.8)
    poses = tuple(Pose(depth_mm=0.4, shear_x_mm=travel) for travel in (0.3, 0.4, 0.6))
    before, near, beyond = solve_poses(gel, BALL, poses, "draft")
    # The ratio is `solve_drag`'s at ν = 0.49 on elements of 0.2 mm, which finds no equilibrium from 0.65 mm on.
    assert near.force_n[0] / -near.force_n[2] == pytest.approx(0.788, rel=0.04)
    assert before.converged
    assert near.converged
    assert beyond.diagnostics.folded
    assert not beyond.converged
    assert gel.friction < beyond.force_n[0] / -beyond.force_n[2] < 0.906


def test_a_drag_whose_rim_sticks_until_it_lets_go_converges() -> None:
    """Without slip finite elements have 0.0947 N (`assets/reference/shear_no_slip.csv`)."""
    gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=10.0)
    state = solve_pose(gel, Sphere(), Pose(1.0, shear_x_mm=0.1), quality="draft", sharing=ALONE)
    assert state.converged
    assert state.force_n[0] == pytest.approx(0.0947, rel=0.06)


@pytest.mark.usefixtures("coarse")
def test_a_contact_that_lets_go_as_a_whole_is_flagged() -> None:
    gel = Elastomer(young_modulus_mpa=0.01, poisson_ratio=0.3, friction=1.0, thickness_mm=1.0)
    poses = tuple(Pose(depth_mm=0.4, point_x_mm=12.0, shear_x_mm=travel) for travel in (0.0, 0.2, 0.8))
    states = solve_poses(gel, Sphere(diameter_mm=10.0), poses, "draft")
    assert [state.converged for state in states] == [True, True, False]
    assert states[-1].diagnostics.residual < 1e-2  # it has settled all the same


@pytest.mark.usefixtures("coarse")
def test_a_press_of_a_fifth_of_a_micrometre_is_in_equilibrium() -> None:
    """Vertices rounded to nine digits, off by 5e-8 mm, left 4 % of such a press's force on free ones."""
    state = solve_pose(GEL, BALL, Pose(depth_mm=2e-4, point_x_mm=9.5, point_y_mm=8.6), "draft")
    assert state.converged
    assert state.diagnostics.residual < 1e-3


@pytest.mark.usefixtures("coarse")
def test_load_control_finds_the_depth_of_a_force() -> None:
    """Down to a third of the thickness the ball takes 1.2 N."""
    for force_n in (0.2, 2.0):
        pose = pose_for_force(GEL, BALL, force_n, quality="draft")
        reached_n = -solve_pose(GEL, BALL, pose, "draft").force_n[2]
        assert reached_n == pytest.approx(force_n, rel=0.01)
    assert pose.depth_mm > GEL.thickness_mm / 3
    with pytest.raises(
        ValueError, match=r"normal_force_n = 50: must be at most 2.* N, at 1.5 mm, the largest"
    ):
        pose_for_force(GEL, BALL, 50.0, quality="draft")


def test_a_force_that_no_depth_gives_is_refused_after_one_descent(monkeypatch: pytest.MonkeyPatch) -> None:
    ends_mm = []
    found = np.array([0.0, 0.7, 1.5]), np.array([0.0, 0.5, 2.0])
    monkeypatch.setattr(press, "_descent", lambda end_mm, *_: ends_mm.append(end_mm) or found)
    with pytest.raises(ValueError, match="must be at most 2 N"):
        pose_for_force(GEL, BALL, 50.0)
    assert ends_mm == [1.5]


def test_load_control_presses_a_tilted_face_until_all_of_it_touches() -> None:
    tilted = Cylinder(diameter_mm=8.0, tilt_deg=(15.0, 0.0))
    assert tilted.shallowest_mm == pytest.approx((8 - 0.4) * np.sin(np.radians(15)))
    with pytest.raises(ValueError, match="no depth on this gel lets all of the indenter"):
        pose_for_force(GEL, tilted, 1.0)


@pytest.mark.usefixtures("coarse")
def test_all_of_an_answer_is_of_one_solve(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path))
    state = solve_pose(GEL, BALL, Pose(depth_mm=0.1, shear_x_mm=0.05, shear_y_mm=0.03), "draft")
    assert state.pressure_mpa.max() > 0
    assert state.indenter_mm == pytest.approx([0.05, 0.03, -0.1])
    np.testing.assert_allclose(state.traction().force_n, state.force_n, atol=1e-9)
    assert np.isfinite(state.slip().slip_mm).any()
    assert tuple(state.error.force_n) == state.diagnostics.force_error_n
    assert len(cached_files()) == 1


@pytest.mark.usefixtures("coarse")
def test_the_same_scene_gives_the_same_bytes() -> None:
    pose = Pose(depth_mm=0.1)
    first, second = (solve_pose(GEL, BALL, pose, "draft", ALONE) for _ in range(2))
    assert first.displacement_mm.tobytes() == second.displacement_mm.tobytes()
    assert first.force_n.tobytes() == second.force_n.tobytes()


@pytest.mark.usefixtures("coarse")
def test_a_solve_leaves_no_log_behind(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    solve_pose(GEL, BALL, Pose(depth_mm=0.05), "draft", ALONE)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("pose", "field"),
    [
        (Pose(depth_mm=3.5), "depth_mm"),
        (Pose(depth_mm=0.2, point_x_mm=13.0), "point_x_mm"),
        (Pose(depth_mm=0.2, point_y_mm=-11.0), "point_y_mm"),
        (Pose(depth_mm=0.2, shear_x_mm=9.0), "shear"),
    ],
)
def test_impossible_poses_are_refused(pose: Pose, field: str) -> None:
    with pytest.raises(ValueError, match=field):
        solve_pose(GEL, BALL, pose, "draft")


def test_an_unknown_quality_lists_the_known_ones() -> None:
    with pytest.raises(ValueError, match="standard"):
        solve_pose(GEL, BALL, Pose(depth_mm=0.2), "perfect")


@pytest.mark.usefixtures("coarse")
def test_a_path_of_forces_reaches_them_on_its_gel() -> None:
    path = ForcePath(ContactPath("forces", (0.0,), (0.0,), (0.3, 1.0), (0.0,), (0.0,)))
    pressed = path_on_gel(path, GEL, BALL, "draft")
    for force, depth in zip((0.3, 1.0), pressed.depths_mm, strict=True):
        assert -solve_pose(GEL, BALL, Pose(depth_mm=depth), "draft").force_n[2] == pytest.approx(
            force, rel=0.05
        )
    # Far below the first step of the descent, under a flat end.
    flat, lightly = Cylinder(edge_radius_mm=0.5), ForcePath(replace(path.in_newtons, depths_mm=(0.02,)))
    (depth,) = path_on_gel(lightly, GEL, flat, "draft").depths_mm
    assert -solve_pose(GEL, flat, Pose(depth_mm=depth), "draft").force_n[2] == pytest.approx(0.02, rel=0.15)
    with pytest.raises(ValueError, match=r"force_n = 90 of path forces: must be at most .* N, at 1.5 mm"):
        path_on_gel(
            ForcePath(ContactPath("forces", (0.0,), (0.0,), (90.0,), (0.0,), (0.0,))), GEL, BALL, "draft"
        )


def test_the_gel_of_a_gelsight_mini_takes_the_force_that_was_measured_at_a_millimetre() -> None:
    """5.964 N of a 15 mm ball 1 mm deep, from feats-ai/feats."""
    state = solve_pose(
        Elastomer.preset("gelsight-mini"), Sphere(diameter_mm=15.0), Pose(depth_mm=1.0), "draft"
    )
    assert -state.force_n[2] == pytest.approx(5.964, rel=0.05)


def test_a_bonded_layer_tends_to_hertz_on_a_thick_pad() -> None:
    hertz_n = 4 / 3 * 0.3 / (1 - 0.5**2) * 1.5**0.5 * 0.1**1.5  # Johnson 1985, eq. 4.23
    assert bonded_layer_force_n(0.3, 1.5, 1e5, 0.1) == pytest.approx(hertz_n, rel=1e-4)
    assert bonded_layer_force_n(0.3, 1.5, 3.0, 0.1) > hertz_n
    depth_mm = np.array([0.1, 0.2])
    soft, stiff = (bonded_layer_force_n(e, 1.5, 3.0, depth_mm) for e in (0.2, 0.8))
    np.testing.assert_allclose(stiff, 4 * soft)
