"""Marked presses are drawn with a fit, balls off their marks by its habit; bad lists are refused in a sentence."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from gelgap.calibrate import prediction
from gelgap.calibrate.prediction import predict_presses
from gelgap.calibrate.residual import fitted_residual
from gelgap.cli.main import main
from gelgap.render import Markers, MembraneRenderer, Sensor, save_sensor
from gelgap.render.flat_field import FlatField, FlatFieldMaps, save_maps
from gelgap.sim import Pose, load_indenter, solve_pose
from tests.calibrate.test_press_folder import BALL_MM, DEPTH_MM, EXTENT_MM, SIZE_PX, profiles

PLACES_MM = ((0.0, 0.0), (3.0, 1.5))
BALL = f"[[presses]]\nsphere_diameter_mm = {BALL_MM}\n"
BOX = '[[presses]]\nindenter = "box"\npoint_mm = [0.0, 0.0]\n'


@pytest.fixture(scope="module")
def renderer() -> MembraneRenderer:
    sensor = Sensor.preset("digit-like").model_copy(update={"markers": Markers(layout="none")})
    return MembraneRenderer(sensor, sensor.illumination, SIZE_PX, "draft")


@pytest.fixture
def sensor(tmp_path: Path, renderer: MembraneRenderer, monkeypatch: pytest.MonkeyPatch) -> Sensor:
    """A sensor with a flat field, saved as `fitted.toml`, beside its picture without contact."""
    monkeypatch.setattr(
        prediction, "sphere_profiles", lambda diameters, **_: profiles(diameters) if diameters else {}
    )
    cv2.imwrite(str(tmp_path / "ref.png"), renderer.reference()[..., ::-1])
    path = tmp_path / "fitted-flat-field.npz"
    digest = save_maps(FlatFieldMaps(np.ones((*SIZE_PX[::-1], 3), np.float32)), path)
    fitted = renderer.sensor.model_copy(update={"flat_field": FlatField(file=str(path), sha256=digest)})
    save_sensor(fitted, tmp_path / "fitted.toml")
    return fitted


def listed(folder: Path, text: str) -> Path:
    path = folder / "presses.toml"
    path.write_text(f'reference = "ref.png"\n{text}')
    return path


def test_balls_are_drawn_off_their_marks_by_the_habit_of_the_fit(
    tmp_path: Path, renderer: MembraneRenderer, sensor: Sensor
) -> None:
    own, text = profiles({BALL_MM})[BALL_MM], ""
    mm_per_px = renderer.sensor.camera.footprint_mm(SIZE_PX)[0] / SIZE_PX[0]
    for number, (x, y) in enumerate(PLACES_MM):
        picture = renderer.picture(*own.membrane((x, y), DEPTH_MM, EXTENT_MM))
        cv2.imwrite(str(tmp_path / f"{number}.png"), picture[..., ::-1])
        radius_px = own.contact_radius_mm(DEPTH_MM) / mm_per_px
        text += f'{BALL}picture = "{number}.png"\npoint_mm = [{x - 0.3}, {y}]\nradius_px = {radius_px}\n'
    habit = ((0.3, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    moved = predict_presses(sensor.model_copy(update={"marks_off": habit}), listed(tmp_path, text))
    unmoved = predict_presses(sensor, listed(tmp_path, text))
    tabled = sensor.model_copy(update={"normal_table": ((0.0, 0.0, 0.0),) * 27})
    flat = predict_presses(tabled, listed(tmp_path, text))
    assert [press.table for press in flat] == [press.unchanged for press in flat]
    for right, off in zip(moved, unmoved, strict=True):
        assert min(np.subtract(right.predicted, off.predicted)) > 5
        assert min(np.subtract(right.predicted, right.unchanged)) > 10


def test_a_ball_is_drawn_with_what_the_fit_left_around_it_and_another_without(
    tmp_path: Path, renderer: MembraneRenderer, sensor: Sensor, capsys: pytest.CaptureFixture[str]
) -> None:
    own, rng = profiles({BALL_MM})[BALL_MM], np.random.default_rng(0)
    picture = renderer.picture(*own.membrane((0.0, 0.0), DEPTH_MM, EXTENT_MM))
    cv2.imwrite(str(tmp_path / "a.png"), np.clip(picture[..., ::-1] + 3.0, 0, 255))
    contacts = np.array([[0.0, 0.0, own.contact_radius_mm(DEPTH_MM)]])
    index, away, left = np.zeros(4000, int), rng.uniform(-2.6, 2.6, (4000, 2)), np.full((4000, 3), 3.0)
    residual = fitted_residual(BALL_MM, contacts, index, away, left, np.ones((4000, 3)))
    fitted = tmp_path / "fitted.toml"
    save_sensor(sensor.model_copy(update={"ball_residual": residual}), fitted)
    press = f'{BALL}point_mm = [0.0, 0.0]\npicture = "a.png"\ndepth_mm = '
    path = listed(tmp_path, f"{press}{DEPTH_MM}\n{press}{DEPTH_MM / 2}\n")
    right, plain = (predict_presses(own, path)[0] for own in (Sensor.load(fitted), sensor))
    assert min(np.subtract(right.predicted, plain.predicted)) > 5
    main(["calibrate", str(path), "--predict", "--sensor", str(fitted), "-o", str(tmp_path / "out.toml")])
    assert "size or depth: press 2 (a.png)" in capsys.readouterr().out


def test_another_body_is_solved_where_it_is_and_as_it_is_turned(
    tmp_path: Path, renderer: MembraneRenderer, sensor: Sensor, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "body.toml").write_text('shape = "cylinder"\ndiameter_mm = 3.0\nedge_radius_mm = 0.4\n')
    gel, body = prediction.CALIBRATION_GEL, load_indenter(str(tmp_path / "body.toml"))
    state = solve_pose(gel, body, Pose(0.3, point_x_mm=1.0), "draft")
    picture = renderer.picture(state.x_mm, state.y_mm, state.displacement_mm)
    cv2.imwrite(str(tmp_path / "a.png"), picture[..., ::-1])
    press = '[[presses]]\nindenter = "body.toml"\npoint_mm = [1.0, 0.0]\ndepth_mm = 0.3\n'
    path, fitted = listed(tmp_path, press + 'picture = "a.png"\n' + press), str(tmp_path / "fitted.toml")
    main(["calibrate", str(path), "--predict", "--sensor", fitted, "-o", str(tmp_path / "out.toml")])
    assert "the press that gains least: press 1 (a.png), +" in capsys.readouterr().out
    compared, alone = (cv2.imread(str(tmp_path / f"out-predicted/predicted-0{n}.png")) for n in (1, 2))
    assert compared.shape[1] == 3 * SIZE_PX[0] == 3 * alone.shape[1]
    assert np.abs(alone[..., ::-1].astype(int) - picture).max() <= 2


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("presses = []\n", "presses = (): tuple should have at least 1 item"),
        (BOX + "depth_mm = 9.0\n", "press 1 (box): depth_mm = 9"),
        (BOX.replace("box", "bax") + "depth_mm = 0.3\n", "'bax'"),
        (BOX.replace("box", "none.toml") + "depth_mm = 0.3\n", "none.toml does not exist"),
        (BOX, "press 1 (box) must have depth_mm"),
        (BALL + "depth_mm = 0.3\npoint_mm = [0, 0]\nshear_mm = [0.1, 0]\n", "are for an indenter"),
        (BOX + BALL.partition("\n")[2], "must have either sphere_diameter_mm or indenter"),
        (BALL + "depth_mm = 0.3\n", "press 1 (ball) must have point_mm"),
        (BALL + "depth_mm = 1.8\npoint_mm = [0.0, 0.0]\n", "between 0 and the sphere's radius"),
        (BALL + 'depth_mm = 0.3\npicture = "small.png"\n', "is a picture of 24×16 px, and the fit is of"),
    ],
)
def test_presses_that_cannot_be_are_refused(tmp_path: Path, sensor: Sensor, text: str, problem: str) -> None:
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((16, 24, 3), np.uint8))
    with pytest.raises((ValueError, FileNotFoundError)) as refused:
        predict_presses(sensor, listed(tmp_path, text))
    assert problem in str(refused.value)
    assert "\n" not in str(refused.value)
