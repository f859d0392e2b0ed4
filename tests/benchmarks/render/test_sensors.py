"""The benchmark of real sensors, on a set that gelgap itself rendered in place of the package's."""

import json

import numpy as np
import pytest

from gelgap.benchmarks.render import rivals, sensors
from gelgap.benchmarks.render.scenes import sphere_dent
from gelgap.domains import PressSet
from gelgap.domains.calibration_presses import start_sensor
from gelgap.render import MembraneRenderer, PressPicture, PressProfiles, Sensor, SolvedPress

RADIUS_MM, DEPTH_MM, SIZE_PX = 2.0, 1.0, (160, 120)


def profiles(*_):
    solves = []
    for depth in (0.2, 0.5, 0.8, 1.1, 1.4):
        x, y, displacement = sphere_dent(depth, half_extent_mm=(10.5, 8.2), radius_mm=RADIUS_MM)
        along = displacement[len(y) // 2, len(x) // 2 :, 2]
        solves.append(SolvedPress(depth, x[len(x) // 2 :], along, min((depth * RADIUS_MM) ** 0.5, 1.8)))
    return {2 * RADIUS_MM: PressProfiles.from_solves(RADIUS_MM, solves)}


def rendered_set():
    sensor = Sensor.preset("gelsight-r1-fitted")
    renderer = MembraneRenderer(sensor, sensor.illumination, SIZE_PX)
    own, mm_per_px = profiles()[2 * RADIUS_MM], 18.88 / SIZE_PX[0]
    rng = np.random.default_rng(0)
    presses = []
    for point in rng.uniform((-5, -3), (5, 3), (14, 2)):
        picture = renderer.picture(*own.membrane(tuple(point), DEPTH_MM, (10.5, 8.2)))
        center = sensor.camera.project_px((*point, 0.0), SIZE_PX) - 0.5
        radius = own.contact_radius_mm(DEPTH_MM) / mm_per_px
        presses.append(PressPicture(picture, 2 * RADIUS_MM, center_px=tuple(center), radius_px=radius))
    start = start_sensor(640, np.radians([0.0, -120.0, 120.0]))
    return PressSet(renderer.reference(), tuple(presses), start)


@pytest.fixture
def found(monkeypatch):
    found = rendered_set()
    monkeypatch.setattr(sensors, "taxim_presses", lambda name: found)
    monkeypatch.setattr(sensors, "sphere_profiles", profiles)
    monkeypatch.setattr(rivals, "missing_packages", lambda: ("jax",))
    return found


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
    assert len(measured) == 1 + len(set(measured)) == 7


def test_marks_are_corrected_as_the_fitted_presses_were():
    rng = np.random.default_rng(0)
    true = rng.normal((1.0, -2.0, 1.7), (3.0, 3.0, 0.05), (200, 3))
    marked = true + rng.normal((0.2, 0.1, -0.1), (0.02, 0.02, 0.15), true.shape)
    fitted = np.arange(0, 200, 2)
    corrected = sensors.corrected_poses(marked, fitted, true[fitted])
    off, off_marked = (np.sqrt(((poses - true)[1::2] ** 2).mean(0)) for poses in (corrected, marked))
    assert (off[:2] < 0.03).all()
    assert off[2] < 0.06 < 0.12 < off_marked[2]
    same_depth = np.array([[0.0, 0.0, 1.5]] * 4)
    assert (sensors.corrected_poses(same_depth, np.arange(2), same_depth[:2] + 0.1)[:, 2] == 1.6).all()
