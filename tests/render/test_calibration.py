"""The deprecated fit of LEDs alone still finds a synthetic sensor's; contacts are found in pictures."""

import numpy as np
import pytest

from gelgap.render.calibration.calibrator import calibrate
from gelgap.render.calibration.pictures import PressPicture, find_contact_mm
from gelgap.render.imaging import psnr_db
from gelgap.render.light.leds import Illumination
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


@pytest.mark.parametrize(
    ("specular", "given", "off_mm", "least_db"),
    [(0.0, True, 0.7, 45), (0.2, True, 0.7, 44), (0.0, False, 2.5, 32)],
)
def test_leds_alone_are_fitted_with_a_warning(dent, tmp_path, specular, given, off_mm, least_db):
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
    with pytest.warns(DeprecationWarning, match="use calibrate_light"):
        result = calibrate(rough_start(truth), renderer.reference(rng=rng), presses)
    save_sensor(result.sensor, tmp_path / "fitted.toml")
    fitted = Sensor.load(tmp_path / "fitted.toml")
    for led, other in zip(fitted.illumination.leds, truth.illumination.leds, strict=True):
        assert np.linalg.norm(np.subtract(led.position_mm, other.position_mm)) < off_mm
    assert result.rms_code_values < 4
    np.testing.assert_allclose(result.press_points_mm, points, atol=0.05)
    new = dent(DEPTH_MM, point_mm=(1.4, 0.3))
    predicted = MembraneRenderer(fitted, fitted.illumination).picture(*new)
    assert psnr_db(predicted, renderer.picture(*new)) > least_db


@pytest.mark.parametrize("light", ["i0", "i1"])
def test_a_contact_is_found_in_the_picture(renderer, dent, light):
    render = renderer(light)
    found = find_contact_mm(
        render.picture(*dent(0.7, point_mm=(2.0, -1.0))), render.reference(), render.sensor.camera
    )
    assert np.hypot(found[0] - 2, found[1] + 1) < 0.15


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
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
