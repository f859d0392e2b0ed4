"""What must hold for any picture: additivity, symmetry, directions, sizes, determinism, refusals."""

import multiprocessing
import pickle
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from gelgap.assets import list_presets
from gelgap.render.imaging import Camera, encode, sensor_noise
from gelgap.render.light.leds import Illumination
from gelgap.render.rasterizer import LOCK
from gelgap.render.renderer import MembraneRenderer
from gelgap.render.sensor import Coating, Markers, Sensor, marker_rest_mm
from gelgap.render.surface import _world_heights, deformed_surface, shared_surface

pytestmark = pytest.mark.numerical


def centroid_px(darkness):
    rows, columns = np.indices(darkness.shape)
    return np.array([(columns + 0.5).ravel() @ darkness.ravel(), (rows + 0.5).ravel() @ darkness.ravel()]) / (
        darkness.sum()
    )


def test_a_flat_membrane_renders_the_reference_exactly(renderer, dent):
    size_px = (64, 48)
    x, y, displacement = dent()
    flat = renderer("i0", size_px).picture(x, y, 0 * displacement)
    assert flat.shape == (size_px[1], size_px[0], 3)
    assert flat.dtype == np.uint8
    assert np.array_equal(flat, renderer("i0", size_px).reference())


def test_light_adds_up(renderer, dent):
    whole = renderer("i0")
    sensor, leds = whole.sensor, whole.illumination.leds
    parts = [
        MembraneRenderer(sensor, Illumination(leds=chosen)).linear(*dent(0.8, (0.3, 0.0)), markers=False)
        for chosen in (leds[:1], leds[1:])
    ]
    np.testing.assert_allclose(sum(parts), whole.linear(*dent(0.8, (0.3, 0.0)), markers=False), atol=2e-6)


@pytest.mark.parametrize(("channel", "rgb"), [(0, (1, 0, 0)), (2, (0, 0, 1))], ids=["red", "blue"])
def test_an_led_of_one_colour_lights_that_channel_alone(dent, channel, rgb):
    led = {"position_mm": (-10, 0, -3), "facing": (1, 0, 0.1), "spectrum": {"rgb": rgb}}
    coating = Coating(specular=0.5, roughness=0.3)
    sensor = Sensor.preset("paper").model_copy(update={"coating": coating})
    render = MembraneRenderer(sensor, Illumination(leds=(led,)), (64, 48), "draft")
    lit = render.linear(*dent(0.6), markers=False).any(axis=(0, 1))
    assert np.flatnonzero(lit).tolist() == [channel]


def test_every_illumination_preset_gives_a_mid_bright_reference(renderer):
    references = {}
    for name in ("i0", "i1", "i2"):
        reference = renderer(name).reference_linear(markers=False)
        assert 0.1 < reference.mean() < 0.45
        assert reference.max() < 1
        references[name] = renderer(name).reference(markers=False).astype(float)
    for one, other in (("i0", "i1"), ("i0", "i2"), ("i1", "i2")):
        assert np.abs(references[one] - references[other]).mean() > 20


@pytest.mark.parametrize("name", list_presets("sensors"))
def test_every_sensor_preset_renders_a_visible_dent(name, dent):
    sensor = Sensor.preset(name)
    light = sensor.illumination or Illumination.preset("i0")
    renderer = MembraneRenderer(sensor, light, (160, 120), "draft")
    picture, reference = renderer.picture(*dent(0.8)).astype(int), renderer.reference().astype(int)
    assert np.abs(picture - reference).max() > 40
    assert 20 < reference.mean() < 200


@pytest.mark.parametrize(("axis", "shear_mm"), [(0, (0.2, 0.0)), (1, (0.0, 0.2))])
def test_shear_moves_markers_right_and_down(renderer, dent, axis, shear_mm):
    render = renderer("i0")
    window = (slice(122, 152), slice(144, 178))  # the marker that rests at (0, 0.55) mm, before and after
    dark = [
        np.clip(60.0 - render.picture(*dent(0.2, shear)).max(axis=2)[window], 0, None)
        for shear in ((0.0, 0.0), shear_mm)
    ]
    shift = centroid_px(dark[1]) - centroid_px(dark[0])
    assert 3 < shift[axis] < 6
    assert abs(shift[1 - axis]) < 1


