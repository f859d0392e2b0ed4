"""A folder of pictures of a pressed ball becomes a list of presses, or is refused in one sentence."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelgap.assets.image_file import SHEET, picture_files, visible_files
from gelgap.benchmarks.render.scenes import sphere_dent
from gelgap.calibrate import marks, press_folder
from gelgap.calibrate.pictures import read_press_list
from gelgap.calibrate.press_folder import mark_presses, stills_of
from gelgap.calibrate.profiles import PressProfiles, SolvedPress
from gelgap.render import Markers, MembraneRenderer, Sensor

SIZE_PX, BALL_MM, DEPTH_MM, EXTENT_MM = (160, 120), 3.0, 0.6, (10.5, 9.0)
PLACES_MM = (
    (-4.0, -2.0),
    (0.0, 0.0),
    (3.5, 2.0),
    (-3.0, 2.5),
    (2.0, -3.0),
    (7.6, 0.5),
)  # the last one is cut


def profiles(diameters: set[float]) -> dict[float, PressProfiles]:
    (diameter_mm,) = diameters
    scale, solves = diameter_mm / BALL_MM, []
    for depth in (0.2, 0.4, 0.6, 0.8, 1.0):
        x, y, displacement = sphere_dent(depth, half_extent_mm=EXTENT_MM)
        along = displacement[len(y) // 2, len(x) // 2 :, 2]
        sizes = (scale * size for size in (depth, x[len(x) // 2 :], along, (depth * BALL_MM / 2) ** 0.5))
        solves.append(SolvedPress(*sizes))
    return {diameter_mm: PressProfiles.from_solves(diameter_mm / 2, solves)}


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    """The picture without contact, and those of presses; with specks of dust, and the noise of a camera."""
    sensor = Sensor.preset("digit-like").model_copy(update={"markers": Markers(layout="none")})
    renderer, own = (
        MembraneRenderer(sensor, sensor.illumination, SIZE_PX, "draft"),
        profiles({BALL_MM})[BALL_MM],
    )
    rng = np.random.default_rng(0)
    dust = cv2.GaussianBlur(rng.normal(0, 6, (*SIZE_PX[::-1], 1)), (0, 0), 1.0)[..., None] * 3
    clean = [renderer.reference()] + [
        renderer.picture(*own.membrane(place, DEPTH_MM, EXTENT_MM)) for place in PLACES_MM
    ]
    return [np.clip(own + dust + rng.normal(0, 1, own.shape), 0, 255).astype(np.uint8) for own in clean]


@pytest.fixture
def folder(tmp_path: Path, pictures: list[np.ndarray], monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(press_folder, "sphere_profiles", profiles)
    for name, picture in zip("gabcdef", pictures, strict=True):
        cv2.imwrite(str(tmp_path / f"{name}.png"), picture[..., ::-1])
    return tmp_path


def mm_per_px() -> float:
    return Sensor.preset("digit-like").camera.footprint_mm(SIZE_PX)[0] / SIZE_PX[0]


def test_reference_centres_and_radii_are_found_also_of_a_cut_press(folder: Path) -> None:
    found = mark_presses(folder, BALL_MM, mm_per_px())
    assert (found.count, found.without_contact, found.doubts) == (6, (), ())
    listed = read_press_list(found.path)
    assert listed.reference == "g.png"
    camera, radius_px = Sensor.preset("digit-like").camera, (DEPTH_MM * BALL_MM / 2) ** 0.5 / mm_per_px()
    for press, place in zip(listed.presses, PLACES_MM, strict=True):
        centre = camera.project_px(np.array([*place, 0.0]), SIZE_PX) - 0.5
        assert np.hypot(*(centre - press.center_px)) < 1.5
        assert press.radius_px == pytest.approx(radius_px, rel=0.12)
        assert press.sphere_diameter_mm == BALL_MM
    assert cv2.imread(str(folder / SHEET)).shape[1] == 3 * 2 * 320
    assert SHEET not in [file.name for file in picture_files(visible_files(folder))]  # for adapt and predict


def test_what_may_have_been_corrected_is_not_overwritten(folder: Path) -> None:
    mark_presses(folder, BALL_MM, mm_per_px())
    with pytest.raises(ValueError, match=r"presses\.toml exists, and may have been corrected"):
        mark_presses(folder, BALL_MM, mm_per_px())


def test_a_folder_without_a_reference_is_refused(folder: Path) -> None:
    (folder / "g.png").unlink()
    with pytest.raises(ValueError, match="no picture seems to be without contact"):
        mark_presses(folder, BALL_MM, mm_per_px())
    assert not (folder / "presses.toml").exists()


def test_a_picture_of_another_size_is_refused(folder: Path) -> None:
    cv2.imwrite(str(folder / "z.png"), np.zeros((90, 120, 3), np.uint8))
    with pytest.raises(ValueError, match=r"z\.png is a picture of 120×90 px, and most are 160×120 px"):
        mark_presses(folder, BALL_MM, mm_per_px())


def test_a_ball_too_small_for_its_contacts_is_refused(folder: Path) -> None:
    with pytest.raises(ValueError, match=r"as large as a ball of 1\.5 mm diameter leaves at most"):
        mark_presses(folder, BALL_MM / 2, mm_per_px())


def test_a_moved_camera_and_a_press_of_another_body_are_named(folder: Path) -> None:
    moved = cv2.imread(str(folder / "b.png"))
    cv2.imwrite(str(folder / "b.png"), np.roll(moved, 6, axis=1))
    edge = cv2.imread(str(folder / "g.png")).astype(int)
    edge[10:110, 50:58], edge[10:110, 58:66] = edge[10:110, 50:58] + 60, edge[10:110, 58:66] - 60
    cv2.imwrite(str(folder / "c.png"), edge.clip(0, 255).astype(np.uint8))
    cv2.imwrite(str(folder / "rest2.png"), cv2.imread(str(folder / "g.png")))
    found = mark_presses(folder, BALL_MM, mm_per_px(), folder / "g.png")
    assert found.without_contact == ("rest2.png",)
    said = "; ".join(found.doubts)
    assert "not like the other dents of a ball, so look at mark and picture:" in said
    assert "c.png" in said
    assert "shifted against the reference, by up to 6 px, as if the camera had moved: b.png" in said


def test_a_second_imprint_and_a_press_unlike_the_others_are_named(folder: Path) -> None:
    rest, first, second = (cv2.imread(str(folder / f"{name}.png")).astype(int) for name in "gac")
    cv2.imwrite(str(folder / "a.png"), (first + second - rest).clip(0, 255).astype(np.uint8))
    cv2.imwrite(str(folder / "d.png"), cv2.imread(str(folder / "d.png"))[..., ::-1])
    said = "; ".join(mark_presses(folder, BALL_MM, mm_per_px(), folder / "g.png").doubts)
    assert re.search(r"not like the other dents of a ball[^;]*: [^;]*\bd\.png", said)
    assert re.search(r"a second imprint: [^;]*\ba\.png", said)


def test_a_blurred_and_a_stretched_picture_are_named(folder: Path) -> None:
    cv2.imwrite(str(folder / "a.png"), cv2.GaussianBlur(cv2.imread(str(folder / "a.png")), (0, 0), 3.0))
    stretched = cv2.resize(cv2.imread(str(folder / "d.png")), None, fx=1.3, fy=1.0)[:, 24:184]
    cv2.imwrite(str(folder / "d.png"), stretched)
    said = "; ".join(mark_presses(folder, BALL_MM, mm_per_px(), folder / "g.png").doubts)
    assert "as if out of focus or stretched: a.png" in said
    assert re.search(r"stretched: a\.png(,| and) d\.png|as if the camera had moved: d\.png", said)


def test_of_a_video_rest_and_the_stillest_picture_of_each_press_are_taken(
    pictures: list[np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    rest, one, other = (picture.astype(float) for picture in pictures[:3])
    shares = [(0, 0)] * 4 + [(0.4, 0), (0.8, 0), (1, 0), (1, 0), (1, 0), (0.5, 0), (0, 0), (0, 0)]
    shares += [(0, 0.5), (0, 0.95), (0, 0.95), (0, 0.95), (0, 0.3), (0, 0)]
    frames = [(rest + a * (one - rest) + b * (other - rest)).astype(np.uint8) for a, b in shares]
    monkeypatch.setattr(press_folder, "video_pictures", lambda path: iter(frames))
    stills = stills_of(Path("clip.mp4"))
    assert [*stills] == ["clip-rest.png", "clip-press-1.png", "clip-press-2.png"]
    np.testing.assert_array_equal(stills["clip-rest.png"], frames[0])
    np.testing.assert_array_equal(stills["clip-press-1.png"], frames[7])
    np.testing.assert_array_equal(stills["clip-press-2.png"], frames[14])


def test_by_how_much_contact_darkens_gel_is_told_from_where_it_is_level(pictures: list[np.ndarray]) -> None:
    rest, pressed = pictures[0], pictures[2]
    x, y = Sensor.preset("digit-like").camera.project_px(np.array([0.0, 0.0, 0.0]), SIZE_PX) - 0.5
    radius_px = (DEPTH_MM * BALL_MM / 2) ** 0.5 / mm_per_px()
    away = np.hypot(*(np.indices(rest.shape[:2]) - np.array([y, x])[:, None, None]))
    dark = np.where(away[..., None] < radius_px, 0.92 * pressed, pressed).astype(np.uint8)
    dents, off = marks._Dents.of(profiles({BALL_MM})[BALL_MM], mm_per_px()), []
    for picture in (pressed, dark):
        change = marks._Change.of(picture, rest, None)
        off.append(marks._level(change, dents, np.array([x + 1.0, y - 1.0, radius_px]), rest))
    assert [*off[0][:2], *off[1][:2]] == pytest.approx([-1.0, 1.0] * 2, abs=0.5)
    assert off[1][2] - off[0][2] == pytest.approx(0.08, abs=0.02)
