"""What a calibration is given: lists of presses in TOML, with bad ones refused, and contacts found in pictures."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from gelgap.calibrate.pictures import check_presses, find_contact_mm, read_presses


def listed(folder: Path, text: str) -> Path:
    cv2.imwrite(str(folder / "p.png"), np.zeros((24, 32, 3), np.uint8))
    path = folder / "presses.toml"
    path.write_text(f'[[presses]]\npicture = "p.png"\nsphere_diameter_mm = 3.0\n{text}\n')
    return path


def test_presses_are_read_beside_their_list(tmp_path: Path) -> None:
    path, red = listed(tmp_path, "depth_mm = 0.6"), np.zeros((24, 32, 3), np.uint8)
    red[..., 0] = 200
    cv2.imwrite(str(tmp_path / "p.png"), red[..., ::-1])
    (press,) = read_presses(path)
    np.testing.assert_array_equal(press.picture, red)
    assert press.point_mm is None


def test_a_marked_circle_is_read(tmp_path: Path) -> None:
    (press,) = read_presses(listed(tmp_path, "radius_px = 61\ncenter_px = [20, 11.5]"))
    assert (press.depth_mm, press.radius_px, press.center_px) == (None, 61, (20, 11.5))


def test_rough_marks_of_an_unknown_sphere_are_read(tmp_path: Path) -> None:
    path = listed(tmp_path, "radius_px = 61\nmarks_off_px = 20")
    path.write_text(path.read_text().replace("sphere_diameter_mm = 3.0\n", ""))
    (press,) = read_presses(path)
    assert (press.sphere_diameter_mm, press.marks_off_px) == (None, 20)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("0.6", "nan", "depth_mm = nan: input should be a finite number"),
        ("depth_mm = 0.6", "radius_px = 5\ncenter_px = [1]", r"center_px\.1: field required"),
        ("depth_mm", "deep", r"presses\.toml: presses\.0: deep: extra inputs are not permitted"),
        ("p.png", "../p.png", r"picture = '\.\./p\.png': must lie in the folder of the list"),
        ("[[presses]]", "mm_per_px = 0\n[[presses]]", r"mm_per_px = 0: must lie in \[0\.001, 1\] mm"),
        ("[[presses]]", "presses = []\n[other]", r"presses = \(\): tuple should have at least 1 item"),
    ],
)
def test_a_list_that_is_no_such_list_is_refused(tmp_path: Path, old: str, new: str, problem: str) -> None:
    path = listed(tmp_path, "depth_mm = 0.6")
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ValueError, match=problem):
        read_presses(path)


def test_marks_of_a_larger_picture_are_refused(tmp_path: Path) -> None:
    presses = read_presses(listed(tmp_path, "radius_px = 6\ncenter_px = [39, 12]"))
    with pytest.raises(ValueError, match=r"center_px is \(39\.0, 12\.0\), .* no such circle .* 32×24 px"):
        check_presses(np.full((24, 32, 3), 90, np.uint8), presses)


@pytest.mark.parametrize("light", ["i0", "i1"])
def test_a_contact_is_found_in_the_picture(renderer, dent, light):
    render = renderer(light)
    found = find_contact_mm(
        render.picture(*dent(0.7, point_mm=(2.0, -1.0))), render.reference(), render.sensor.camera
    )
    assert np.hypot(found[0] - 2, found[1] + 1) < 0.15