def test_marker_centres_follow_the_membrane(renderer, dent):
    render = renderer("i0")
    displacement = dent(0.5, (0.3, -0.2), (0.4, 0.3))
    marked, plain = (render.linear(*displacement, markers=flag) for flag in (True, False))
    ratio = (1 - marked.sum(2) / plain.sum(2)) / (1 - 0.04 / 0.5)
    expected = render.marker_px(*displacement).reshape(-1, 2)
    checked = 0
    for column, row in expected:
        if not (14 < column < 306 and 14 < row < 226):
            continue
        left, top = round(column) - 13, round(row) - 13
        found = centroid_px(ratio[top : top + 26, left : left + 26]) + np.array([left, top])
        # A marker on a curved flank is not symmetric about its centre: only the flat ones have theirs at the centroid.
        flank = np.hypot(*((np.array([column, row]) - (160 + 10, 120 + 8)) / 26.7)) < 2.6
        if not flank:
            assert np.hypot(*(found - (column, row))) < 0.1
            checked += 1
    assert checked > 30


def with_markers(markers):
    sensor = Sensor.preset("paper").model_copy(update={"markers": markers})
    return MembraneRenderer(sensor, Illumination.preset("i0"))


PLACES = ((0.0, 0.0), (2.13, -1.52), (-3.25, 1.04), (4.4, 3.2))


@pytest.mark.parametrize(
    "markers",
    [
        Markers(columns=4, rows=3, pitch_mm=(1.7, 2.3), offset_mm=(0.41, -0.17), missing=((0, 1), (2, 3))),
        Markers(columns=4, rows=3, pitch_mm=(2.3, 1.7), offset_mm=(-0.41, 0.17), shape="square"),
        Markers(positions_mm=PLACES, diameter_mm=0.5),
        Markers(positions_mm=PLACES, diameter_mm=0.5, shape="square"),
        Markers(positions_mm=PLACES[:1]),
    ],
    ids=["pitches", "squares", "list", "listed squares", "one"],
)
def test_each_marker_covers_its_area_around_its_centre(dent, markers):
    render, displacement = with_markers(markers), dent(0.3, (0.0, 0.0), (-5.0, -3.5))
    covered = 1 - render.linear(*displacement).sum(2) / render.linear(*displacement, markers=False).sum(2)
    covered = covered / (1 - 0.04 / 0.5)
    centers_px = render.marker_px(*displacement).reshape(-1, 2)
    centers_px = centers_px[np.isfinite(centers_px).all(axis=1)]
    side_px = markers.diameter_mm * 320 / 12
    area_px = side_px**2 * (1 if markers.shape == "square" else np.pi / 4)
    np.testing.assert_allclose(covered.sum(), len(centers_px) * area_px, rtol=0.01)
    for column, row in centers_px:
        left, top = round(column) - 13, round(row) - 13
        own = covered[top : top + 26, left : left + 26]
        np.testing.assert_allclose(centroid_px(own), (column - left, row - top), atol=0.1)
        np.testing.assert_allclose(own.sum(), area_px, rtol=0.03)


@pytest.mark.parametrize("shape", ["round", "square"])
@pytest.mark.parametrize("width_px", [0.8, 1.2, 2.0, 5.0])
def test_a_marker_covers_its_area_however_few_pixels_show_it(shape, width_px):
    places = [(1.643 * x, 1.713 * y) for x in range(-3, 4) for y in range(-2, 3)]
    markers = Markers(positions_mm=places, diameter_mm=width_px * 12 / 160, shape=shape, albedo=(0, 0, 0))
    sensor = Sensor.preset("paper").model_copy(update={"markers": markers})
    render = MembraneRenderer(sensor, Illumination.preset("i0"), (160, 120), "draft")
    covered = 1 - render.reference_linear().sum(2) / render.reference_linear(markers=False).sum(2)
    area_px = width_px**2 * (1 if shape == "square" else np.pi / 4)
    assert covered.sum() / len(places) == pytest.approx(area_px, rel=0.04)


def test_a_grid_that_is_listed_gives_the_same_picture(dent):
    grid = Markers()
    listed = Markers(positions_mm=[tuple(place) for place in marker_rest_mm(grid).reshape(-1, 2).tolist()])
    one, other = (with_markers(markers).picture(*dent(0.7, (0.2, 0.1))) for markers in (grid, listed))
    np.testing.assert_array_equal(one, other)


def test_a_rigid_shift_moves_all_markers_by_its_pixels(renderer, dent):
    render = renderer("i0")
    x, y, displacement = dent()
    shift = np.broadcast_to([0.137, -0.093, 0.0], displacement.shape)
    moved = render.marker_px(x, y, shift) - render.marker_px(x, y, 0 * shift)
    np.testing.assert_allclose(moved, np.broadcast_to([0.137, -0.093], moved.shape) * 320 / 12, atol=1e-3)


