"""Spectra, LEDs, sensors, drawn variations, and the colour gap."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelgap.assets import list_presets
from gelgap.calibrate.pictures import PressPicture
from gelgap.calibrate.profiles import SolvedPress
from gelgap.render.imaging import Camera, picture_gap, point_spread
from gelgap.render.light import spectra
from gelgap.render.light.irradiance import direct_light
from gelgap.render.light.leds import Illumination, Led, ShadowDetail, led_samples
from gelgap.render.light.spectra import (
    PeakSpectrum,
    RgbSpectrum,
    TableSpectrum,
    WhiteSpectrum,
    camera_rgb,
)
from gelgap.render.renderer import MembraneRenderer, reference_gap
from gelgap.render.sensor import Markers, Sensor, marker_rest_mm, save_sensor
from gelgap.render.surface import shared_surface
from gelgap.render.variation import Variation, vary_illumination, vary_sensor

NIKON = "Nikon 5100 (NPL)"


def test_spectra_look_like_their_colours():
    lights = (
        PeakSpectrum(peak_nm=630, width_nm=20),
        PeakSpectrum(peak_nm=525, width_nm=35),
        PeakSpectrum(peak_nm=465, width_nm=25),
    )
    assert np.argmax(camera_rgb(lights, NIKON, None), axis=1).tolist() == [0, 1, 2]
    warm, cold = camera_rgb((WhiteSpectrum(cct_k=3000), WhiteSpectrum(cct_k=8000)), NIKON, None)
    assert warm[0] / warm[2] > 2 > 1 > cold[0] / cold[2]


def test_the_white_balance_light_is_white():
    (flat,) = camera_rgb((TableSpectrum(wavelength_nm=(400, 700), power=(1, 1)),), NIKON, None)
    np.testing.assert_allclose(flat, 1, rtol=1e-9)
    (warm,) = camera_rgb((WhiteSpectrum(cct_k=3000),), NIKON, 3000.0)
    np.testing.assert_allclose(warm, 1, rtol=1e-9)
    assert camera_rgb((RgbSpectrum(rgb=(0.2, 0.5, 1)),), "any", None) == ((0.2, 0.5, 1.0),)


def test_bad_spectra_are_refused():
    with pytest.raises(ValueError, match="unknown; known:"):
        camera_rgb((WhiteSpectrum(cct_k=5000),), "Box camera", None)
    with pytest.raises(ValueError, match="must increase"):
        TableSpectrum(wavelength_nm=(500, 400), power=(1, 1))
    with pytest.raises(ValueError, match="no power between"):
        camera_rgb((TableSpectrum(wavelength_nm=(300, 350), power=(1, 1)),), NIKON, None)


def test_the_table_of_colours_holds_what_colour_science_says():
    """Some rows of it; scripts/led_colours.py writes them all."""
    for camera in (NIKON, "Sigma SDMerill (NPL)"):
        for spectrum in (
            spectra.EQUAL_ENERGY,
            WhiteSpectrum(cct_k=2000),
            WhiteSpectrum(cct_k=6500),
            PeakSpectrum(peak_nm=400, width_nm=40),
            PeakSpectrum(peak_nm=465, width_nm=25),
            PeakSpectrum(peak_nm=625, width_nm=20),
        ):
            kept = spectra._table()[spectra.table_key(spectrum, camera)]
            np.testing.assert_allclose(kept, spectra.computed_rgb(spectrum, camera), rtol=1e-12)


def test_a_light_between_those_of_the_table_is_between_their_colours():
    low, between, high = camera_rgb(
        [PeakSpectrum(peak_nm=peak_nm, width_nm=25) for peak_nm in (465, 467.5, 470)], NIKON, 5000.0
    )
    np.testing.assert_allclose(between, np.mean([low, high], axis=0), rtol=0.03)
    measured = TableSpectrum(wavelength_nm=(464, 465, 466), power=(0, 1, 0))
    (line,) = camera_rgb((measured,), NIKON, None)
    (narrow,) = camera_rgb((PeakSpectrum(peak_nm=465, width_nm=1.1),), NIKON, None)
    np.testing.assert_allclose(line, narrow, rtol=0.02)


def test_lights_that_ship_with_gelgap_are_drawn_without_colour_science():
    code = """
