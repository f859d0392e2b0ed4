"""The contact point on real presses: rules without a network, what draws may see, the light's fit, tables, resuming."""

import json
from copy import copy
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from real_clones import write_ball_clone

from gelgap.benchmarks.common import read_records
from gelgap.benchmarks.real import ball_sensor, contact_point
from gelgap.benchmarks.real.ball_sensor import (
    LABELS,
    VIEW_MM,
    center_of_change_px,
    contact_points,
    dots_of,
    fitted_sensor,
    level_point_px,
    press_recipes,
)
from gelgap.benchmarks.real.contact_point import (
    QUICK,
    RULES,
    WINDOW_PX,
    RealPresses,
    centers_of,
    point_table,
    results_of,
    windows_of,
    with_point,
)
from gelgap.benchmarks.real.published_sets import converted_clone
from gelgap.cli.main import main
from gelgap.domains import ArrayFrames
from gelgap.render import Sensor

SIZE_PX = (240, 320)


def shaded_dent(x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a dent at (x, y) px, lit most from above, from the left and from the right by a colour each, and rest."""
    rows, columns = np.indices(SIZE_PX[::-1])
    right, down = columns - x, rows - y
    inside = np.exp(-(right**2 + down**2) / (2 * 20**2))
    # The upper flank changes by more than the lower one.
    change = np.stack([-right, 0.02 * down**2 - 2 * down, right], axis=2) * inside[..., None]
    rest = np.full((*SIZE_PX[::-1], 3), 120.0)
    dots = ((rows % 20 < 4) & (columns % 20 < 4))[..., None]
    pictures = [np.where(dots, 20.0, levels) for levels in (rest + 2 * change, rest)]
    return tuple(np.clip(np.round(picture), 0, 255).astype(np.uint8) for picture in pictures)


@pytest.mark.parametrize("center", [(120.0, 160.0), (95.3, 201.7)])
def test_the_change_vanishes_in_the_middle_of_a_dent_and_its_centroid_lies_towards_the_light(center):
    picture, rest = shaded_dent(*center)
    found = level_point_px(picture, rest, 16.0)
    assert found == pytest.approx(center, abs=1.0)
    assert center_of_change_px(picture.astype(int) - rest)[1] < center[1] - 2
    assert dots_of(picture)[160:164, 120:124].all()


@pytest.fixture(scope="module")
def clones(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a small clone."""
    folder = tmp_path_factory.mktemp("clones")
    write_ball_clone(folder / "gelsight")
    return folder


@pytest.fixture(scope="module")
def presses(clones: Path, tmp_path_factory: pytest.TempPathFactory) -> RealPresses:
    """Its presses."""
    folder = converted_clone("ball-presses", clones, tmp_path_factory.mktemp("converted"))
    return RealPresses(contact_points([folder / "ball-presses"]))


def test_a_draw_is_tested_on_clips_that_it_does_not_learn_from_and_a_pair_tests_all(presses: RealPresses):
    for draw in (0, 3):
        pool, tested = presses.halves(draw)
        assert not set(presses.clip[pool]) & set(presses.clip[tested])
        assert set(presses.labelled(draw, 3)) <= set(pool)
    (first, _), (_, second) = presses.halves(2), presses.halves(3)
    assert np.array_equal(first, second)


def test_the_centroid_of_a_spot_is_where_it_was_marked(presses: RealPresses):
    error_mm = presses.center_of_change_mm - presses.frames.label_values
    assert np.abs(error_mm).max() < 0.25


def test_the_mean_error_is_shown_apart(presses: RealPresses):
    _, tested = presses.halves(0)
    marks_mm = presses.frames.label_values[tested]
    found = results_of(presses, 0, marks_mm + np.array([0.3, -0.4]), 0.0)
    assert found["clip_mm"].keys() == set(presses.clip[tested])
    assert list(found["clip_mm"].values()) == pytest.approx([0.5] * len(found["clip_mm"]), abs=1e-4)
    assert max(found["clip_centered_mm"].values()) < 1e-4
    assert found["offset_mm"] == pytest.approx((0.3, -0.4), abs=1e-4)


def test_a_row_has_the_mean_distance_over_clips(presses: RealPresses):
    def of(labels: int, error_mm: float) -> dict:
        names = [
            f"{kind}.{clip}" for kind in ("clip_mm", "clip_centered_mm") for clip in np.unique(presses.clip)
        ]
        trial = {"method": "drawn light, x", "labels": labels, "draw": 0}
        return {**trial, **dict.fromkeys(names, error_mm), "offset_mm": (error_mm, 0.0), "seconds": 1.0}

    table = point_table(pd.DataFrame([of(0, 0.2), of(20, 0.4)]), presses)
    assert [row[1:3] for row in table.rows] == [[0, "0.200"], [20, "0.400"]]


def test_a_window_and_its_label_say_where_the_point_is_and_nothing_changes_beyond_the_picture():
    picture, rest = shaded_dent(25.0, 300.0)
    points_mm = {"x_mm": np.array([-9.45]), "y_mm": np.array([14.05])}
    windows = windows_of(ArrayFrames("corner", picture[None], rest, None, **points_mm))
    assert (centers_of(windows) + windows.label_values)[0] == pytest.approx([-9.45, 14.05])
    assert len(with_point(windows)) == 1
    seen = windows.picture(0).astype(int) - windows.reference
    assert seen.shape == (WINDOW_PX, WINDOW_PX, 3)
    assert not seen[:, :5].any()
    assert not seen[-5:].any()
    assert np.abs(seen).max() > 20


def test_both_lights_have_the_same_presses_and_every_point_is_in_view():
    drawn = press_recipes(3, 10, 2)
    fitted = press_recipes(3, 10, 2, Sensor.preset("gelsight-mini-like"))
    for one, other in zip(drawn, fitted, strict=True):
        assert one.path == other.path
        assert one.elastomer == other.elastomer
        assert one.sensor.markers == other.sensor.markers
        assert one.illumination != other.illumination
        assert one.sensor.camera.footprint_mm(one.size_px) == pytest.approx(VIEW_MM, rel=1e-3)
        points = np.array([(pose.point_x_mm, pose.point_y_mm) for pose in one.path.poses])
        assert (points >= LABELS.low).all()
        assert (points <= LABELS.high).all()


def test_the_light_is_fitted_without_any_mark(presses: RealPresses, tmp_path: Path, monkeypatch):
    given = []

    def fit(start, reference, listed, membranes, keep_camera):
        given.append([(press.center_px, press.radius_px, press.picture) for press in listed])
        raise ValueError("seen enough")

    monkeypatch.setattr(ball_sensor, "calibrate_light", fit)
    elsewhere = copy(presses.frames)
    elsewhere.columns = elsewhere.columns | {axis: elsewhere.columns[axis] + 3.0 for axis in ("x_mm", "y_mm")}
    for marked in (presses.frames, elsewhere):
        with pytest.raises(ValueError, match="seen enough"):
            fitted_sensor(marked, tmp_path / "fitted.toml")
    assert repr(given[0]) == repr(given[1])


@pytest.mark.usefixtures("coarse")
def test_the_quick_form_runs_from_the_command_line_and_repeats_nothing(
    clones: Path, tmp_path: Path, capsys, monkeypatch
):
    command = ["benchmark", "real", "--what", "contact-point", "--quick"]
    command += ["--data", str(clones), "--out", str(tmp_path)]
    main(command)
    printed = capsys.readouterr().out
    assert "Contact point of real ball presses" in printed
    (path,) = (tmp_path / "real/contact-point").glob("*/points.jsonl")
    records = read_records(path)
    assert set(RULES) < set(records["method"])
    assert set(records["draw"]) == set(QUICK.draws)
    assert set(records["labels"]) == {0, *QUICK.few}
    assert records.filter(like="clip_mm.").mean(axis=1).between(0, 20, inclusive="neither").all()
    monkeypatch.setattr(contact_point.Trials, "measure", lambda *_: pytest.fail("measured again"))
    main(command)
    table = json.loads((tmp_path / "real-contact-point.json").read_text())
    assert len(table["rows"]) == len(records.groupby(["method", "labels"]))


def test_a_missing_clone_comes_with_the_line_that_gets_it(tmp_path: Path, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(
            ["benchmark", "real", "--what", "contact-point", "--data", str(tmp_path), "--out", str(tmp_path)]
        )
    assert stopped.value.code == 2
    said = capsys.readouterr().err
    assert f"git clone https://github.com/yanglh14/gelsight {tmp_path / 'gelsight'}" in said
