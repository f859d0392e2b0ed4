"""The benchmark of disturbed pictures, on a small set that gelgap itself rendered."""

import json

import numpy as np
import pytest

from gelgap.benchmarks.render import robustness
from gelgap.benchmarks.render.robustness import DISTURBANCES, SPOILT, spoilt

BLURRED = "blurred by 2 px"


@pytest.fixture
def shown(rendered_set, profiles, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(robustness, "taxim_presses", lambda name: rendered_set)
    monkeypatch.setattr(robustness, "sphere_profiles", profiles)
    untouched = spoilt(lambda press, other: {"picture": rendered_set.reference})
    monkeypatch.setitem(DISTURBANCES, "untouched", untouched)
    monkeypatch.setattr(robustness, "QUICK", (BLURRED, "untouched"))
    robustness.run(quick=True, out_dir=tmp_path)
    records = json.loads((tmp_path / "sensor-robustness.json").read_text())["disturbances"]
    return {record["disturbance"]: record for record in records}, capsys.readouterr().out


def test_disturbed_presses_are_predicted_and_those_refused_are_reported(rendered_set, shown):
    records, text = shown
    blurred, untouched = records[BLURRED], records["untouched"]
    for region in ("inside", "ring"):
        levels = blurred[f"own.{region}"]
        assert len(levels) == len(blurred[f"undisturbed.{region}"]) == 7
        assert np.median(levels) > 30
        assert untouched[f"own.{region}"] == []
    name = rendered_set.presses[2 * SPOILT].name
    assert untouched["note"].startswith(f"refused: {name} hardly differs")
    assert f"the outlier is {name}" in text


def test_a_turned_start_has_its_lights_elsewhere_and_as_high(rendered_set):
    start, turned = rendered_set.start.illumination.leds, robustness.turned(rendered_set.start, 90.0)
    for led, other in zip(start, turned.illumination.leds, strict=True):
        x, y, z = led.position_mm
        assert other.position_mm == pytest.approx((-y, x, z))