import sys
from gelgap.assets import list_presets
from gelgap.render import Illumination, Sensor
for name in list_presets("sensors"):
    sensor = Sensor.preset(name)
    for light in (None, *list_presets("illuminations")):
        sensor.lit_by(light).led_to_camera(sensor.camera)
assert "colour" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("kind", ["bar", "disc", "point"])
def test_irradiance_of_a_small_led_follows_the_inverse_square(renderer, kind):
    """E = A cosθ cosθ′/r² for a small source; a point's intensity is 1 mm²."""
    led = Led(
        kind=kind,
        position_mm=(-20, 3, -12),
        facing=(1, 0, 0.4),
        length_mm=0.2,
        height_mm=0.1,
        diameter_mm=0.2,
        spectrum={"rgb": (1, 1, 1)},
    )
    emitters = Illumination(leds=(led,)).emitters(Camera())
    detail = ShadowDetail(1.0, 3, 0.3)
    flat = shared_surface(renderer().lattice, renderer()._flat, "flat")
    leds = led_samples(emitters, detail, renderer().lattice)
    found = direct_light(flat, leds, detail, None).irradiance[..., 0]
    way = np.array(led.position_mm) - flat.positions_mm
    r = np.linalg.norm(way, axis=-1)
    area = {"bar": 0.02, "disc": np.pi * 0.01, "point": 1.0}[kind]
    emitted = 1.0 if kind == "point" else -(way @ led.normal) / r
    np.testing.assert_allclose(found, area * emitted * -way[..., 2] / r**3, rtol=1e-4)


@pytest.mark.parametrize(
    ("kind", "position_mm", "size_mm"),
    [("bar", (-9, 0, -3), (20, 3)), ("bar", (-12, 1, -8), (60, 10)), ("disc", (1, 0, -5), (10, 10))],
)
def test_irradiance_of_a_large_led_near_the_gel_is_that_of_all_its_face(renderer, kind, position_mm, size_mm):
    sides = {"length_mm": size_mm[0], "height_mm": size_mm[1], "diameter_mm": size_mm[0]}
    led = Led(kind=kind, position_mm=position_mm, facing=(1, 0, 0.4), spectrum={"rgb": (1, 1, 1)}, **sides)
    render = MembraneRenderer(Sensor.preset("paper"), Illumination(leds=(led,)), quality="draft")
    found, lattice = render._reference_irradiance[::10, ::10, 0], render.lattice.points_mm()[::10, ::10]
    u, v = ((np.indices((150, 150)) + 0.5) / 75 - 1).reshape(2, -1)
    shines = (np.hypot(u, v) < 1) | (kind == "bar")
    face = np.array(position_mm) + np.stack([u, v], 1)[shines] @ led.half_axes_mm()
    way = face - np.pad(lattice, ((0, 0), (0, 0), (0, 1)))[:, :, None]
    emitted = np.maximum(-(way @ led.normal), 0) * -way[..., 2] / (way**2).sum(-1) ** 2
    np.testing.assert_allclose(
        found, size_mm[0] * size_mm[1] / 150**2 * emitted.sum(-1), rtol=0.006, atol=1e-6
    )


@pytest.mark.parametrize("sigma_px", [0.1, 0.4, 0.69, 0.7, 1.5])
def test_the_point_spread_has_its_variance(sigma_px):
    point = np.zeros((41, 320, 3), np.float32)
    point[20, 160] = 1.0
    spread = point_spread(point, Camera(point_spread_px=sigma_px))[..., 1]
    along, across = np.arange(320) - 160, np.arange(41) - 20
    found = spread.sum(0) @ along**2, spread.sum(1) @ across**2
    np.testing.assert_allclose((spread.sum(), *found), (1, sigma_px**2, sigma_px**2), rtol=0.004)


