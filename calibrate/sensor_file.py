"""The sensor file that a fit becomes: the sensor under the fitted light, and the flat field beside it."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gelgap.calibrate.check import HeldOut
from gelgap.calibrate.fit import LightFit
from gelgap.calibrate.light import gain_of
from gelgap.render.flat_field import LOADED_BOUNDS, FlatField, FlatFieldMaps, save_maps
from gelgap.render.light.leds import Illumination
from gelgap.render.light.scattered import LARGEST, Scattered
from gelgap.render.renderer import MembraneRenderer
from gelgap.render.sensor import Markers, Sensor, save_sensor


@dataclass(frozen=True)
class LightCalibration:
    """A fitted sensor without its flat field, the flat field, and what is known of the fit's quality."""

    sensor: Sensor
    maps: FlatFieldMaps
    gain: tuple[tuple[float, ...], ...]
    volume_mm3: float
    poses_mm: np.ndarray  # (presses, 3): x, y, depth as refined
    rms_code_values: float
    names: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    held_out: tuple[HeldOut, ...] = ()
    # (presses, 3): brightness far from the contacts over the reference's, which the fit takes out
    levels: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    has_dots: bool = False
    at_limits: tuple[str, ...] = ()  # what was fitted to an end of the range that is searched, in words

    def __repr__(self) -> str:
        rms = f"{self.rms_code_values:.2f} code values rms"
        return f"LightCalibration({self.sensor!r}, {len(self.names)} presses, {rms})"


def lit_sensor(start: Sensor, fit: LightFit) -> Sensor:
    """Return a start sensor under a fitted light, matt and without lens losses, which the flat field holds."""
    coating = start.coating.model_copy(update={"specular": 0.0})
    camera = fit.camera.model_copy(update={"vignetting": 0.0})
    light = fit.light
    count = light.bars.count
    linear = np.clip(light.theta[count:] / camera.exposure, -LARGEST, LARGEST)
    ambient, coefficients = np.split(linear, [light.ambient_columns])
    scattered = Scattered(
        order=light.order,
        degree=light.degree if light.order else 0,
        coefficients=coefficients.T.tolist(),
        ambient=np.pad(ambient, ((0, 3 - len(ambient)), (0, 0))).T.tolist(),
        span_mm=light.span_mm,
        scale_mm=light.scale_mm,
    )
    names = [led.name for led in start.illumination.leds]
    leds = light.bars.leds(names, light.theta[:count], np.array(coating.albedo), camera.exposure)
    illumination = Illumination(name=start.illumination.name, leds=leds, scattered=scattered)
    update = {
        "camera": camera,
        "coating": coating,
        "markers": Markers(layout="none"),  # the flat field has those of the reference
        "illumination": illumination,
        "flat_field": None,
        "marks_off": _marks_off(fit),
        "normal_table": tuple(map(tuple, fit.normal_table().coefficients.tolist())),
    }
    return start.model_copy(update=update)


def _marks_off(fit: LightFit) -> tuple[tuple[float, ...], ...] | None:
    """Return the sensor's `marks_off`, where all presses are marked by their contacts' radii."""
    presses = [fit.placed.presses[k] for k in fit.which]
    if any(press.radius_px is None or press.has_rough_marks for press in presses):
        return None
    radius_mm = float(np.median([press.sphere_diameter_mm for press in presses])) / 2
    units = np.array([1.0, 1.0, 1.0, radius_mm])
    return tuple(map(tuple, (units[:, None] * fit.marks_off() / units[1:]).tolist()))


def flat_field(sensor: Sensor, fit: LightFit) -> FlatFieldMaps:
    """Return the flat field that makes the rendered reference of the fitted sensor the real one."""
    far = fit.field
    rendered = MembraneRenderer(sensor, sensor.illumination, fit.placed.size_px).reference_linear(False)
    ratio = gain_of(far.reference, rendered).astype(np.float16).astype(np.float32)  # as it will be read
    offset = (far.reference - ratio * rendered).astype(np.float32)
    loaded = None if far.loaded is None else np.clip(far.loaded, *LOADED_BOUNDS).astype(np.float32)
    return FlatFieldMaps(ratio, loaded, offset, fit.placed.dots)


def save_calibration(calibration: LightCalibration, path: Path) -> Sensor:
    """Write the fitted sensor, its flat field beside it as `<name>-flat-field.npz`; return the sensor with both.

    Raises
    ------
    RuntimeError
        If a file cannot be written.
    """
    beside = path.resolve().with_name(f"{path.stem}-flat-field.npz")
    sensor = calibration.sensor
    scattered = sensor.illumination.scattered
    flat_field = FlatField(
        file=str(beside),
        sha256=save_maps(calibration.maps, beside),
        gain=calibration.gain,
        volume_mm3=calibration.volume_mm3,
        span_mm=scattered.span_mm,
        scale_mm=scattered.scale_mm,
    )
    whole = sensor.model_copy(update={"name": path.stem, "flat_field": flat_field})
    save_sensor(whole, path)
    return whole
