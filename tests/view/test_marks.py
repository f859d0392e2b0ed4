"""The page of a folder's marks: a circle is moved, a press left out, and the list says so."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelgap.assets.image_file import SHEET
from gelgap.calibrate.pictures import ListedPress, PressList, read_press_list
from gelgap.calibrate.press_folder import save_marks

pytest.importorskip("viser")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    presses, pictures = [], {}
    for name in ("ref.png", "a.png", "b.png"):
        pictures[name] = np.full((60, 80, 3), 100, np.uint8)
        cv2.imwrite(str(tmp_path / name), pictures[name])
    for name in ("a.png", "b.png"):
        marks = {"center_px": (20.0, 30.0), "radius_px": 8.0}
        presses.append(ListedPress(picture=name, sphere_diameter_mm=4.0, marks_off_px=2.0, **marks))
    listed = PressList(presses=tuple(presses), reference="ref.png", mm_per_px=0.1)
    save_marks(listed, tmp_path / "presses.toml", pictures)
    assert read_press_list(tmp_path / "presses.toml") == listed
    return tmp_path


def test_a_moved_circle_and_a_press_left_out_are_saved(folder: Path) -> None:
    from gelgap.view.marks import MarksPage

    page, sheet = MarksPage(folder, "127.0.0.1", 0), cv2.imread(str(folder / SHEET))
    try:
        page.x.value, page.radius.value = 25.5, 9.0
        page.handle.position = np.add(page.handle.position, (0.0, 1.25, 0.0))  # 10 px down
        page.drag()
        page.press.value = "b.png"
        assert (page.press.value, page.x.value, page.used.value) == ("b.png", 20.0, True)
        page.used.value = False
        page.press.value = "a.png"
        assert page.used.value
        page.save_list()
        (saved,) = read_press_list(folder / "presses.toml").presses
    finally:
        page.close()
    assert saved.center_px == pytest.approx((25.5, 40.0), abs=0.11)
    assert (saved.picture, saved.radius_px, saved.sphere_diameter_mm) == ("a.png", 9.0, 4.0)
    assert saved.marks_off_px == 2.0
    redrawn = cv2.imread(str(folder / SHEET))
    assert (redrawn[:, :320] != sheet[:, :320]).any()  # the moved circle
    assert not redrawn[:, 640:].any()  # one press is left


def test_a_folder_without_marked_presses_is_refused(folder: Path) -> None:
    from gelgap.view.marks import MarksPage

    text = (folder / "presses.toml").read_text()
    (folder / "presses.toml").write_text(text.replace("b.png", "a.png"))
    with pytest.raises(ValueError, match="a picture is listed twice"):
        MarksPage(folder, "127.0.0.1", 0)
    (folder / "presses.toml").write_text(re.sub(r"radius_px = .*", "depth_mm = 0.3", text))
    with pytest.raises(ValueError, match=r"press 1 \(a\.png\) must have picture, center_px and radius_px"):
        MarksPage(folder, "127.0.0.1", 0)
    (folder / "presses.toml").unlink()
    with pytest.raises(FileNotFoundError, match="first: gelgap calibrate"):
        MarksPage(folder, "127.0.0.1", 0)
