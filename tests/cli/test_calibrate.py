"""`gelgap calibrate`: from files to a sensor file, with bad lists refused."""

import re
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelgap.calibrate.check import HeldOut
from gelgap.calibrate.pictures import PressPicture, read_presses
from gelgap.calibrate.prediction import PredictedPress
from gelgap.calibrate.report import doubt_of_scale, prediction_lines
from gelgap.calibrate.sensor_file import LightCalibration
from gelgap.cli.main import main
from gelgap.render import Camera, Sensor
from gelgap.render.flat_field import FlatFieldMaps
from gelgap.render.light.scattered import Scattered


def test_the_list_that_help_shows_can_be_pasted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main(["calibrate", "--help"])
    (shown,) = re.findall(r"^( *\[\[presses\]\]\n(?: +\S.*\n)+)", capsys.readouterr().out, re.MULTILINE)
    (tmp_path / "presses.toml").write_text(shown)
    cv2.imwrite(str(tmp_path / "press-1.png"), np.zeros((24, 32, 3), np.uint8))
    (press,) = read_presses(tmp_path / "presses.toml")
    assert (press.sphere_diameter_mm, press.depth_mm, press.point_mm) == (3.0, 0.6, (1.5, -0.8))


def listed(folder: Path, text: str) -> Path:
    cv2.imwrite(str(folder / "p.png"), np.zeros((24, 32, 3), np.uint8))
    path = folder / "presses.toml"
    path.write_text(f'[[presses]]\npicture = "p.png"\nsphere_diameter_mm = 3.0\n{text}\n')
    return path


def test_too_few_presses_write_nothing(tmp_path: Path, refused: Callable[..., str]) -> None:
    presses = listed(tmp_path, "depth_mm = 0.6")
    given = presses, "--reference", tmp_path / "p.png", "--sensor", "digit-like"
    assert "1 presses are too few" in refused("calibrate", *given, "-o", tmp_path / "fitted.toml")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["p.png", "presses.toml"]


def fitted_light() -> LightCalibration:
    sensor = Sensor.preset("digit-like")
    maps = FlatFieldMaps(np.ones((24, 32, 3), np.float32))
    picture = np.zeros((24, 32, 3), np.uint8)
    held_out = HeldOut("press 1 (p.png)", (18, 24), (29, 30), (30, 31), (33, 34), picture)
    poses, gain = np.array([[0, 0, 0.6]]), ((), (), ())
    illumination = sensor.illumination.model_copy(update={"scattered": Scattered()})
    return LightCalibration(
        sensor=sensor.model_copy(update={"illumination": illumination}),
        maps=maps,
        gain=gain,
        volume_mm3=1.0,
        poses_mm=poses,
        rms_code_values=3.21,
        names=(held_out.name,),
        held_out=(held_out,),
    )


def test_a_fit_writes_held_out_pictures_uncertainty_and_error_unasked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gelgap.calibrate.calibrator.calibrate_light", lambda *_, **__: fitted_light())
    presses = listed(tmp_path, "depth_mm = 0.6")
    given = [str(presses), "--reference", str(tmp_path / "p.png"), "--sensor", "digit-like"]
    main(["calibrate", *given, "-o", str(tmp_path / "own.toml")])
    printed, known = capsys.readouterr().out, Sensor.load(tmp_path / "own.toml").known
    for said in (printed, known):
        assert "30.0 (30.0)" in said
        assert re.search(r"light from about [^°]* \d+°", said)
        assert re.search(r"camera about \d+ mm from the gel", said)
        assert "scale and ball are taken on trust" in said
    row = cv2.imread(str(tmp_path / "own-held-out" / "held-out-01.png"))
    assert row.shape == (24, 96, 3)
    assert (row[:, :64] == 0).all()
    assert (row[:, 64:] == 128).all()


def test_a_large_residual_is_warned_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    given = [str(listed(tmp_path, "depth_mm = 0.6")), "--reference", str(tmp_path / "p.png")]
    for rms, warned in ((4.9, False), (23.6, True)):
        fit = replace(fitted_light(), rms_code_values=rms)
        monkeypatch.setattr("gelgap.calibrate.calibrator.calibrate_light", lambda *_, fit=fit, **__: fit)
        main(["calibrate", *given, "--sensor", "digit-like", "-o", str(tmp_path / "own.toml")])
        assert ("gelgap: a residual of 23.60 code values" in capsys.readouterr().err) == warned


