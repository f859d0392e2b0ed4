"""Lists of presses in TOML: what a calibration is given, with bad lists refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from gelgap.render.calibration.pictures import check_presses, read_presses


def listed(folder: Path, text: str) -> Path:
    cv2.imwrite(str(folder / "p.png"), np.zeros((24, 32, 3), np.uint8))
    path = folder / "presses.toml"
    path.write_text(f'[[presses]]\npicture = "p.png"\nsphere_diameter_mm = 3.0\n{text}\n')
    return path


def test_presses_are_read_beside_their_list(tmp_path: Path) -> None:
    red = np.zeros((24, 32, 3), np.uint8)
    red[..., 0] = 200
    cv2.imwrite(str(tmp_path / "p.png"), red[..., ::-1])
    listed = tmp_path / "presses.toml"
    listed.write_text('[[presses]]\npicture = "p.png"\nsphere_diameter_mm = 3.0\ndepth_mm = 0.6\n')
    (press,) = read_presses(listed)
    np.testing.assert_array_equal(press.picture, red)
    assert press.point_mm is None


def test_a_press_without_its_depth_is_refused(tmp_path: Path) -> None:
    listed = tmp_path / "presses.toml"
    listed.write_text('[[presses]]\npicture = "p.png"\nsphere_diameter_mm = 3.0\ndeep = 1\n')
    with pytest.raises(ValueError, match=r"presses\.toml: presses\.0: deep: extra inputs are not permitted"):
        read_presses(listed)


def test_a_marked_circle_is_read(tmp_path: Path) -> None:
    (press,) = read_presses(listed(tmp_path, "radius_px = 61\ncenter_px = [20, 11.5]"))
    assert (press.depth_mm, press.radius_px, press.center_px) == (None, 61, (20, 11.5))


def test_rough_marks_of_an_unknown_sphere_are_read(tmp_path: Path) -> None:
    path = listed(tmp_path, "radius_px = 61\nmarks_off_px = 20")
    path.write_text(path.read_text().replace("sphere_diameter_mm = 3.0\n", ""))
    (press,) = read_presses(path)
    assert (press.sphere_diameter_mm, press.marks_off_px) == (None, 20)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("depth_mm = nan", "depth_mm = nan: input should be a finite number"),
        ("radius_px = 5\ncenter_px = [1]", r"center_px\.1: field required"),
    ],
)
def test_values_that_are_no_numbers_are_refused(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        read_presses(listed(tmp_path, text))


def test_a_picture_elsewhere_is_refused(tmp_path: Path) -> None:
    path = listed(tmp_path, "depth_mm = 0.6")
    path.write_text(path.read_text().replace("p.png", "../p.png"))
    with pytest.raises(ValueError, match=r"picture = '\.\./p\.png': must lie in the folder of the list"):
        read_presses(path)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("presses = []", r"presses = \(\): tuple should have at least 1 item"),
        ("mm_per_px = 0", r"mm_per_px = 0: must lie in \[0\.001, 1\] mm"),
    ],
)
def test_an_empty_list_and_a_scale_that_cannot_be_are_refused(
    tmp_path: Path, text: str, problem: str
) -> None:
    path = listed(tmp_path, "depth_mm = 0.6")
    path.write_text(text if "[]" in text else f"{text}\n{path.read_text()}")
    with pytest.raises(ValueError, match=problem):
        read_presses(path)


def test_marks_of_a_larger_picture_are_refused(tmp_path: Path) -> None:
    presses = read_presses(listed(tmp_path, "radius_px = 6\ncenter_px = [39, 12]"))
    with pytest.raises(ValueError, match=r"center_px is \(39\.0, 12\.0\), .* no such circle .* 32×24 px"):
        check_presses(np.full((24, 32, 3), 90, np.uint8), presses)