def test_a_mirrored_membrane_gives_a_mirrored_picture(dent):
    led = {"facing": (1, 0, 0.1), "length_mm": 8, "height_mm": 2, "spectrum": {"rgb": (1, 1, 1)}, "drive": 9}
    left = {**led, "position_mm": (-10, 0, -3)}
    right = {**led, "position_mm": (10, 0, -3), "facing": (-1, 0, 0.1)}
    render = MembraneRenderer(Sensor.preset("paper"), Illumination(leds=(left, right)))
    x, y, displacement = dent(0.7, (0.2, 0.1), (0.6, -0.4))
    mirrored = displacement[:, ::-1] * (-1, 1, 1)
    picture, other = (
        render.picture(x, y, field, markers=False).astype(int) for field in (displacement, mirrored)
    )
    assert np.abs(picture - other[:, ::-1]).max() <= 1


def test_shadows_fall_away_from_the_light(dent):
    light = {
        "position_mm": (-10, 0, -2.5),
        "facing": (1, 0, 0),
        "length_mm": 4,
        "spectrum": {"rgb": (1, 1, 1)},
        "drive": 50,
    }
    render = MembraneRenderer(Sensor.preset("paper"), Illumination(leds=(light,)))
    ratio = render.linear(*dent(0.9), markers=False)[..., 0] / render.reference_linear(markers=False)[..., 0]
    behind, before = ratio[120, 160 + 60], ratio[120, 160 - 60]
    assert behind < 0.3
    assert before == pytest.approx(1, abs=0.1)


def test_behind_an_led_s_face_its_light_is_black_and_the_others_add_up(dent):
    """A portrait picture of a wide sensor shows membrane beyond the bar at y = −9.5 mm; a sphere presses there."""
    membrane = dent(1.274, (0.0, 0.0), (2.509, -8.244), half_extent_mm=(12.0, 12.0), radius_mm=10.5)
    sensor, light = Sensor.preset("gelsight-2014-like"), Illumination.preset("i0")
    camera = sensor.camera.model_copy(update={"point_spread_px": 0.0})
    sensor = sensor.model_copy(update={"camera": camera})
    pictures = [
        MembraneRenderer(sensor, Illumination(leds=leds), (48, 64), "draft").linear(*membrane)
        for leds in (light.leds, *((led,) for led in light.leds))
    ]
    np.testing.assert_allclose(pictures[0], sum(pictures[1:]), atol=2e-6)
    top_bar_alone = pictures[3]
    assert top_bar_alone[0].max() < 1e-6
    assert top_bar_alone.max() > 0.05


def test_a_large_sphere_is_rendered_where_the_view_reaches_behind_the_lights(dent):
    sensor = Sensor.preset("gelsight-2014-like")
    wide = sensor.camera.model_copy(update={"horizontal_field_of_view_deg": 78.0})
    light = Illumination.preset("i0")
    render = MembraneRenderer(sensor.model_copy(update={"camera": wide}), light, (64, 48), "draft")
    beyond_mm = max(abs(led.position_mm[0]) for led in light.leds)
    assert render.lattice.x_mm[-1] > beyond_mm
    for point_mm in ((-14.0, 0.0), (14.0, 0.0)):
        membrane = dent(1.6, point_mm=point_mm, half_extent_mm=(22.0, 17.0), radius_mm=10.5)
        assert np.isfinite(render.linear(*membrane)).all()


@pytest.mark.parametrize("specular", [0.0, 1.0])
def test_partial_shading_equals_shading_everything(renderer, dent, monkeypatch, specular):
    sensor = renderer("i0").sensor.model_copy(update={"coating": Coating(specular=specular, roughness=0.3)})
    render = MembraneRenderer(sensor, renderer("i0").illumination)

    def changed_everywhere(lattice, field, name):
        surface = deformed_surface(lattice, field, name)
        changed = np.ones_like(surface.changed)
        _world_heights(surface.positions_mm, changed, surface.grid, surface.height_mm)
        return surface._replace(changed=changed)

    for case in (dent(0.2), dent(1.0, (0.5, 0.2), (1.0, -0.5))):
        fast = render.picture(*case).astype(int)
        everything = MembraneRenderer(render.sensor, render.illumination)
        with monkeypatch.context() as patch:
            patch.setattr("gelgap.render.renderer.shared_surface", changed_everywhere)
            assert np.abs(everything.picture(*case).astype(int) - fast).max() <= 1