def test_markers_are_seeded_and_may_be_missing():
    layout = Markers(jitter_mm=0.2, missing_fraction=0.3, seed=4)
    one, same = marker_rest_mm(layout), marker_rest_mm(layout)
    np.testing.assert_array_equal(one, same)
    missing = np.isnan(one[..., 0])
    assert 10 < missing.sum() < 45
    regular = marker_rest_mm(Markers())
    assert np.abs(one - regular)[~missing].max() <= 0.2
    assert marker_rest_mm(Markers(layout="none")).size == 0


def test_a_grid_of_markers_has_two_pitches_an_offset_and_gaps():
    markers = Markers(columns=3, rows=2, pitch_mm=(1.0, 2.0), offset_mm=(0.5, -0.25), missing=((1, 0),))
    rest_mm = marker_rest_mm(markers)
    np.testing.assert_allclose(rest_mm[0], [(-0.5, -1.25), (0.5, -1.25), (1.5, -1.25)])
    np.testing.assert_allclose(rest_mm[1], [(np.nan, np.nan), (0.5, 0.75), (1.5, 0.75)])


LISTED = ((0.0, 0.0), (2.0, -1.5), (-3.25, 1.0))


@pytest.mark.parametrize(
    ("markers", "absent"),
    [
        (Markers(), {"offset_mm", "missing", "positions_mm", "shape"}),
        (Markers(pitch_mm=(1.0, 1.5), offset_mm=(0.1, 0.0), missing=((0, 1),)), {"positions_mm", "shape"}),
        (
            Markers(positions_mm=LISTED, shape="square"),
            {"columns", "rows", "pitch_mm", "offset_mm", "missing"},
        ),
    ],
)
def test_a_saved_sensor_has_its_markers(tmp_path, markers, absent):
    save_sensor(Sensor(name="own", markers=markers), tmp_path / "own.toml")
    assert Sensor.load(tmp_path / "own.toml").markers == markers
    assert (
        set(Markers.model_fields) - set(markers.model_dump()) == absent
    )  # recipes without it keep their hashes


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"jitter_mm": 0.4}, r"pitch_mm = 1\.1: markers are 1\.1 mm apart; .* 1\.2 mm, is the least"),
        ({"pitch_mm": "wide"}, "pitch_mm = 'wide': must be one number in .* or two"),
        ({"pitch_mm": [1.1, 0.3]}, r"pitch_mm = \(1\.1, 0\.3\): markers are 0\.3 mm apart; .* 0\.4 mm"),
        ({"missing": [[8, 0]]}, r"missing = \(8, 0\): must be a row in 0…7 and a column in 0…10"),
        (
            {"positions_mm": LISTED, "pitch_mm": 1.1},
            "positions_mm lists each marker: leave it out, or leave out pitch_mm",
        ),
        ({"positions_mm": LISTED, "layout": "none"}, "leave out layout = 'none'"),
        (
            {"positions_mm": [*LISTED, (2.0, -1.5)]},
            r"positions_mm.1 = .* and positions_mm.3 = .*: markers are 0 mm apart",
        ),
        ({"positions_mm": [(60, 0)]}, "positions_mm.0.0 = 60"),
    ],
)
def test_markers_that_cannot_be_are_refused(values, message):
    with pytest.raises(ValueError, match=message):
        Markers(**values)


@pytest.mark.parametrize(
    "shown",
    [
        Sensor.preset("gelsight-mini-fitted"),
        Sensor(
            name="own", markers=Markers(positions_mm=[(x, y) for x in range(-5, 6) for y in range(-4, 5)])
        ).markers,
        Sensor.preset("gelsight-mini-fitted").illumination.scattered,
        MembraneRenderer(Sensor.preset("paper"), Illumination.preset("i0"), (64, 48)),
        PressPicture(np.zeros((480, 640, 3), np.uint8), 3.0, depth_mm=0.6),
        SolvedPress(0.6, np.arange(70.0), np.zeros(70), 0.5),
    ],
)
def test_objects_are_shown_in_one_line(shown):
    for text in (repr(shown), str(shown)):
        assert len(text) < 260
        assert "\n" not in text
        assert "array" not in text


