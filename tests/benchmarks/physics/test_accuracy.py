"""What the physics benchmark measures with: true solutions, surface errors, summaries, on cases that are known."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from gelgap.benchmarks.physics.accuracy import frontier, plot_frontier
from gelgap.benchmarks.physics.cases import Case, solved_cases
from gelgap.benchmarks.physics.errors import errors, normals, surface_errors
from gelgap.benchmarks.physics.references import (
    NO_SLIP_FRICTION,
    drag_cases,
    held_back_cases,
    press_cases,
    tabled_sphere,
)
from gelgap.sim import Elastomer, MembraneState, Pose
from gelgap.sim.membrane import grid_axes


def test_tables_have_profiles_that_fit_their_depths():
    cases, sphere = press_cases(), tabled_sphere()
    assert "lin48_no_slip" not in cases
    case = cases["nh49_no_slip"]
    assert case.elastomer.friction == NO_SLIP_FRICTION
    assert cases["nh48_friction_0.5"].elastomer.friction == 0.5
    gel = sphere.elastomer
    assert (sphere.indenter.radius_mm, gel.thickness_mm, gel.poisson_ratio) == (4.0, 3.0, 0.49)
    assert sphere.truth.force_n[-1, 2] == pytest.approx(-2.463381)
    held_back = held_back_cases().values()
    assert {one.elastomer.friction for one in held_back} == {0.1, 0.3, 0.8, NO_SLIP_FRICTION}
    for one in (case, sphere, *held_back):
        for pose, (r, _, u_z) in zip(one.poses, one.truth.profiles, strict=True):
            assert r[0] == 0
            assert u_z[0] == pytest.approx(-pose.depth_mm, abs=2e-3)


def flat_membrane() -> MembraneState:
    x_mm, y_mm = grid_axes()
    shape = len(y_mm), len(x_mm)
    return MembraneState(x_mm, y_mm, np.zeros((*shape, 3)), np.zeros(shape, bool), np.zeros(3))


def test_a_true_membrane_has_no_error_and_a_shift_has_its_own():
    right = press_cases()["nh49_no_slip"].truth.state(2, flat_membrane())
    assert surface_errors(right, right)["worst °"] == pytest.approx(0, abs=1e-5)
    displacement_mm = right.displacement_mm + np.array([3e-3, 4e-3, -2e-3])
    shifted = surface_errors(replace(right, displacement_mm=displacement_mm), right)
    assert shifted["u_z rms µm"] == pytest.approx(2)
    assert shifted["in-plane rms µm"] == pytest.approx(5)
    assert shifted["peak µm"] == pytest.approx(5)


def test_normals_of_a_tilted_plane():
    plane = flat_membrane()
    plane.displacement_mm[..., 2] = 0.5 * plane.x_mm
    expected = np.array([-0.5, 0, 1]) / np.sqrt(1.25)
    np.testing.assert_allclose(normals(plane), np.broadcast_to(expected, plane.displacement_mm.shape))


def test_presses_of_both_sizes_are_judged_by_their_tables_and_not_solved_again(tmp_path):
    shallow = replace(press_cases()["nh49_no_slip"].down_to(0.2), quality="draft")
    assert [pose.depth_mm for pose in shallow.poses] == [0.2]
    sphere = replace(tabled_sphere(), quality="draft")
    first = solved_cases([shallow, sphere], tmp_path)
    small, large = (errors(case, first[case]) for case in (shallow, sphere))
    assert small["unconverged"] == large["unconverged"] == 0
    assert np.abs(small["fz_percent"]).max() < 8
    assert small["u_z rms µm"] < 10
    assert small["core s/pose"] > 0
    assert large["Fz rms %"] < 2
    assert large["u_z rms µm"] < 5
    assert large["in-plane rms µm"] < 5
    light = Case("light", "b0", Elastomer.preset("b0"), (Pose(depth_mm=0.05),), "draft")
    again = solved_cases([shallow, sphere, light], tmp_path)
    assert again[shallow].core_s == first[shallow].core_s
    assert np.array_equal(again[sphere].states[-1].displacement_mm, first[sphere].states[-1].displacement_mm)
    assert again[light].states[0].force_n[2] < 0


def test_drags_without_slip_come_first_and_those_with_friction_know_how_far_they_are_off():
    without, with_friction = drag_cases()[:2], drag_cases()[2:]
    assert [case.poses[0].depth_mm for case in without] == [0.6, 1.0]
    found = {(case.elastomer.friction, case.poses[0].depth_mm): case.truth for case in with_friction}
    assert {(0.3, 0.6), (0.8, 0.6)} <= set(found)
    for case in with_friction:
        assert 0 < case.truth.uncertainty_percent < 5
        assert np.all(np.diff([pose.shear_x_mm for pose in case.poses]) > 0)
        assert case.truth.force_n[0, 0] == pytest.approx(0, abs=1e-3)
    # More friction, more shear, and both below the drag that never slips.
    ends = [found[0.3, 0.6].force_n[-1, 0], found[0.8, 0.6].force_n[-1, 0]]
    assert ends[0] < ends[1] < without[0].truth.force_n[-1, 0]


def test_the_frontier_is_of_the_cases_that_each_quality_solved(tmp_path):
    presses = pd.DataFrame(
        {
            "case": ["a", "b", "a", "b", "c"],
            "quality": ["standard", "standard", "draft", "draft", "draft"],
            "core s/pose": [4.0, 2.0, 1.0, 0.5, 9.0],
            "Fz rms %": [0.3, 0.4, 3.0, 4.0, 50.0],
        }
    )
    points = frontier(presses)
    assert points.index.to_list() == ["draft", "standard"]
    assert points["seconds"].to_list() == [0.75, 3.0]
    assert points["error"].to_list() == pytest.approx([3.5355, 0.35355], rel=1e-3)
    plot_frontier(tmp_path / "plots" / "f.png", points)
    assert (tmp_path / "plots" / "f.png").stat().st_size > 10_000


def test_no_case_needs_no_solve(tmp_path):
    assert solved_cases([], tmp_path) == {}
