"""`gelgap calibrate`: from files to a sensor file, with bad lists refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from gelgap.cli.calibrate import read_presses
from gelgap.cli.main import main


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
    with pytest.raises(ValueError, match="deep, depth_mm"):
        read_presses(listed)


def listed(folder: Path, text: str) -> Path:
    cv2.imwrite(str(folder / "p.png"), np.zeros((24, 32, 3), np.uint8))
    path = folder / "presses.toml"
    path.write_text(f'[[presses]]\npicture = "p.png"\nsphere_diameter_mm = 3.0\n{text}\n')
    return path


def test_a_marked_circle_is_read(tmp_path: Path) -> None:
    (press,) = read_presses(listed(tmp_path, "radius_px = 61\ncenter_px = [20, 11.5]"))
    assert (press.depth_mm, press.radius_px, press.center_px) == (None, 61, (20, 11.5))


@pytest.mark.parametrize("text", ['depth_mm = "deep"', "depth_mm = nan", "radius_px = 5\ncenter_px = [1]"])
def test_values_that_are_no_numbers_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ValueError, match="finite number"):
        read_presses(listed(tmp_path, text))


def test_too_few_presses_write_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    presses = listed(tmp_path, "depth_mm = 0.6")
    given = [str(presses), "--reference", str(tmp_path / "p.png"), "--sensor", "digit-like"]
    with pytest.raises(SystemExit, match="2"):
        main(["calibrate", *given, "-o", str(tmp_path / "fitted.toml")])
    assert "1 presses are too few" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["p.png", "presses.toml"]


def test_without_presses_what_is_missing_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["calibrate", "-o", str(tmp_path / "fitted.toml")])
    assert "needs PRESSES" in capsys.readouterr().err
