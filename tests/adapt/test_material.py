"""Another modulus: the ratio that a few loads give, what is refused, and a model that is scaled by it."""

from dataclasses import replace

import numpy as np
import pytest

from gelgap.adapt import ForceModel, fit_modulus_ratio, predict_each, with_modulus_ratio
from gelgap.adapt.model import AffineCorrection
from gelgap.data import Labels
from gelgap.sim import Elastomer, Pose, Sphere, solve_poses


@pytest.mark.usefixtures("coarse")
def test_a_curve_of_loads_gives_the_modulus_whatever_the_rig_gives_way():
    """Two gels on rigs of their own: at equal depths of the rig, forces are not as the moduli."""
    curves = []
    for modulus_mpa, stiffness in ((0.7, 20.0), (1.4, 60.0)):
        gel = Elastomer(
            young_modulus_mpa=modulus_mpa,
            poisson_ratio=0.49,
            friction=0.24,
            mount_stiffness_n_per_mm=stiffness,
        )
        poses = [Pose(depth_mm=depth_mm) for depth_mm in (0.2, 0.4, 0.6)]
        states = solve_poses(gel, Sphere(diameter_mm=4.0), poses, "draft")
        fz_n = np.array([state.force_n[2] for state in states])
        depth_mm = np.array([pose.depth_mm for pose in poses])
        curves.append((depth_mm, fz_n, depth_mm - abs(fz_n) / stiffness))
    (depth_mm, soft_n, soft_mm), (_, hard_n, hard_mm) = curves
    inside = hard_mm <= soft_mm.max()
    ratio, error = fit_modulus_ratio(hard_n[inside], np.interp(hard_mm[inside] ** 1.5, soft_mm**1.5, soft_n))
    assert ratio == pytest.approx(2, abs=0.03)
    assert error < 0.02
    by_the_rig, _ = fit_modulus_ratio(hard_n, soft_n)
    assert abs(by_the_rig - 2) > 0.1


def test_the_error_of_the_ratio_is_what_repeated_draws_scatter_by():
    rng, expected_n = np.random.default_rng(0), -np.linspace(0.4, 2, 5)
    fits = [fit_modulus_ratio(2 * expected_n + rng.normal(0, 0.1, 5), expected_n) for _ in range(400)]
    ratios, errors = np.transpose(fits)
    assert ratios.mean() == pytest.approx(2, abs=0.01)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(ratios.std(), rel=0.1)


@pytest.mark.parametrize(
    ("measured_n", "expected_n", "message"),
    [
        ([-1.0], [-0.5], r"measured loads \(1,\) and expected ones \(1,\): .* two loads or more"),
        ([-1.0, -2.0], [-0.5], r"measured loads \(2,\) and expected ones \(1,\)"),
        ([-1.0, np.nan], [-0.5, -1.0], "load 2: nan N is measured and -1 N expected"),
        ([-1.0, 2.0], [-0.5, -1.0], "load 2: 2 N is measured and -1 N expected; .* of one sign"),
        ([-1.0, -2.0], [-0.5, 0.0], "load 2: .* not 0"),
        ([-1.0, -2.0, -3.0], [-0.5, -1.5, -1.0], "load 3: -3 N is measured where -1 N .* rise with depth"),
    ],
)
def test_loads_that_are_no_curve_are_refused(measured_n, expected_n, message):
    with pytest.raises(ValueError, match=message):
        fit_modulus_ratio(measured_n, expected_n)


def test_forces_are_scaled_and_the_model_is_kept_so(stage1, target, tmp_path):
    with_modulus_ratio(stage1, 2).save(tmp_path / "hard.pt")
    hard = ForceModel.load(tmp_path / "hard.pt")
    np.testing.assert_allclose(hard.predict_n(target), 2 * stage1.predict_n(target))
    again = with_modulus_ratio(hard, 0.5)
    np.testing.assert_allclose(again.predict_n(target), stage1.predict_n(target))
    # Notes compare predictions with the scaled range.
    picture = [("a.png", target.picture(int(target.force_n[:, 2].argmin())))]
    notes = [
        row["note"] for model in (stage1, hard) for row in predict_each(model, picture, target.reference)
    ]
    assert notes[0] == notes[1] == ""
    full = replace(stage1, correction=AffineCorrection((2.0,) * 3, (0.0, 0.0, -6.0)))
    (row,) = predict_each(full, picture, target.reference)
    assert row["note"] == ""


def test_what_a_modulus_does_not_scale_stays_or_is_refused(stage1, target):
    labels = Labels(("x_mm", "y_mm", "fz_n"), ((-5.0, 5.0), (-4.0, 4.0), (-3.0, 0.0)))
    mixed = replace(stage1, labels=labels)
    np.testing.assert_allclose(
        with_modulus_ratio(mixed, 3).predict_frames(target), mixed.predict_frames(target) * [1, 1, 3]
    )
    for ratio in (0, -1, np.inf, np.nan):
        with pytest.raises(ValueError, match=r"ratio of moduli = .*: must be finite and above 0"):
            with_modulus_ratio(stage1, ratio)
    places = replace(stage1, labels=Labels(("x_mm", "y_mm", "depth_mm"), ((-5, 5), (-4, 4), (0, 1))))
    with pytest.raises(ValueError, match="predicts x_mm, y_mm, depth_mm: no force that a modulus would"):
        with_modulus_ratio(places, 2)