@pytest.mark.parametrize("name", ["gelsight-2014-like", "gelsight-mini-like"])
def test_gloss_interpolated_on_gentle_slopes_is_that_computed_at_every_vertex(dent, monkeypatch, name):
    sensor = Sensor.preset(name)
    light = sensor.illumination or Illumination.preset("i0")
    x, y, displacement = dent(0.7, (0.3, 0.1), (1.5, -1.0))
    # As a real membrane does, this one bulges all over.
    bulge = 0.06 * np.exp(-((x[None, :] / 4) ** 2) - (y[:, None] / 4) ** 2)
    membrane = x, y, displacement + np.stack([0.3 * bulge, -0.3 * bulge, bulge], axis=-1)
    quick = MembraneRenderer(sensor, light).picture(*membrane).astype(int)
    monkeypatch.setattr("gelgap.render.light.gloss.smooth_stride", lambda spacing_mm: 1)
    assert np.abs(MembraneRenderer(sensor, light).picture(*membrane).astype(int) - quick).max() <= 1


def test_bytes_do_not_depend_on_what_was_rendered_before(renderer, dent):
    first = renderer("i1").picture(*dent(0.6), rng=np.random.default_rng(5))
    for name in ("i0", "i2"):
        renderer(name).picture(*dent(1.0, (0.4, 0.0)))
        renderer(name, (64, 48)).picture(*dent(0.3))
    fresh = MembraneRenderer(Sensor.preset("paper"), Illumination.preset("i1"))
    again = fresh.picture(*dent(0.6), rng=np.random.default_rng(5))
    assert np.array_equal(first, again)


def _render_in_worker(pickled):
    renderer, arguments = pickle.loads(pickled)
    return renderer.picture(*arguments)


def test_workers_give_the_same_bytes(renderer, dent):
    here = renderer("i0", (64, 48)).picture(*dent(0.6))
    job = pickle.dumps((renderer("i0", (64, 48)), dent(0.6)))
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        there = pool.apply_async(_render_in_worker, (job,)).get(timeout=60)
    assert np.array_equal(here, there)


def test_threads_that_share_a_renderer_get_pictures_of_their_own_membranes(renderer, dent):
    render, membranes = renderer("i0", (64, 48)), [dent(0.8), dent(0.3, (0.3, 0.0))]
    expected = [render.picture(*membrane) for membrane in membranes]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-4)
    try:
        with ThreadPoolExecutor(2) as threads:
            pictures = list(threads.map(lambda number: render.picture(*membranes[number % 2]), range(20)))
    finally:
        sys.setswitchinterval(interval)
    wrong = sum((picture != expected[number % 2]).any() for number, picture in enumerate(pictures))
    assert wrong == 0


def test_a_process_that_forks_while_a_thread_draws_may_draw():
    with ThreadPoolExecutor(1) as thread:
        thread.submit(LOCK.acquire).result()
        thread.submit(time.sleep, 0.2)
        thread.submit(LOCK.release)
        worker = multiprocessing.get_context("fork").Process(
            target=lambda: sys.exit(not LOCK.acquire(timeout=1))
        )
        worker.start()
        worker.join()
    assert worker.exitcode == 0


@pytest.mark.parametrize(
    "camera",
    [
        Camera(radial_distortion=(-1.5, 0.0)),
        Camera(radial_distortion=(2.0, 0.0), position_mm=(1.0, -0.5, -20.0)),
        # The lens folds within the membrane, out of the picture.
        Camera.showing(4.0).model_copy(update={"radial_distortion": (-8.0, 0.0)}),
    ],
    ids=["barrel", "pincushion", "narrow"],
)
def test_a_distorted_picture_shows_in_each_pixel_what_its_ray_meets(camera):
    size_px = (64, 48)
    sensor = Sensor.preset("paper").model_copy(update={"camera": camera})
    render = MembraneRenderer(sensor, Illumination.preset("i0"), size_px, "draft")
    seen_mm = render._geometry(shared_surface(render.lattice, render._flat, "flat")).reshape(-1, 2)
    np.testing.assert_allclose(seen_mm, camera.plane_of_picture_mm(size_px), atol=0.02)
    pixels = np.indices(size_px[::-1])[::-1].reshape(2, -1).T + 0.5
    np.testing.assert_allclose(
        camera.project_px(np.pad(seen_mm, ((0, 0), (0, 1))), size_px), pixels, atol=0.2
    )


