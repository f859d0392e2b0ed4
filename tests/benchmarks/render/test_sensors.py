"""The benchmark of real sensors, on a set that gelgap itself rendered in place of the package's."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gelgap.benchmarks.render import rivals, sensors
from gelgap.render import PressPicture


@pytest.fixture
def found(rendered_set, profiles, monkeypatch):
    monkeypatch.setattr(sensors, "taxim_presses", lambda name: rendered_set)
    monkeypatch.setattr(sensors, "sphere_profiles", profiles)
    monkeypatch.setattr(rivals, "missing_packages", lambda: ("jax",))
    return rendered_set


def test_odd_presses_are_predicted_better_than_by_the_reference(found, tmp_path, capsys):
    sensors.run(quick=True, out_dir=tmp_path)
    shown = " ".join(capsys.readouterr().out.split())
    assert "even presses fitted, 2 odd ones predicted" in shown
    assert 'Taxim\'s own pipeline is left out; install it: pip install "taxim[jax-cpu]==1.4.1"' in shown
    results = json.loads((tmp_path / "sensors.json").read_text())
    level = {(row["model"], row["press"]): np.median(row["inside"]) for row in results["predictions"]}
    assert level[sensors.WHOLE, "marked"] > level["the reference, unchanged", ""] + 8
    assert {model for model, _ in level} == {
        "the reference, unchanged",
        "table without physics",
        "table without physics, quadratic in the place",
        sensors.WHOLE,
    }
    assert not (tmp_path / "sensors.jsonl").exists()


def test_a_benchmark_that_was_stopped_goes_on(found, tmp_path, monkeypatch):
    measured = []

    def measure(study, setting):
        measured.append((setting["model"], setting["press"]))
        if len(measured) == 4:
            raise KeyboardInterrupt
        names = ("inside", "ring", "within", "whole", "SSIM", "mean abs")
        return {name: [30.0, 40.0] for name in names} | {"fit, s": 1.0, "ms per frame": 2.0}

    monkeypatch.setattr(sensors.Study, "measure", measure)
    with pytest.raises(KeyboardInterrupt):
        sensors.run(quick=True, out_dir=tmp_path)
    sensors.run(quick=True, out_dir=tmp_path)
    assert measured.count((sensors.WHOLE, "marked")) == 2
    assert len(measured) == 1 + len(set(measured)) == 6


@pytest.mark.slow
def test_the_size_of_an_unknown_ball_is_found_and_its_presses_are_predicted(
    found, tmp_path, monkeypatch, capsys
):
    presses = tuple(replace(press, sphere_diameter_mm=None) for press in found.presses)
    monkeypatch.setattr(sensors, "taxim_presses", lambda name: replace(found, presses=presses))
    sensors.run_unknown_ball(quick=True, out_dir=tmp_path)
    assert "ball fitted to the even presses: 4" in " ".join(capsys.readouterr().out.split())
    unchanged, whole = json.loads((tmp_path / "unknown-ball.json").read_text())["predictions"]
    assert (whole["model"], whole["press"], len(whole["inside"])) == (sensors.WHOLE, "refined", 2)
    assert np.median(whole["inside"]) > np.median(unchanged["inside"]) + 8


def test_presses_are_scored_by_regions():
    real = np.zeros((40, 60, 3), np.uint8)
    predicted = real.copy()
    predicted[20, 30] = 10
    predicted[2, 2] = 200
    levels = sensors.scores(predicted, PressPicture(real, 1.4, radius_px=4.0, center_px=(30.0, 20.0)))
    pixels = (np.hypot(*(np.indices((9, 9)) - 4)) < 4).sum()
    assert np.isclose(levels["inside"], 10 * np.log10(255**2 * pixels / 10**2))
    assert levels["within"] > levels["inside"]
    assert levels["whole"] < levels["inside"]
