"""Markers found in two pictures, matched over more than their pitch, and interpolated; what is not seen is left out."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator

from gelgap.assets import list_presets
from gelgap.assets.pinhole import OF_LIGHT, Pinhole
from gelgap.data import open_domain
from gelgap.data.frames.marker_motion import MarkerTracker, ThinPlate
from gelgap.render import Camera, Illumination, MembraneRenderer, Sensor, marker_rest_mm

X_MM, Y_MM = np.linspace(-7, 7, 71), np.linspace(-5.5, 5.5, 56)
WIDE = Camera(horizontal_field_of_view_deg=31.0, radial_distortion=(0.3, 0.0))


def drag_mm(places_mm: np.ndarray, far_mm: float) -> np.ndarray:
    """Return a drag (…, 2) along x and y, which fades within a few mm of the middle."""
    fading = np.exp(-(np.asarray(places_mm) ** 2).sum(axis=-1, keepdims=True) / (2 * 2.2**2))
    return far_mm * fading * np.array([0.8, -0.6])


def pictures(pattern: str, far_mm: float, camera: Camera) -> tuple[MembraneRenderer, np.ndarray, np.ndarray]:
    sensor = Sensor(camera=camera, markers=pattern)
    render = MembraneRenderer(sensor, Illumination.preset("i0"), quality="draft")
    moved = np.zeros((len(Y_MM), len(X_MM), 3))
    moved[..., :2] = drag_mm(np.stack(np.meshgrid(X_MM, Y_MM), axis=-1), far_mm)
    noise = np.random.default_rng(0)
    return render, render.reference(rng=noise), render.picture(X_MM, Y_MM, moved, rng=noise)


@pytest.mark.parametrize(
    ("pattern", "camera"), [("array-4", Camera()), ("circle-3", WIDE), ("diamond-2", Camera())]
)
def test_a_drag_beyond_the_pitch_is_followed_in_mm_whatever_pattern_and_camera(pattern, camera):
    render, reference, picture = pictures(pattern, 0.9, camera)
    tracker = MarkerTracker(reference, camera)
    printed_mm = marker_rest_mm(render.sensor.markers).reshape(-1, 2)
    apart = np.linalg.norm(tracker.rest_mm[:, None] - printed_mm, axis=2).min(axis=1)
    assert len(tracker.rest_mm) > 0.75 * len(printed_mm)
    assert apart.max() < 0.01
    off_mm = np.linalg.norm(tracker.displacement_mm(picture) - drag_mm(tracker.rest_mm, 0.9), axis=1)
    assert np.isnan(off_mm).mean() < 0.05
    assert np.nanmax(off_mm) < 0.02
    assert np.nanmax(np.abs(tracker.displacement_mm(reference))) == 0


def test_hidden_and_merged_markers_are_left_out_and_no_other():
    _, reference, picture = pictures("array-3", 0.3, Camera())
    tracker = MarkerTracker(reference, Camera())
    whole = tracker.displacement_mm(picture)
    hidden, one, other = 40, 60, 61
    at_px = (
        Camera().project_px(np.c_[tracker.rest_mm + whole, 0 * whole[:, 0]], (320, 240)).round().astype(int)
    )
    changed = picture.copy()
    left, top = at_px[hidden] - 9
    changed[top : top + 18, left : left + 18] = picture[top - 3, left - 3]
    cv2.line(changed, at_px[one].tolist(), at_px[other].tolist(), (20, 20, 20), 8)
    found = tracker.displacement_mm(changed)
    assert np.flatnonzero(np.isnan(found[:, 0]) & ~np.isnan(whole[:, 0])).tolist() == [hidden, one, other]
    kept = ~np.isnan(found[:, 0])
    np.testing.assert_allclose(found[kept], whole[kept], atol=0.004)


def test_the_plate_is_scipys_at_rest_far_away_also_where_markers_are_lost():
    rng = np.random.default_rng(0)
    places_mm, size, span_mm = rng.uniform((-5, -4), (5, 4), (60, 2)), (32, 24), (12.0, 9.0)
    values = drag_mm(places_mm, 0.5)
    values[[3, 17, 18]] = np.nan
    known = ~np.isnan(values[:, 0])
    angles = np.arange(24) * np.pi / 12
    around = np.stack([9 * np.cos(angles), 7.5 * np.sin(angles)], axis=1)
    x, y = (((np.arange(n) + 0.5) / n - 0.5) * span for n, span in zip(size, span_mm, strict=True))
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    plate = RBFInterpolator(np.vstack([places_mm[known], around]), np.vstack([values[known], 0 * around]))
    field = ThinPlate(places_mm, size, span_mm)(values)
    np.testing.assert_allclose(field, plate(grid.reshape(-1, 2)).reshape(grid.shape), atol=1e-5)
    np.testing.assert_allclose(field, drag_mm(grid, 0.5), atol=0.06)
    assert np.abs(ThinPlate(places_mm, size, span_mm)(np.full((60, 2), np.nan))).max() == 0


def test_what_cannot_be_followed_is_refused():
    _, reference, picture = pictures("array-1", 0.2, Camera())
    with pytest.raises(ValueError, match="the reference shows 0 markers; motion needs 8 or more"):
        MarkerTracker(np.full((240, 320, 3), 128, np.uint8), Camera())
    with pytest.raises(ValueError, match="both must be of one size"):
        MarkerTracker(reference, Camera()).displacement_mm(picture[:120])


def test_a_folder_of_pictures_says_how_many_mm_a_pixel_shows(tmp_path: Path):
    for name in ("reference.png", "0.png", "1.png"):
        cv2.imwrite(str(tmp_path / name), np.full((48, 64, 3), 90, np.uint8))
    assert open_domain(tmp_path).cameras == [None]
    (tmp_path / "sensor.toml").write_text("mm_per_px = 0.25\n")
    folder = open_domain(tmp_path)
    assert folder.cameras[0].footprint_mm((64, 48))[0] == pytest.approx(16)
    assert not folder.notes
    (tmp_path / "sensor.toml").write_text(
        "[camera]\nhorizontal_field_of_view_deg = 30.0\nexposure = 0.5\n[coating]\n"
    )
    assert open_domain(tmp_path).take(np.array([1])).cameras[0] == Pinhole(horizontal_field_of_view_deg=30.0)
    for wrong, problem in (
        ("[camera]\nfield_of_view_deg = 30.0\n", "field_of_view_deg: extra inputs are not permitted"),
        ("[camrea]\n", r"neither mm_per_px alone nor a sensor's table \[camera\]"),
    ):
        (tmp_path / "sensor.toml").write_text(wrong)
        with pytest.raises(ValueError, match=f"sensor.toml: .*{problem}"):
            open_domain(tmp_path).cameras  # noqa: B018
    (tmp_path / "sensor.toml").write_text("mm_per_px = true\n")
    with pytest.raises(ValueError, match=r"sensor.toml: mm_per_px = True: must be a number above 0"):
        open_domain(tmp_path).cameras  # noqa: B018


def test_a_cameras_fields_are_geometry_or_of_light():
    assert Camera.model_fields.keys() - Pinhole.model_fields.keys() == OF_LIGHT


def test_every_pattern_fills_its_field_with_a_marker_for_each_square_of_a_pitch():
    for name in list_presets("markers"):
        markers = Sensor(markers=name).markers
        places_mm = marker_rest_mm(markers).reshape(-1, 2)
        assert 0.7 < len(places_mm) / (markers.columns * markers.rows) < 1.2
        assert markers.spacing_mm == pytest.approx(markers.pitch_mm, rel=1e-6)
        assert (np.abs(places_mm).max(axis=0) < (5.8, 4.5)).all()