def test_noise_is_drawn_from_the_generator_and_has_the_camera_s_variance(renderer):
    render = renderer("i0")
    one, same, other = (render.reference(rng=np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)
    camera = render.sensor.camera
    level = np.full((200, 300, 3), 0.3, np.float32)
    noise = sensor_noise(level, camera, np.random.default_rng(0)) - level
    electrons = 0.3 * camera.full_well_electrons + camera.read_noise_electrons**2
    assert noise.std() == pytest.approx(np.sqrt(electrons) / camera.full_well_electrons, rel=0.02)


@pytest.mark.parametrize("quality", ["draft", "standard"])
def test_qualities_agree(renderer, dent, quality):
    case = dent(0.6, (0.2, 0.0))
    best = renderer("i1", (160, 120), "fine").picture(*case, markers=False).astype(int)
    picture = renderer("i1", (160, 120), quality).picture(*case, markers=False).astype(int)
    assert np.abs(best - picture).mean() < 0.4


def test_another_grid_of_the_same_membrane_gives_nearly_the_same_picture(renderer, dent):
    fine = dent(0.6, spacing_mm=0.1)
    other = dent(0.6, spacing_mm=0.07, half_extent_mm=(7.0, 5.6))
    difference = renderer().picture(*fine).astype(int) - renderer().picture(*other)
    assert np.abs(difference).mean() < 0.15


def test_a_black_coat_shows_only_highlights(renderer, dent):
    base = renderer("i0", (64, 48))
    for specular, brightest in ((0.0, 0.0), (1.0, 0.1)):
        coating = Coating(albedo=(0, 0, 0), specular=specular, roughness=0.3)
        sensor = base.sensor.model_copy(update={"coating": coating})
        render = MembraneRenderer(sensor, base.illumination, (64, 48), "draft")
        assert render.linear(*dent(0.8), markers=False).max() >= brightest
        assert specular or render.linear(*dent(0.8), markers=False).max() == 0


def test_maps_are_aligned_with_the_picture(renderer, dent):
    x, y, displacement = dent(0.6, (0.3, 0.0), (1.5, 0.0))
    render = renderer("i0")
    height = render.height_map_mm(x, y, displacement)
    row, column = np.unravel_index(height.argmax(), height.shape)
    assert height.max() == pytest.approx(0.6, abs=5e-3)
    centre = render.sensor.camera.project_px(np.array([1.8, 0.0, -0.6]), (320, 240))
    assert np.hypot(column + 0.5 - centre[0], row + 0.5 - centre[1]) < 2
    contact = displacement[..., 2] < -0.3
    mask = render.contact_mask(x, y, displacement, contact)
    assert mask[row, column]
    assert mask.mean() == pytest.approx(contact.sum() * 0.01 / 108 * (25 / 24.55) ** 2, rel=0.05)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda x, y, u: (x, y, np.where(u < -0.5, np.nan, u)), "not finite"),
        (lambda x, y, u: (x[::-1], y, u), "x_mm must increase"),
        (lambda x, y, u: (x, y, u[:-1]), "shape"),
        (lambda x, y, u: (x, y, u * (8, 1, 1)), "folds the membrane"),
        (lambda x, y, u: (x, y, u * (1, 1, 30)), "rises by 24 mm; the camera sees it up to 22.5 mm"),
    ],
)
def test_bad_membranes_are_refused_by_name(renderer, dent, change, words):
    with pytest.raises(ValueError, match=rf"frame 7.*{words}"):
        renderer().picture(*change(*dent(0.8, (0.5, 0.0))), frame_name="frame 7")


def test_a_lens_that_folds_the_picture_is_refused():
    camera = Camera(horizontal_field_of_view_deg=90.0, radial_distortion=(-0.2, 0.0))
    sensor = Sensor.preset("paper").model_copy(update={"camera": camera})
    with pytest.raises(ValueError, match=r"camera.radial_distortion = .* k1 must be at least -0\.0948"):
        MembraneRenderer(sensor, Illumination.preset("i0"))


def test_bad_settings_are_refused():
    sensor, light = Sensor.preset("paper"), Illumination.preset("i0")
    with pytest.raises(ValueError, match=r"best.*draft, standard, fine"):
        MembraneRenderer(sensor, light, quality="best")
    with pytest.raises(ValueError, match="16…4096"):
        MembraneRenderer(sensor, light, size_px=(8, 240))
    with pytest.raises(ValueError, match="known presets: i0, i1, i2"):
        Illumination.preset("i9")
    with pytest.raises(ValueError, match="through the undeformed membrane"):
        Illumination(leds=({"position_mm": (-9, 0, -0.4), "facing": (1, 0, 0), "spectrum": {"cct_k": 5000}},))


def test_a_noisy_picture_is_the_noisy_linear_picture_encoded(renderer):
    render = renderer("i0", (64, 48))
    noisy = sensor_noise(render.reference_linear(), render.sensor.camera, np.random.default_rng(4))
    assert np.array_equal(render.reference(rng=np.random.default_rng(4)), encode(noisy))
