"""What the physics benchmark measures with: references, surface errors, summaries, on cases that are known."""

import dataclasses
import json

import numpy as np
import pytest

from gelgap.benchmarks.common.tables import Point, plot_frontier, print_table, write_json
from gelgap.benchmarks.physics import accuracy as physics
from gelgap.benchmarks.physics.reference import (
    NO_SLIP_FRICTION,
    coulomb_references,
    press_references,
    shear_references,
)
from gelgap.benchmarks.physics.surface_errors import normals, picture_psnr_db, surface_errors
from gelgap.sim import grid_axes


def test_references_have_profiles_that_fit_their_depths():
    references = press_references()
    assert "lin48_no_slip" not in references
    reference = references["nh49_no_slip"]
    assert reference.friction == NO_SLIP_FRICTION
    assert references["nh48_friction_0.5"].friction == 0.5
    for depth, (r, _, u_z) in zip(reference.depths_mm, reference.profiles, strict=True):
        assert r[0] == 0
        assert u_z[0] == pytest.approx(-depth, abs=2e-3)
    assert [shear.depth_mm for shear in shear_references()] == [0.6, 1.0]
    assert shear_references()[0].element_mm == 0.15


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


def test_shallow_press_is_judged_against_its_reference():
    full = press_references()["nh49_no_slip"]
    shallow = dataclasses.replace(
        full,
        depths_mm=full.depths_mm[:1],
        force_n=full.force_n[:1],
        contact_radius_mm=full.contact_radius_mm[:1],
        contact_radius_uncertainty_mm=full.contact_radius_uncertainty_mm[:1],
        profiles=full.profiles[:1],
    )
    (errors,) = physics.press_errors({full.name: shallow}, ["draft"], processes=1)
    assert errors.unconverged == 0
    assert errors.fz_worst_percent < 8
    assert errors.surface.uz_rms_um < 10
    assert errors.processor_s_per_pose > 0


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
    references = {(r.friction, r.depth_mm): r for r in coulomb_references()}
    assert {(0.3, 0.6), (0.8, 0.6)} <= set(references)
    for reference in references.values():
        assert 0 < reference.fx_uncertainty < 0.05
        assert np.all(np.diff(reference.shear_mm) > 0)
        assert reference.fx_n[0] == pytest.approx(0, abs=1e-3)
    # More friction, more shear, and both below the drag that never slips.
    ends = [references[0.3, 0.6].fx_n[-1], references[0.8, 0.6].fx_n[-1]]
    without_slip = next(r for r in shear_references() if r.depth_mm == 0.6).fx_n[-1]
    assert ends[0] < ends[1] < without_slip