def test_what_makes_a_fit_doubtful_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    given = [str(listed(tmp_path, "depth_mm = 0.6")), "--reference", str(tmp_path / "p.png")]
    fit = fitted_light()
    bad = HeldOut("press 2 (q.png)", (18, 24), (29, 30), (30, 21.5), (33, 34), fit.held_out[0].picture)
    monkeypatch.setattr("gelgap.calibrate.report.held_out_pairs", lambda *_: [])
    for held_out, limits in ((fit.held_out, ()), ((*fit.held_out, bad), ("height of LED red (60.0 mm)",))):
        found = replace(fit, held_out=held_out, at_limits=limits)
        monkeypatch.setattr(
            "gelgap.calibrate.calibrator.calibrate_light", lambda *_, found=found, **__: found
        )
        main(["calibrate", *given, "--sensor", "digit-like", "-o", str(tmp_path / "own.toml")])
        out, err = capsys.readouterr()
        worse = "press 2 (q.png), around its contact 21.5 dB (unchanged reference 24.0)"
        assert (worse in out) == (worse in err) == bool(limits)
        assert ("at an end of the range searched, so it may lie beyond: height of" in out) == bool(limits)


@pytest.mark.parametrize(("around_db", "said"), [(24.9, "worse than doing nothing"), (25.1, "gains least")])
def test_a_sensor_that_predicts_worse_than_nothing_is_doubted(around_db: float, said: str) -> None:
    picture = np.zeros((2, 2, 3), np.uint8)
    press = PredictedPress("a", picture, picture, (30.0, around_db), (0.0, 0.0), (20.0, 25.0))
    assert said in prediction_lines([press])[-1]


def test_contacts_that_are_small_for_their_ball_are_doubted() -> None:
    picture, camera = np.zeros((60, 80, 3), np.uint8), Camera.showing(8.0)
    said = doubt_of_scale(camera, [PressPicture(picture, 4.0, radius_px=8.0)])
    assert said is not None
    assert said.startswith(
        "the ball touches in circles 0.40 times as wide as itself, and a picture shows 8.0 × 6.0 mm"
    )
    for fine in (PressPicture(picture, 4.0, radius_px=14.0), PressPicture(picture, 4.0, depth_mm=0.1)):
        assert doubt_of_scale(camera, [fine]) is None


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("labels.csv", "file,depth_mm\np.png,0.6\n", "is not a TOML file"),
        ("own.toml", "[camera]\n", "has no table [[presses]]"),
        ("15.9", None, "does not exist"),
    ],
)
def test_another_file_than_a_list_of_presses_is_refused(
    tmp_path: Path, refused: Callable[..., str], name: str, content: str | None, problem: str
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    given = tmp_path / name, "--reference", tmp_path / "p.png", "--mm-per-px", "0.03"
    said = refused("calibrate", *given, "-o", tmp_path / "own.toml")
    assert f"{name} {problem}" in said
    assert "needs a folder of pictures of a pressed ball, or a TOML file with a table [[presses]] for" in said


@pytest.mark.parametrize(
    ("scale", "said"),
    [("0", "must lie in [0.001, 1] mm per pixel"), ("0.01", "images would show 0.32 mm of the gel")],
)
def test_a_wrong_scale_is_refused(tmp_path: Path, refused: Callable[..., str], scale: str, said: str) -> None:
    given = listed(tmp_path, "depth_mm = 0.6"), "--reference", tmp_path / "p.png", "--mm-per-px", scale
    assert said in refused("calibrate", *given, "-o", tmp_path / "own.toml")


def test_what_is_missing_beside_the_presses_is_said(tmp_path: Path, refused: Callable[..., str]) -> None:
    presses = listed(tmp_path, "depth_mm = 0.6")
    assert "needs --reference" in refused("calibrate", presses, "-o", tmp_path / "fitted.toml")


def test_a_folder_that_takes_no_list_is_refused_before_anything_is_solved(
    tmp_path: Path, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "presses").mkdir()

    def temporary_file(dir: Path) -> None:
        if dir == tmp_path / "presses":
            raise OSError(30, "Read-only file system")

    monkeypatch.setattr("tempfile.TemporaryFile", lambda dir: temporary_file(dir) or nullcontext())
    monkeypatch.setattr("gelgap.calibrate.press_folder.mark_presses", lambda *_: pytest.fail("solved"))
    given = tmp_path / "presses", "--ball-mm", "3", "--mm-per-px", "0.05", "-o", tmp_path / "a.toml"
    assert "presses cannot be written to (Read-only file system)" in refused("calibrate", *given)
