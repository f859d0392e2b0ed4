"""A synthetic sensor whose truth is known is recovered from its pictures."""

import numpy as np
import pytest

from gelgap.render.calibration import calibrate
from gelgap.render.contact_pixels import PressPicture, find_contact_mm
from gelgap.render.illumination import Illumination
from gelgap.render.renderer import MembraneRenderer
from gelgap.render.sensor import Coating, Sensor, save_sensor

DEPTH_MM = 0.9


def rough_start(truth):
    shifts = np.array([[1.2, -0.8, 0.7], [-1.0, 1.0, -0.8], [0.9, 0.9, 0.6], [0.5, -1, 0.5]])
    leds = [
        {
            **led.model_dump(),
            "position_mm": tuple((np.array(led.position_mm) + shift).tolist()),
            "spectrum": {"rgb": (1.0, 1.0, 1.0)},
            "drive": 1.0,
        }
        for led, shift in zip(truth.illumination.leds, shifts, strict=False)
    ]
    return truth.model_copy(update={"illumination": Illumination(leds=leds)})


@pytest.mark.parametrize(("specular", "given"), [(0.0, True), (0.2, True), (0.0, False)])
def test_levels_and_positions_are_recovered(dent, tmp_path, specular, given):
    truth = Sensor.preset("paper").model_copy(
        update={
            "illumination": Illumination.preset("i0"),
            "coating": Coating(specular=specular, roughness=0.35),
        }
    )
    renderer = MembraneRenderer(truth, truth.illumination)
    rng = np.random.default_rng(3)
    points = [(0.0, 0.0), (3.0, 2.0), (-3.0, -2.0), (3.0, -2.0), (-3.0, 2.0)]
    presses = tuple(
        PressPicture(
            renderer.picture(*dent(DEPTH_MM, point_mm=point), rng=rng),
            3.0,
            DEPTH_MM,
            point if given else None,
        )
        for point in points
    )
    result = calibrate(rough_start(truth), renderer.reference(rng=rng), presses, fit_gloss=specular > 0)
    save_sensor(result.sensor, tmp_path / "fitted.toml")
    fitted = Sensor.load(tmp_path / "fitted.toml")
    levels = fitted.illumination.led_to_camera(fitted.camera)
    true_levels = truth.illumination.led_to_camera(truth.camera)
    # A level is compared where the LED matters: in the channels that carry its colour.
    strong = true_levels > 0.3 * true_levels.max(axis=1, keepdims=True)
    np.testing.assert_allclose(levels[strong], true_levels[strong], rtol=0.02)
    for led, other in zip(fitted.illumination.leds, truth.illumination.leds, strict=True):
        assert np.linalg.norm(np.subtract(led.position_mm, other.position_mm)) < 0.5
    assert fitted.coating.specular == pytest.approx(specular, abs=0.03)
    assert result.rms_code_values < 4
    np.testing.assert_allclose(result.press_points_mm, points, atol=0.05)


@pytest.mark.parametrize("light", ["i0", "i1"])
def test_a_contact_is_found_in_the_picture(renderer, dent, light):
    render = renderer(light)
    found = find_contact_mm(
        render.picture(*dent(0.7, point_mm=(2.0, -1.0))), render.reference(), render.sensor.camera
    )
    assert np.hypot(found[0] - 2, found[1] + 1) < 0.15


def test_bad_calibrations_are_refused(renderer, dent):
    reference = renderer().reference()
    with pytest.raises(ValueError, match="no LEDs of its own"):
        calibrate(Sensor.preset("paper"), reference, ())
    sensor = Sensor.preset("paper").model_copy(update={"illumination": Illumination.preset("i0")})
    with pytest.raises(ValueError, match="at least one press"):
        calibrate(sensor, reference, ())
    with pytest.raises(ValueError, match="sphere's radius"):
        calibrate(sensor, reference, (PressPicture(reference, 3.0, 2.0, (0, 0)),))
    with pytest.raises(ValueError, match="no contact was found"):
        calibrate(sensor, reference, (PressPicture(reference, 3.0, 0.5),))