def test_overlap_is_of_the_markers_shape():
    corner_to_corner = ((0.0, 0.0), (0.39, 0.39))  # 0.55 mm
    Markers(positions_mm=corner_to_corner)
    with pytest.raises(ValueError, match="overlap"):
        Markers(positions_mm=corner_to_corner, shape="square")


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_variations_are_valid_and_repeatable(seed):
    strong = Variation(led_position_mm=1.0, led_angle_deg=15, led_drive=0.4, albedo=0.2, yellowing=0.5)
    illumination, sensor = Illumination.preset("i2"), Sensor.preset("digit-like")
    drawn = vary_illumination(illumination, strong, np.random.default_rng(seed))
    assert drawn == vary_illumination(illumination, strong, np.random.default_rng(seed))
    assert drawn != illumination
    varied = vary_sensor(sensor, strong, np.random.default_rng(seed))
    red, _, blue = varied.coating.albedo
    assert blue <= red
    assert Sensor.model_validate(varied.model_dump()) == varied


def test_no_variation_changes_nothing():
    still = Variation(led_position_mm=0, led_angle_deg=0, led_drive=0, led_peak_nm=0, led_cct=0, albedo=0)
    sensor = Sensor.preset("gelsight-mini-like")
    drawn = vary_sensor(sensor, still, np.random.default_rng(0))
    assert drawn.coating == sensor.coating
    for led, other in zip(drawn.illumination.leds, sensor.illumination.leds, strict=True):
        np.testing.assert_allclose(led.position_mm, other.position_mm)
        assert led.spectrum == other.spectrum


def test_the_colour_gap_grows_with_the_change(renderer):
    base = renderer("i0", (64, 48))
    gaps = []
    for drive in (1.0, 1.1, 1.5):
        leds = (
            base.illumination.leds[0].model_copy(update={"drive": drive * 5.5}),
            *base.illumination.leds[1:],
        )
        other = MembraneRenderer(base.sensor, Illumination(leds=[led.model_dump() for led in leds]), (64, 48))
        gaps.append(reference_gap(base, other))
    assert gaps[0].mean == 0
    assert 0 < gaps[1].mean < gaps[2].mean < gaps[2].percentile_95
    with pytest.raises(ValueError, match="equal ones"):
        picture_gap(np.zeros((4, 4, 3), np.uint8), np.zeros((5, 4, 3), np.uint8))


def test_lens_distortion_is_that_of_the_projection(renderer, dent):
    base = Sensor.preset("paper")
    camera = base.camera.model_copy(update={"radial_distortion": (-0.3, 0.1)})
    render = MembraneRenderer(
        base.model_copy(update={"camera": camera}), Illumination.preset("i0"), (320, 240)
    )
    x, y, displacement = dent()
    markers = render.marker_px(x, y, 0 * displacement)
    picture = render.reference_linear()
    plain = render.reference_linear(markers=False)
    coverage = 1 - picture.sum(2) / np.maximum(plain.sum(2), 1e-6)
    column, row = markers[1, 1]
    rows, columns = np.indices(coverage.shape)
    near = np.hypot(columns + 0.5 - column, rows + 0.5 - row) < 12
    weight = coverage * near
    found = np.array([((columns + 0.5) * weight).sum(), ((rows + 0.5) * weight).sum()]) / weight.sum()
    assert np.hypot(*(found - markers[1, 1])) < 0.1


@pytest.mark.parametrize("kind", ["illuminations", "sensors"])
def test_presets_say_what_is_known_and_what_is_assumed(kind):
    read = {"illuminations": Illumination, "sensors": Sensor}[kind]
    for name in list_presets(kind):
        preset = read.preset(name)
        assert preset.known
        assert preset.assumed
