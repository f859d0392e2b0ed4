"""The benchmark of whatever sets of presses are in a folder, on one that gelgap itself rendered."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelgap.benchmarks.real import sensor_sets
from gelgap.benchmarks.render.scenes import sphere_dent
from gelgap.render import Markers, MembraneRenderer, PressProfiles, Sensor, SolvedPress

SIZE_PX = (120, 90)
RADIUS_MM, DEPTH_MM, EXTENT_MM = 1.5, 0.6, (10.5, 9.0)


def profiles(*_):
    solves = []
    for depth in (0.2, 0.4, 0.6, 0.8):
        x, y, displacement = sphere_dent(depth, half_extent_mm=EXTENT_MM)
        along = displacement[len(y) // 2, len(x) // 2 :, 2]
        solves.append(SolvedPress(depth, x[len(x) // 2 :], along, (depth * RADIUS_MM) ** 0.5))
    return {2 * RADIUS_MM: PressProfiles.from_solves(RADIUS_MM, solves)}


def write_set(folder: Path) -> None:
    sensor = Sensor.preset("digit-like").model_copy(update={"markers": Markers(layout="none")})
    renderer = MembraneRenderer(sensor, sensor.illumination, SIZE_PX, "draft")
    folder.mkdir(parents=True)
    cv2.imwrite(str(folder / "reference.png"), renderer.reference()[..., ::-1])
    own, rng = profiles()[2 * RADIUS_MM], np.random.default_rng(0)
    for name, count in (("presses.toml", 7), ("other-presses.toml", 2)):
        tables = []
        for number, (x, y) in enumerate(rng.uniform((-5, -3), (5, 3), (count, 2))):
            picture = renderer.picture(*own.membrane((x, y), DEPTH_MM, EXTENT_MM))
            file = f"{name[0]}-{number}.png"
            cv2.imwrite(str(folder / file), picture[..., ::-1])
            tables.append(
                f'[[presses]]\npicture = "{file}"\nsphere_diameter_mm = {2 * RADIUS_MM}\ndepth_mm = {DEPTH_MM}\n'
                f"point_mm = [{x}, {y}]\n"
            )
        (folder / name).write_text("".join(tables))
    camera = sensor.camera
    (folder / "start.toml").write_text(
        f"[camera]\nposition_mm = {list(camera.position_mm)}\n"
        f"horizontal_field_of_view_deg = {camera.horizontal_field_of_view_deg}\n"
        '[markers]\nlayout = "none"\n'
    )


def test_a_folder_of_ones_own_is_predicted(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sensor_sets, "sphere_profiles", profiles)
    write_set(tmp_path / "data" / "mine")
    sensor_sets.run(quick=False, out_dir=tmp_path / "out", data=tmp_path / "data")
    shown = " ".join(capsys.readouterr().out.split())
    assert "places held out: 7" in shown
    assert "all others after six: 1" in shown
    records = json.loads((tmp_path / "out" / "sensor-sets.json").read_text())["predictions"]
    ring = {(row["predicted"], row["model"]): np.median(row["ring"]) for row in records}
    for split in ("places held out: 7", "other list: 2"):
        assert ring[split, "gelgap"] > ring[split, "the reference, unchanged"] + 3


def test_places_are_held_out_whole():
    from types import SimpleNamespace

    marks = np.repeat(np.array([[10.0, 10], [50, 10], [10, 50], [50, 50], [30, 30]]), 3, axis=0)
    placed = SimpleNamespace(centers_px=marks, radii_px=np.full(len(marks), 8.0))
    parts = sensor_sets.SensorSet("set", None, len(marks)).splits(placed)["places held out"]
    assert len(parts) == 5
    for fitted, predicted in parts:
        assert not {tuple(mark) for mark in marks[fitted]} & {tuple(mark) for mark in marks[predicted]}


def test_a_folder_without_sets_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"holds no set of presses; presses\.toml"):
        sensor_sets.run(quick=True, out_dir=tmp_path, data=tmp_path)
