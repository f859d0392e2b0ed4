"""The fit of a whole light predicts a synthetic sensor with scattered light and a flat field; bad input is refused."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gelgap.benchmarks.render.scenes import sphere_dent
from gelgap.calibrate.calibrator import (
    LightTask,
    _at_limits,
    _suspects,
    calibrate_light,
)
from gelgap.calibrate.check import _predicts_better, held_out_parts, table_share
from gelgap.calibrate.fit import LightFit
from gelgap.calibrate.light import Bars, SeenPoints
from gelgap.calibrate.pictures import PressPicture
from gelgap.calibrate.poses import place_presses
from gelgap.calibrate.profiles import PressProfiles, SolvedPress
from gelgap.calibrate.residual import fitted_residual, residual_around
from gelgap.calibrate.sensor_file import save_calibration
from gelgap.calibrate.start import lit_from_dents
from gelgap.render.flat_field import FlatField, FlatFieldMaps, save_maps
from gelgap.render.imaging import Camera, srgb_decode, srgb_encode
from gelgap.render.light.leds import Illumination
from gelgap.render.light.scattered import Scattered
from gelgap.render.renderer import MembraneRenderer
from gelgap.render.sensor import Markers, Sensor

SIZE_PX = (240, 180)
MIDDLE_PX, PX_PER_MM = np.array(SIZE_PX) / 2, SIZE_PX[0] / 12
POINTS = [(0.0, 0.0), (2.6, 1.6), (-2.6, -1.6), (2.6, -1.6), (-2.6, 1.6), (0.3, 2.0), (-0.4, -2.0)]
NEW_POINT = (1.4, 0.3)
DEPTHS = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85)


def profiles(diameters, deepest):
    solves = []
    for depth in DEPTHS:
        x, _, displacement = sphere_dent(depth)
        along = displacement[displacement.shape[0] // 2, len(x) // 2 :]
        contact = min(np.sqrt(depth * 1.5), 1.35)
        solves.append(SolvedPress(depth, x[len(x) // 2 :], along[:, 2], contact))
    return {3.0: PressProfiles.from_solves(1.5, solves)}


def truth(folder):
    rng = np.random.default_rng(0)
    low_order = tuple(tuple(row) for row in 0.03 * rng.standard_normal((3, 8)))
    light = Illumination.preset("i0").model_copy(
        update={"scattered": Scattered(order=2, coefficients=low_order)}
    )
    seams = 1 + 0.1 * (np.indices(SIZE_PX[::-1]).sum(0) // 9 % 2)[..., None] * np.ones(3)
    folder.mkdir()
    save_maps(FlatFieldMaps(seams.astype(np.float32)), folder / "seams.npz")
    update = {
        "illumination": light,
        "flat_field": FlatField(file="seams.npz").found_in(folder),
        "markers": Markers(layout="none"),
    }
    return Sensor.preset("paper").model_copy(update=update)


def psnr(picture, real):
    return 10 * np.log10(255**2 / max(np.mean((picture.astype(float) - real) ** 2), 1e-9))


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    sensor = truth(tmp_path_factory.mktemp("truth") / "sensor")
    renderer = MembraneRenderer(sensor, sensor.illumination, SIZE_PX)
    rng = np.random.default_rng(1)
    shots = [renderer.picture(*sphere_dent(0.6, point_mm=p), rng=rng) for p in (*POINTS, NEW_POINT)]
    start = sensor.model_copy(update={"illumination": Illumination.preset("i0"), "flat_field": None})
    return start, renderer.reference(rng=rng), shots


def pressed(shots, **depth):
    return tuple(
        PressPicture(shot, 3.0, point_mm=point, **depth) for shot, point in zip(shots, POINTS, strict=False)
    )


@pytest.fixture(scope="module")
def calibration(pictures):
    start, reference, shots = pictures
    return calibrate_light(start, reference, pressed(shots[:-1], depth_mm=0.6), profiles, folds=2)


def test_a_new_press_is_predicted(pictures, calibration, tmp_path):
    _, reference, shots = pictures
    save_calibration(calibration, tmp_path / "fitted.toml")
    sensor = Sensor.load(tmp_path / "fitted.toml")
    renderer = MembraneRenderer(sensor, sensor.illumination, SIZE_PX)
    assert psnr(renderer.reference(), reference) > 45  # with the seams, which no light has
    smaller = tuple(side // 2 for side in SIZE_PX)
    half = MembraneRenderer(sensor, sensor.illumination, smaller).reference()
    assert psnr(half, cv2.resize(reference, smaller, interpolation=cv2.INTER_AREA)) > 45
    predicted = renderer.picture(*sphere_dent(0.6, point_mm=NEW_POINT))
    assert psnr(predicted, shots[-1]) > max(32, psnr(reference, shots[-1]) + 6)


def test_untouched_gel_is_predicted_as_it_is_and_no_edge_shows_where_the_model_ends(pictures):
    start, reference, shots = pictures
    placed = place_presses(start.camera, reference, pressed(shots[:-1], depth_mm=0.6), profiles(None, None))
    fit = LightTask(start, placed, 2, 0, keep_camera=True).fit(np.arange(len(POINTS)))
    assert (
        psnr(placed.picture_of(fit.light, placed.untouched, 0, np.array([40.0, 0, 0.6]), 2.0), reference) > 45
    )
    point = np.array([0.0, 0.0, 0.6])
    narrow, wide = (
        placed.picture_of(fit.light, placed.untouched, 0, point, reach_mm).astype(int)
        for reach_mm in (1.0, 9.0)
    )
    away_mm = np.hypot(*(placed._plane_mm.T)).reshape(SIZE_PX[::-1])
    assert (narrow == wide)[away_mm < 1].all()
    unlike, change = (np.abs(other - wide) for other in (narrow, reference.astype(int)))
    lost_within, lost_beyond = (
        unlike[ring].mean() / change[ring].mean()
        for ring in (abs(away_mm - edge) < 0.1 for edge in (1.1, 1.9))
    )
    assert lost_within < 0.3
    assert lost_beyond > 0.7


def test_the_membrane_decays_beyond_its_solves_without_a_step():
    radius = np.arange(0, 7.05, 0.1)
    solves = [
        SolvedPress(depth, radius, -depth * np.exp(-2 * radius) + 0.05 * depth * np.exp(-radius / 4), 0.1)
        for depth in (0.2, 0.4, 0.6)
    ]
    z, slope = PressProfiles.from_solves(5.0, solves).at(0.5)
    far = np.arange(len(z)) * 0.02 > 5
    assert len(z) * 0.02 > 15
    assert (z[far] > 0).all()
    assert (np.diff(z[far]) < 0).all()
    assert abs(z[-1]) < 0.1 * z[far][0]
    assert np.abs(np.diff(slope[far])).max() < 0.05 * np.abs(slope[far]).max()


@pytest.fixture(scope="module")
def guided():
    """A sensor whose untouched gel is brightest opposite each LED, since it guides light: a smooth map by colour."""
    sensor = Sensor.preset("digit-like").model_copy(update={"markers": Markers(layout="none")})
    renderer = MembraneRenderer(sensor, sensor.illumination, SIZE_PX)
    width_mm = sensor.camera.footprint_mm(SIZE_PX)[0]
    rows, columns = np.indices(SIZE_PX[::-1])
    factor = np.empty((*rows.shape, 3))
    for channel, led in enumerate(sensor.illumination.leds):
        x, y = -np.array(led.position_mm[:2]) / np.hypot(*led.position_mm[:2])
        along = (x * (columns - SIZE_PX[0] / 2) + y * (rows - SIZE_PX[1] / 2)) / (SIZE_PX[0] / 2)
        factor[..., channel] = np.exp(1.5 * along) / np.exp(1.5 * along).mean()

    def shot(linear):
        return np.round(255 * srgb_encode(np.clip(factor * linear, 0, 1))).astype(np.uint8)

    extent_mm = (width_mm / 2 + 1, width_mm / 2 + 1)
    points = 1.4 * np.array([*POINTS, NEW_POINT])
    shots = [shot(renderer.linear(*sphere_dent(0.7, point_mm=p, half_extent_mm=extent_mm))) for p in points]
    presses = [
        PressPicture(picture, 3.0, point_mm=tuple(point), depth_mm=0.7)
        for picture, point in zip(shots, points.tolist(), strict=True)
    ]
    return shot(renderer.reference_linear()), presses, width_mm


def test_a_sensor_that_guides_light_is_fitted_without_leds_to_start_from(guided, tmp_path):
    reference, presses, width_mm = guided
    bare = Sensor(camera=Camera.showing(width_mm), markers=Markers(layout="none"))
    with pytest.raises(ValueError, match="no LEDs of its own"):
        calibrate_light(bare, reference, presses, profiles)
    fit = calibrate_light(lit_from_dents(bare, reference, presses), reference, presses, profiles, folds=2)
    save_calibration(fit, tmp_path / "fitted.toml")
    sensor = Sensor.load(tmp_path / "fitted.toml")
    renderer = MembraneRenderer(sensor, sensor.illumination, SIZE_PX)
    assert psnr(renderer.reference(), reference) > 45
    unchanged, table, marked = (
        np.median([getattr(press, kind) for press in fit.held_out], axis=0)
        for kind in ("unchanged", "table", "marked")
    )
    assert (marked > unchanged + 3).all()
    assert (marked > table).all()


def test_the_level_of_each_picture_is_taken_out(pictures, calibration):
    start, reference, shots = pictures
    levels = np.linspace(0.8, 1.2, len(POINTS))[:, None] * (1.0, 0.95, 1.05)
    presses = [
        replace(
            press,
            picture=np.round(
                255 * srgb_encode(np.clip(level * srgb_decode(press.picture / 255), 0, 1))
            ).astype(np.uint8),
        )
        for press, level in zip(pressed(shots[:-1], depth_mm=0.6), levels, strict=True)
    ]
    fit = calibrate_light(start, reference, presses, profiles, folds=0)
    np.testing.assert_allclose(fit.levels, levels, atol=0.02)
    assert fit.rms_code_values < calibration.rms_code_values + 1


def test_the_cameras_distance_is_found(pictures):
    start, reference, shots = pictures
    presses = pressed(shots[:-1], depth_mm=0.6)
    camera = start.camera.seen_from(120.0, SIZE_PX)  # 25 mm in truth
    far = start.model_copy(update={"camera": camera})
    fit = calibrate_light(far, reference, presses, profiles, folds=0)
    assert 18 < -fit.sensor.camera.position_mm[2] < 35
    np.testing.assert_allclose(fit.sensor.camera.footprint_mm(SIZE_PX), camera.footprint_mm(SIZE_PX))
    kept = calibrate_light(far, reference, presses, profiles, keep_camera=True, folds=0)
    assert kept.sensor.camera.position_mm == camera.position_mm
    assert kept.rms_code_values > fit.rms_code_values


@pytest.mark.parametrize("blur_px", [0.0, 2.0])
def test_the_cameras_blur_is_found(tmp_path, blur_px):
    sensor = truth(tmp_path / "sensor").model_copy(update={"flat_field": None})
    blurred = sensor.model_copy(
        update={"camera": sensor.camera.model_copy(update={"point_spread_px": blur_px})}
    )
    renderer, rng = MembraneRenderer(blurred, sensor.illumination, SIZE_PX), np.random.default_rng(3)
    shots = [renderer.picture(*sphere_dent(0.75, point_mm=point), rng=rng) for point in POINTS]
    presses, reference = pressed(shots, depth_mm=0.75), renderer.reference(rng=rng)
    start = sensor.model_copy(update={"illumination": Illumination.preset("i0")})
    placed = place_presses(start.camera, reference, presses, profiles(None, None))
    # Few presses do not tell blur from scattered light that depends on the place: this light does not.
    found, kept = (
        LightTask(start, placed, order=2, degree=0, keep_camera=keep).fit(np.arange(len(presses)))
        for keep in (False, True)
    )
    assert found.camera.point_spread_px == pytest.approx(blur_px, abs=0.7)
    assert kept.camera.point_spread_px == 0


def test_a_camera_at_another_distance_shows_the_same_of_the_flat_membrane():
    camera = Camera(radial_distortion=(-0.2, 0.1))
    points = np.random.default_rng(0).uniform(-5, 5, (20, 3)) * (1, 1, 0)
    for distance_mm in (15.0, camera.farthest_mm(SIZE_PX)):
        other = camera.seen_from(distance_mm, SIZE_PX)
        np.testing.assert_allclose(
            other.project_px(points, SIZE_PX), camera.project_px(points, SIZE_PX), atol=1e-9
        )


def test_held_out_presses_are_reported(calibration):
    assert sorted(press.name for press in calibration.held_out) == [f"press {k}" for k in range(1, 8)]
    fitted, unchanged = (
        np.median([getattr(press, kind) for press in calibration.held_out], axis=0)
        for kind in ("marked", "unchanged")
    )
    assert (fitted > unchanged + 3).all()


def test_the_share_of_the_table_predicts_best_and_in_no_region_worse_than_the_table():
    light, table = (30.0, 20.0), (28.0, 24.0)
    assert table_share([[light, (29.9, 22), (29, 23), (28.5, 23.5), table]] * 2) == 1.0
    assert table_share([[light, (29.9, 22), (29.5, 24.5), (28.5, 24.2), table]] * 2) == 0.5
    assert table_share([[(30, 25), (29.9, 24), (29, 24), (28.5, 24), table]] * 2) == 0.0


def test_presses_at_one_place_are_held_out_together():
    centers, radii = (
        np.array([(10, 10), (90, 10), (10, 12), (50, 80), (91, 11), (11, 10)], float),
        np.full(6, 30.0),
    )
    parts = held_out_parts(centers, radii, 3)
    assert [part.tolist() for part in parts] == [[0, 2, 5], [1, 4], [3]]
    apart = held_out_parts(40.0 * np.arange(14).reshape(7, 2), np.full(7, 30.0), 3)
    assert [part.tolist() for part in apart] == [[0, 3, 6], [1, 4], [2, 5]]
    assert held_out_parts(centers, radii, 0) == []
    for few in (centers[[0, 2, 5, 0]], centers[[0, 2, 5, 1]]):
        with pytest.raises(ValueError, match=r"4 presses lie at .* places, .* fewer than 3 would be left"):
            held_out_parts(few, radii[:4], 3)


def test_marked_circles_are_refined(pictures):
    start, reference, shots = pictures
    true_radius = profiles({3.0}, None)[3.0].contact_radius_mm(0.6)
    presses = tuple(
        replace(press, point_mm=(press.point_mm[0] + 0.1, press.point_mm[1] - 0.08))
        for press in pressed(shots[:-1], radius_px=true_radius * PX_PER_MM)
    )
    fit = calibrate_light(start, reference, presses, profiles, folds=0)
    np.testing.assert_allclose(fit.poses_mm[:, :2], POINTS, atol=0.06)
    np.testing.assert_allclose(fit.poses_mm[:, 2], 0.6, atol=0.1)


@pytest.mark.slow
def test_a_new_press_is_as_far_off_its_mark_as_the_fitted_ones(pictures):
    start, reference, shots = pictures
    (x, y), radius_px = (0.12, -0.1), profiles({3.0}, None)[3.0].contact_radius_mm(0.6) * PX_PER_MM

    def marked(off):
        presses = pressed(shots[:-1], radius_px=radius_px)
        moved = (
            replace(one, point_mm=(one.point_mm[0] + off * x, one.point_mm[1] + off * y)) for one in presses
        )
        fit = calibrate_light(start, reference, tuple(moved), profiles, folds=2)
        return np.median([press.marked for press in fit.held_out], axis=0)

    assert (marked(1.0) > marked(0.0) - 1.5).all()


def test_presses_far_out_of_the_others_are_named():
    errors = np.array([3.1, 3.3, 3.0, 31.0, 3.2, 4.6, 2.9, 3.4])

    def named(values):
        return _suspects(SimpleNamespace(press_errors=lambda: values**2)).tolist()

    assert named(errors) == [3]
    assert named(errors[:6]) == []  # six are always kept
    like_each_other = np.delete(errors, 3)
    assert named(like_each_other) == [4]  # the worst of few
    assert named(np.tile(like_each_other, 3)) == []


def test_a_gel_with_dots_is_fitted_at_full_size():
    size_px, sensor = (640, 480), Sensor.preset("paper")
    lit = sensor.model_copy(update={"illumination": Illumination.preset("i0")})
    renderer, rng = MembraneRenderer(lit, lit.illumination, size_px), np.random.default_rng(5)
    shots = [renderer.picture(*sphere_dent(0.6, point_mm=point), rng=rng) for point in POINTS]
    presses = pressed(shots, depth_mm=0.6)
    placed = place_presses(lit.camera, renderer.reference(rng=rng), presses, profiles(None, None))
    assert placed.has_dots
    last = len(presses) - 1
    fit = LightTask(lit, placed, 0, 0, keep_camera=True).fit(np.arange(last))
    # All 307,200 pixels are modelled, in one list of points.
    predicted = placed.picture_of(fit.light, fit.field, last, fit.expected_mm(last), 20.0)
    marked, unchanged = (placed.scores(last, picture) for picture in (predicted, placed.reference))
    assert (np.array(marked) > np.array(unchanged) + 3).all()


def test_what_is_fitted_to_a_limit_is_said(pictures):
    start, reference, shots = pictures
    (led, *others) = start.illumination.leds
    far = led.model_copy(update={"position_mm": (*np.array(led.position_mm[:2]) * 20, led.position_mm[2])})
    light = start.illumination.model_copy(update={"leds": (far, *others)})
    placed = place_presses(start.camera, reference, pressed(shots[:-1], depth_mm=0.6), profiles(None, None))
    task = LightTask(start.model_copy(update={"illumination": light}), placed, 0, 0, keep_camera=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(LightFit, "run", lambda self: None)
        fit = task.fit(np.arange(len(POINTS)))
    assert next(_at_limits(fit, ["far", *"bcd"])) == "distance of LED far (80.0 mm)"


def eight_presses(shots):
    return [
        PressPicture(shot, 3.0, point_mm=point, depth_mm=0.6)
        for shot, point in zip(shots, (*POINTS, NEW_POINT), strict=True)
    ]


def test_an_outlier_among_few_presses_is_named(pictures, calibration):
    start, reference, shots = pictures
    presses = eight_presses(shots)
    presses[2] = replace(presses[2], picture=np.roll(shots[2], 15, axis=1))
    fit = calibrate_light(start, reference, presses, profiles, keep_camera=True, folds=0)
    assert fit.left_out == ("press 3",)
    assert calibration.left_out == ()


def test_a_press_that_is_named_with_an_outlier_is_taken_back(pictures, monkeypatch):
    start, reference, shots = pictures
    presses = eight_presses(shots)
    presses[2] = replace(presses[2], picture=np.roll(shots[2], 15, axis=1))
    monkeypatch.setattr("gelgap.calibrate.calibrator._suspects", lambda fit: np.array([2, 4]))
    fit = calibrate_light(start, reference, presses, profiles, keep_camera=True, folds=0)
    assert fit.left_out == ("press 3",)
    assert len(fit.names) == 7


def changed(presses, **update):
    return (replace(presses[0], **update), *presses[1:])


def test_bad_presses_are_refused_before_anything_is_solved(pictures):
    start, reference, shots = pictures
    presses = pressed(shots[:-1], depth_mm=0.6)

    def unsolved(diameters, deepest):
        raise AssertionError

    for bad, said in (
        (presses[:5], "5 presses are too few .* takes 6"),
        (changed(presses, picture=shots[0][:-2]), "press 1 is a picture of 240×178"),
        (changed(presses, depth_mm=2.0), "sphere's radius"),
        (changed(presses, sphere_diameter_mm=-3.0), "sphere_diameter_mm is -3.0"),
        (changed(presses, depth_mm=None), "either depth_mm or radius_px"),
        (changed(presses, depth_mm=None, radius_px=-3), "radius_px is -3"),
        (changed(presses, marks_off_px=0), "marks_off_px is 0"),
        (changed(presses, sphere_diameter_mm=None), "press 1 must have sphere_diameter_mm, by --ball-mm"),
    ):
        with pytest.raises(ValueError, match=said):
            calibrate_light(start, reference, bad, unsolved)
    with pytest.raises(ValueError, match="7 presses cannot be held out in 8 parts"):
        calibrate_light(start, reference, presses, unsolved, folds=8)
    for unreadable, said in ((0, "reference is dark"), (255, "saturated in 100 % of its red channel")):
        with pytest.raises(ValueError, match=said):
            calibrate_light(start, np.full_like(reference, unreadable), presses, unsolved)


def test_presses_that_cannot_be_are_refused(pictures):
    start, reference, shots = pictures
    presses = pressed(shots[:-1], depth_mm=0.6)
    for bad, said in (
        (changed(presses, depth_mm=None, radius_px=68.0), "reaches .* mm at most"),
        (changed(presses, picture=reference), "no contact was found"),
        (changed(presses, picture=reference, point_mm=None), "no contact was found"),
        (changed(presses, point_mm=(90.0, 0.0)), "no contact was found"),
        (changed(presses, picture=np.full_like(reference, 255)), "press 1 is dark or saturated"),
        (changed(presses, depth_mm=1.2), "solved down to 0.84 mm"),
        (tuple(presses[:1]) * 6, "all presses lie within 0 px"),
    ):
        with pytest.raises(ValueError, match=said):
            calibrate_light(start, reference, bad, profiles)


def test_presses_near_each_other_are_fitted(pictures):
    start, reference, shots = pictures
    middle = pressed(shots[:1], depth_mm=0.6)[0]
    presses = [replace(middle, point_mm=(x, 0.0)) for x in (0.0, 0.1, 0.2, 0.3)]
    placed = place_presses(start.camera, reference, presses, profiles(None, None))
    spread_px = np.ptp(placed.centers_px, axis=0).max()
    assert 0.2 < spread_px / placed.radii_px.max() < 0.5


def test_a_fit_that_predicts_worse_than_the_reference_is_refused(pictures):
    start, reference, _ = pictures
    rng = np.random.default_rng(2)
    noise = [np.clip(reference + rng.normal(0, 60, reference.shape), 0, 255).astype(np.uint8) for _ in POINTS]
    with pytest.raises(ValueError, match="worse than the unchanged reference"):
        calibrate_light(start, reference, pressed(noise, depth_mm=0.6), profiles, folds=2)


@pytest.mark.slow
def test_rough_marks_are_only_where_to_look(pictures):
    start, reference, shots = pictures
    rng = np.random.default_rng(3)
    presses = tuple(
        PressPicture(
            shot,
            3.0,
            center_px=tuple(MIDDLE_PX + np.array(point) * PX_PER_MM + rng.uniform(-11, 11, 2)),
            radius_px=41.0,
            marks_off_px=15.0,
        )
        for shot, point in zip(shots[:-1], POINTS, strict=True)
    )
    fit = calibrate_light(start, reference, presses, profiles, folds=0)
    np.testing.assert_allclose(fit.poses_mm[:, :2], POINTS, atol=0.1)
    placed = place_presses(start.camera, reference, presses, profiles(None, None))
    few = LightTask(start, placed, 2, 0, keep_camera=True).fit(np.arange(6))
    # A rough mark does not say how deep a press is; the others do.
    assert abs(few.expected_mm(6)[2] - 0.6) < 0.08
    assert abs(placed.poses_mm[6, 2] - 0.6) > 0.15


def test_a_press_is_expected_off_its_mark_as_the_others_are(pictures):
    start, reference, shots = pictures
    right = pressed(shots[:-1], depth_mm=0.6)
    stretched = [replace(press, point_mm=tuple(1.1 * x for x in press.point_mm)) for press in right]
    placed = place_presses(start.camera, reference, stretched, profiles(None, None))
    last = len(right) - 1
    fit = LightTask(start, placed, 2, 0, keep_camera=True).fit(np.arange(last))
    expected, marked = (pose[:2] - POINTS[last] for pose in (fit.expected_mm(last), placed.poses_mm[last]))
    assert np.hypot(*expected) < 0.6 * np.hypot(*marked)


def test_a_bar_of_a_fit_lights_the_gel_as_the_renderers_does():
    sizes = {"distance": [8.0, 14.0], "height": [4.0, 9.0], "length": [20.0, 40.0], "tall": [6.0, 11.0]}
    bars = Bars(6.3, np.array([0.3, 2.0]), **{name: np.array(values) for name, values in sizes.items()})
    leds = bars.leds(("one", "other"), np.ones((2, 3)), np.ones(3), 1.0)
    render = MembraneRenderer(Sensor.preset("paper"), Illumination(leds=leds), quality="draft")
    at_mm = render.lattice.points_mm()[10:-10:10, 10:-10:10]
    found = SeenPoints.flat(at_mm.reshape(-1, 2)).bar_columns(SimpleNamespace(bars=bars))
    irradiance = render._reference_irradiance[10:-10:10, 10:-10:10].reshape(-1, 2)
    one = (bars.distance**2 + bars.height**2) / (bars.length * bars.tall)
    np.testing.assert_allclose(found, irradiance * one, rtol=0.005)


def test_a_blurring_camera_sees_a_blurred_dent(pictures):
    start, reference, shots = pictures
    camera = start.camera.model_copy(update={"point_spread_px": 8.0})
    own = profiles(None, None)[3.0]
    placed = place_presses(camera, reference, pressed(shots[:-1], depth_mm=0.6), {3.0: own})
    sharp, seen = (p.membrane((0.0, 0.0), 0.6, (6.0, 4.5))[2][..., 2] for p in (own, placed.seen_profiles[0]))
    sigma_cells = 8 / 320 * 12 / 0.1
    np.testing.assert_allclose(seen, gaussian_filter(sharp, sigma_cells), atol=0.004)
    assert np.abs(seen - sharp).max() > 0.02


def test_what_a_fit_leaves_around_balls_draws_a_press_that_it_has_not_seen(pictures):
    """A dark line at the rim, which no light draws, in pictures of six presses."""
    start, own = pictures[0], profiles(None, None)[3.0]
    renderer = MembraneRenderer(start, start.illumination, SIZE_PX)
    rows, columns = np.indices(SIZE_PX[::-1])

    def lined(point):
        x, y = MIDDLE_PX + PX_PER_MM * np.array(point) - 0.5
        radii = np.hypot(columns - x, rows - y) / PX_PER_MM / own.contact_radius_mm(0.6)
        line = 30 * np.exp(-(((radii - 1.1) / 0.15) ** 2))[..., None]
        return np.clip(renderer.picture(*own.membrane(point, 0.6, (7.0, 6.0))) - line, 0, 255).astype(
            np.uint8
        )

    presses = pressed([lined(point) for point in POINTS[:6]], depth_mm=0.6)
    placed = place_presses(start.camera, renderer.reference(), presses, {3.0: own})
    fit, pose = LightTask(start, placed, 2, 0, keep_camera=True).fit(np.arange(5)), placed.poses_mm[5]
    away = (placed.seen(5, pose).positions[:, :2] - pose[:2]) / own.contact_radius_mm(0.6)
    contact = np.array([*pose[:2] / placed.half_view_mm, own.contact_radius_mm(0.6)])
    left = residual_around(fit.ball_residual(0.0), away, contact)
    plain = placed.picture_of(fit.light, fit.field, 5, pose, 20.0)
    gain_db = np.subtract(placed.scores(5, plain + left.reshape(plain.shape)), placed.scores(5, plain))
    assert gain_db.min() > 2, gain_db
    fit.usable[:, 2] = 0.0
    assert not np.array(fit.ball_residual(0.0).coefficients)[:, 2].any()
    other = replace(placed.presses[1], sphere_diameter_mm=4.0)
    fit.placed = replace(placed, presses=(placed.presses[0], other, *placed.presses[2:]))
    assert fit.ball_residual(0.0) is None


def test_what_is_left_changes_over_the_radius_of_enough_contacts_and_no_further_than_they_do():
    def left_at(radius_mm, count):
        contacts = np.column_stack([np.zeros((count, 2)), np.linspace(1.0, 1.2, count)])
        index, points = np.repeat(np.arange(count), 300), np.random.default_rng(0).uniform(-2, 2, (300, 2))
        left = np.repeat(50 * (contacts[index, 2:] - 1.1), 3, axis=1)
        residual = fitted_residual(
            3.0, contacts, index, np.tile(points, (count, 1)), left, np.ones_like(left)
        )
        return residual_around(residual, np.full((1, 2), 0.5), np.array([0.0, 0.0, radius_mm]))[0, 0]

    assert left_at(1.2, 8) == pytest.approx(left_at(1.3, 8)) == pytest.approx(5, rel=0.2)
    assert left_at(1.1, 8) == pytest.approx(0, abs=0.1)
    assert left_at(1.2, 7) == pytest.approx(0, abs=0.1)


def test_what_is_left_around_balls_is_kept_if_it_gains_more_than_it_costs():
    def drawn(inside_db, around_db):
        return [SimpleNamespace(levels=lambda shares: [(inside_db, around_db)])]

    assert _predicts_better(drawn(31.0, 29.9), drawn(30.0, 30.0), 0.5)
    assert not _predicts_better(drawn(31.0, 29.7), drawn(30.0, 30.0), 0.5)
    assert not _predicts_better(drawn(30.0, 30.0), drawn(30.0, 30.0), 0.5)
