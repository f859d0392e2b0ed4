"""What the physics benchmark measures with: references, surface errors, summaries, on cases that are known."""

import json

import numpy as np
import pytest

from gelgap.benchmarks.common.tables import Point, plot_frontier, print_table, write_json
from gelgap.benchmarks.physics import cases as cases_of_benchmarks
from gelgap.benchmarks.physics.cases import Case, Workers
from gelgap.benchmarks.physics.presses import judge_press, press_case
from gelgap.benchmarks.physics.reference import (
    NO_SLIP_FRICTION,
    coulomb_drags,
    no_slip_drags,
    press_references,
)
from gelgap.benchmarks.physics.surface_errors import normals, picture_psnr_db, rms, surface_errors
from gelgap.sim import Elastomer, Pose, grid_axes


def test_references_have_profiles_that_fit_their_depths():
    references = press_references()
    assert "lin48_no_slip" not in references
    reference = references["nh49_no_slip"]
    assert reference.friction == NO_SLIP_FRICTION
    assert references["nh48_friction_0.5"].friction == 0.5
    for depth, (r, _, u_z) in zip(reference.depths_mm, reference.profiles, strict=True):
        assert r[0] == 0
        assert u_z[0] == pytest.approx(-depth, abs=2e-3)
    assert [drag.depth_mm for drag in no_slip_drags()] == [0.6, 1.0]
    assert no_slip_drags()[0].element_mm == 0.15


def test_reference_membrane_has_no_error_against_itself_and_a_shift_has_its_own():
    reference = press_references()["nh49_no_slip"]
    x_mm, y_mm = grid_axes()
    expected = reference.displacement_mm(2, x_mm, y_mm)
    assert surface_errors(x_mm, y_mm, expected, expected, 1.0).normal_worst_deg == pytest.approx(0, abs=1e-5)
    shifted = surface_errors(x_mm, y_mm, expected + np.array([3e-3, 4e-3, -2e-3]), expected, 1.0)
    assert shifted.uz_rms_um == pytest.approx(2)
    assert shifted.in_plane_rms_um == pytest.approx(5)
    assert shifted.peak_um == pytest.approx(5)


def test_normals_of_a_tilted_plane():
    x_mm, y_mm = grid_axes()
    displacement = np.zeros((len(y_mm), len(x_mm), 3))
    displacement[..., 2] = 0.5 * x_mm
    expected = np.array([-0.5, 0, 1]) / np.sqrt(1.25)
    np.testing.assert_allclose(
        normals(x_mm, y_mm, displacement), np.broadcast_to(expected, displacement.shape)
    )


def test_psnr_of_a_known_difference():
    black = np.zeros((4, 4, 3), np.uint8)
    assert picture_psnr_db(black, black) == float("inf")
    assert picture_psnr_db(black + np.uint8(1), black) == pytest.approx(48.13, abs=0.01)


def test_shallow_press_is_judged_against_its_reference(tmp_path):
    shallow = press_references()["nh49_no_slip"].down_to(0.2)
    assert shallow.depths_mm == (0.2,)
    (solved,) = Workers(1, tmp_path).solve([press_case(shallow, "draft")])
    errors = judge_press(solved, shallow)
    assert errors.unconverged == 0
    assert errors.fz_worst_percent < 8
    assert errors.surface.uz_rms_um < 10
    assert errors.processor_s_per_pose > 0


def test_a_case_that_was_finished_is_not_solved_again(tmp_path):
    cases = [
        Case("light", Elastomer.preset("b0"), (Pose(depth_mm=depth),), "draft") for depth in (0.05, 0.06)
    ]
    workers = Workers(1, tmp_path)
    (first,) = workers.solve(cases[:1])
    again, other = workers.solve(cases)
    assert again.processor_s == first.processor_s
    assert other.case == cases[1]
    assert other.states[0].force_n[2] < first.states[0].force_n[2] < 0


def test_results_do_not_go_through_the_pipe_that_a_stop_may_cut(tmp_path, monkeypatch):
    sent = []

    def as_completed(futures):
        sent.extend(future.result() for future in futures)
        return futures

    monkeypatch.setattr(cases_of_benchmarks, "as_completed", as_completed)
    assert Workers(1, tmp_path).map(rms, [(3.0, 4.0), (1.0, 1.0)]) == [pytest.approx(12.5**0.5), 1.0]
    assert sent == [None, None]


def test_results_and_plot_are_written(tmp_path, capsys):
    print_table("a title", ["name", "value"], [["one", 1.23456], ["two", None]])
    printed = capsys.readouterr().out
    assert "1.235" in printed
    assert "–" in printed
    write_json(tmp_path / "deep" / "x.json", {"point": Point("s", "n", 1.0, 2.0), "array": np.arange(2)})
    assert json.loads((tmp_path / "deep" / "x.json").read_text())["point"]["seconds"] == 1.0
    figure = tmp_path / "f.png"
    plot_frontier(
        figure, [Point("s", "n", 1, 2)], title="t", error_label="e", uncertainty=0.3, targets=(2.0,)
    )
    assert figure.stat().st_size > 1000


def test_drags_with_friction_know_how_far_they_are_off():
    references = {(r.friction, r.depth_mm): r for r in coulomb_drags()}
    assert {(0.3, 0.6), (0.8, 0.6)} <= set(references)
    for reference in references.values():
        assert 0 < reference.fx_uncertainty < 0.05
        assert np.all(np.diff(reference.travel_mm) > 0)
        assert reference.fx_n[0] == pytest.approx(0, abs=1e-3)
    # More friction, more shear, and both below the drag that never slips.
    ends = [references[0.3, 0.6].fx_n[-1], references[0.8, 0.6].fx_n[-1]]
    without_slip = next(r for r in no_slip_drags() if r.depth_mm == 0.6).fx_n[-1]
    assert ends[0] < ends[1] < without_slip
