"""Calibration sets in the layout of the package `taxim` are read, without running or trusting anything in them."""

import numpy as np
import pytest

from gelgap.calibrate.taxim_sets import INSTALL, taxim_presses


def parts(n=3):
    blue = np.zeros((24, 32, 3), np.uint8)
    blue[..., 0] = 200
    return {
        "f0": blue,
        "imgs": np.stack([blue] * n),
        "touch_center": np.full((n, 2), 12),
        "touch_radius": np.full(n, 5.0),
    }


def test_channels_are_turned_to_rgb_and_marks_kept(tmp_path):
    np.savez(tmp_path / "dataPack.npz", **parts())
    found = taxim_presses(str(tmp_path))
    assert found.reference[0, 0].tolist() == [0, 0, 200]
    assert len(found.presses) == 3
    press = found.presses[0]
    assert (press.center_px, press.radius_px, press.depth_mm) == ((12.0, 12.0), 5.0, None)
    assert found.start.camera.footprint_mm((32, 24))[0] == pytest.approx(32 * 0.0295)
    assert found.start.camera.position_mm[2] == -25


def test_the_minis_marks_are_rough_and_its_ball_assumed(tmp_path):
    folder = tmp_path / "gelsight_mini"
    folder.mkdir()
    np.savez(folder / "dataPack.npz", **parts())
    found = taxim_presses(str(folder), mm_per_px=0.03)
    assert {(press.sphere_diameter_mm, press.marks_off_px) for press in found.presses} == {(1.4, 20.0)}
    assert found.start.camera.footprint_mm((32, 24))[0] == pytest.approx(32 * 0.03)


def test_lights_start_where_the_presses_show_them(tmp_path):
    lit = parts()
    lit["imgs"][:, 12, 14, 2] = 90  # red, to the right of the centre
    lit["imgs"][:, 16, 12, 1] = 90  # green, below it
    np.savez(tmp_path / "dataPack.npz", **lit)
    red, green, _ = taxim_presses(str(tmp_path)).start.illumination.leds
    # Out of the view, which is 0.94 mm wide, on the side that shines.
    (red_x, red_y, _), (green_x, green_y, _) = red.position_mm, green.position_mm
    assert min(red_x, green_y) > 0.94 / 2
    assert (red_y, green_x) == pytest.approx((0, 0), abs=1e-6)


@pytest.mark.parametrize(
    "change",
    [
        {"f0": np.array([{"a": 1}], dtype=object)},
        {"imgs": np.zeros((3, 24, 30, 3), np.uint8)},
        {"touch_radius": np.zeros(2)},
        {"touch_center": np.array([["a", "b"]] * 3)},
    ],
)
def test_other_files_are_refused(tmp_path, change):
    np.savez(tmp_path / "dataPack.npz", **parts() | change)
    with pytest.raises(ValueError, match="is not a calibration set"):
        taxim_presses(str(tmp_path))


def test_a_missing_package_or_folder_is_said(tmp_path, monkeypatch):
    with pytest.raises(FileNotFoundError, match=r"dataPack\.npz does not exist"):
        taxim_presses(str(tmp_path))
    monkeypatch.setattr("gelgap.calibrate.taxim_sets.find_spec", lambda name: None)
    with pytest.raises(FileNotFoundError, match=INSTALL.replace("==", ".*")):
        taxim_presses("gelsight")
