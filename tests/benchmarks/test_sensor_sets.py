"""The benchmark of whatever sets of presses are in a folder, on one that gelgap itself rendered."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelgap.benchmarks import sensor_sets
from gelgap.benchmarks.common import read_records
from gelgap.benchmarks.render.scenes import sphere_dent
from gelgap.calibrate.profiles import PressProfiles, SolvedPress
from gelgap.render import Markers, MembraneRenderer, Sensor

SIZE_PX = (120, 90)
RADIUS_MM, DEPTH_MM, EXTENT_MM = 1.5, 0.6, (10.5, 9.0)


def profiles(*_, **__):
    solves = []
    for depth in (0.2, 0.4, 0.6, 0.8):
        x, y, displacement = sphere_dent(depth, half_extent_mm=EXTENT_MM)
        along = displacement[len(y) // 2, len(x) // 2 :, 2]
        solves.append(SolvedPress(depth, x[len(x) // 2 :], along, (depth * RADIUS_MM) ** 0.5))
    return {2 * RADIUS_MM: PressProfiles.from_solves(RADIUS_MM, solves)}


def write_set(folder: Path, presses: int = 7) -> None:
    sensor = Sensor.preset("digit-like").model_copy(update={"markers": Markers(layout="none")})
    renderer = MembraneRenderer(sensor, sensor.illumination, SIZE_PX, "draft")
    folder.mkdir(parents=True)
    cv2.imwrite(str(folder / "reference.png"), renderer.reference()[..., ::-1])
    own, rng, tables = profiles()[2 * RADIUS_MM], np.random.default_rng(0), []
    for number, (x, y) in enumerate(rng.uniform((-5, -3), (5, 3), (presses, 2))):
        picture = renderer.picture(*own.membrane((x, y), DEPTH_MM, EXTENT_MM))
        cv2.imwrite(str(folder / f"{number}.png"), picture[..., ::-1])
        tables.append(
            f'[[presses]]\npicture = "{number}.png"\nsphere_diameter_mm = {2 * RADIUS_MM}\ndepth_mm = {DEPTH_MM}\n'
            f"point_mm = [{x}, {y}]\n"
        )
    (folder / "presses.toml").write_text("".join(tables))
    camera = sensor.camera
    (folder / "start.toml").write_text(
        f"[camera]\nposition_mm = {list(camera.position_mm)}\n"
        f"horizontal_field_of_view_deg = {camera.horizontal_field_of_view_deg}\n"
        '[markers]\nlayout = "none"\n'
    )


def test_folders_of_ones_own_are_predicted_or_refused_with_the_reason(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sensor_sets, "sphere_profiles", profiles)
    write_set(tmp_path / "data" / "mine")
    write_set(tmp_path / "data" / "scarce", presses=1)
    shutil.copytree(tmp_path / "data" / "mine", tmp_path / "data" / "torn")
    (tmp_path / "data" / "torn" / "0.png").unlink()
    sensor_sets.run(quick=True, out_dir=tmp_path / "out", data=tmp_path / "data")
    said = capsys.readouterr().out
    assert "scarce is refused" in said
    assert "torn is refused" in said
    found = read_records(tmp_path / "out" / "sensors.jsonl")
    ring = found.set_index(["set", "model"])["ring"].to_dict()
    assert {name for name, _ in ring} == {"mine"}
    unchanged, *_, marked, refined = (np.median(ring["mine", model]) for model in sensor_sets.MODELS)
    assert min(marked, refined) > unchanged + 3
    assert [len(levels) for levels in ring.values()] == [7] * len(sensor_sets.MODELS)


def write_clones(folder: Path) -> None:
    """Write what is read of the published repositories, all pictures of one dent."""
    write_set(folder / "one", presses=1)
    rest, dent = (cv2.imread(str(folder / "one" / name)) for name in ("reference.png", "0.png"))
    fots, digit, gelslim = (folder / name for name in ("fots", "digit", "gelslim"))
    pictures = {
        fots / "0000.png": rest,
        **{fots / "gelsight" / f"{k}.png": dent for k in range(3)},
        digit / "calibration" / "blank.png": rest,
        **{digit / "probe_images" / f"{k}_x.png": dent for k in range(0, 150, 6)},
        gelslim / "data" / "ref.jpg": rest,
        **{gelslim / "data" / f"sample_{k}.jpg": dent for k in sensor_sets.GELSLIM_MARKS},
    }
    for path, picture in pictures.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), cv2.resize(picture, (360, 270)))
    (fots / "marks").mkdir()
    rows = "".join(f"./gelsight/{k}.png,180,{135 + k},30\n" for k in range(3))
    (fots / "marks" / "annotate.csv").write_text(f"img_names,center_x,center_y,radius\n{rows}")
    shutil.rmtree(folder / "one")


def test_published_clones_are_read(tmp_path):
    write_clones(tmp_path)
    found = {name: read() for name, read in sensor_sets.find_sets(tmp_path).items()}
    assert {name: len(own.presses) for name, own in found.items()} == {
        "digit/calibration": 25,
        "fots/marks": 3,
        "gelslim/data": 10,
    }
    fots = found["fots/marks"]
    assert fots.presses[2].center_px == (180, 137)
    assert fots.presses[2].sphere_diameter_mm == 5.0
    assert fots.start.camera.footprint_mm((360, 270))[0] == pytest.approx(360 / 19.58)
    places = [press.center_px for press in found["digit/calibration"].presses]
    assert len(set(places)) == 5
    assert all(len(own.start.illumination.leds) == 3 for own in found.values())


def test_a_folder_without_sets_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"holds no set of presses; presses\.toml"):
        sensor_sets.run(quick=True, out_dir=tmp_path, data=tmp_path)
