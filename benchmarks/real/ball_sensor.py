"""The ball presses' sensor: its view, its dots, and its light as `gelgap calibrate` finds it, without any mark."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gelgap.benchmarks.real.plain_points import dots_of, level_point_px
from gelgap.benchmarks.real.published_sets import MM_PER_PX, Presses
from gelgap.domains import sphere_profiles
from gelgap.domains.calibration_presses import start_sensor
from gelgap.render import (
    Led,
    LightCalibration,
    Markers,
    PressPicture,
    Sensor,
    calibrate_light,
    inpaint_telea,
    light_azimuths,
    save_calibration,
)

SIZE_PX = (240, 320)
VIEW_MM = (SIZE_PX[0] * MM_PER_PX, SIZE_PX[1] * MM_PER_PX)
DOTS = Markers(columns=13, rows=17, pitch_mm=2.0, diameter_mm=0.55, jitter_mm=0.05)
"""Dots as large and as far apart as in the pictures; the real ones end 3 mm from the view's edge."""
FAR_MM = 500.0
"""Marks are places in the picture: a nearly parallel camera shows a contact where it is, however deep."""
PRESSES = 24
# The presses are deep; how deep, and where, the fit looks for in the pictures.
_CONTACT_IN_RADII = 0.95
_MARKS_OFF_PX = 10.0
_LED_DISTANCE_MM, _LED_HEIGHT_MM = 40.0, 20.0
_POINT_SPREAD_PX = 2.0


def fitted_sensor(presses: Presses, path: Path) -> LightCalibration:
    """Fit the light to presses of a series, spread over it; their marks are not looked at. Write the sensor to `path`.

    Raises
    ------
    ValueError
        If presses that the fit has not seen are predicted worse than by the unchanged reference.
    """
    radius_px = _CONTACT_IN_RADII * presses.series.ball_radius_mm / MM_PER_PX
    chosen = np.unique(np.linspace(0, len(presses.pictures) - 1, PRESSES).astype(int))
    pictures = presses.pictures[chosen]
    centers = np.array([level_point_px(picture, presses.reference, radius_px) for picture in pictures])
    azimuths = light_azimuths(presses.reference, list(pictures), centers, np.full(len(chosen), radius_px))
    listed = [
        PressPicture(
            _without_dots(picture),
            2 * presses.series.ball_radius_mm,
            radius_px=radius_px,
            center_px=tuple(center),
            marks_off_px=_MARKS_OFF_PX,
            name=f"press {number}",
        )
        for number, picture, center in zip(chosen, pictures, centers, strict=True)
    ]
    reference = _without_dots(presses.reference)
    fit = calibrate_light(_start(azimuths), reference, listed, sphere_profiles, keep_camera=True)
    save_calibration(replace(fit, sensor=fit.sensor.model_copy(update={"markers": DOTS})), path)
    return fit


def fit_quality(fit: LightCalibration) -> str:
    """Return in a line what the fit leaves, and how it predicts presses that it has not seen."""
    unchanged, predicted = (
        np.median([getattr(press, kind)[0] for press in fit.held_out]) for kind in ("unchanged", "refined")
    )
    return (
        f"light fitted to {len(fit.names)} presses without their marks: {fit.rms_code_values:.1f} code values rms; "
        f"inside held-out contacts the unchanged reference has {unchanged:.1f} dB, the prediction {predicted:.1f} dB"
    )


def _start(azimuths: np.ndarray) -> Sensor:
    """Return a sensor that shows the view from afar, with a bar for each colour outside of it."""
    sensor = start_sensor(SIZE_PX[0], azimuths, MM_PER_PX)
    camera = sensor.camera.seen_from(FAR_MM, SIZE_PX)
    leds = tuple(_outside(led) for led in sensor.illumination.leds)
    return sensor.model_copy(
        update={
            "camera": camera.model_copy(update={"point_spread_px": _POINT_SPREAD_PX}),
            "illumination": sensor.illumination.model_copy(update={"leds": leds}),
        }
    )


def _outside(led: Led) -> Led:
    x, y, _ = led.position_mm
    farther = _LED_DISTANCE_MM / np.hypot(x, y)
    return led.model_copy(
        update={
            "position_mm": (farther * x, farther * y, -_LED_HEIGHT_MM),
            "length_mm": farther * led.length_mm,
            "height_mm": farther * led.height_mm,
        }
    )


def _without_dots(picture: np.ndarray) -> np.ndarray:
    return inpaint_telea(picture, dots_of(picture))
