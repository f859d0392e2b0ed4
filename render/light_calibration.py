"""Fitting the whole light of a real sensor (LEDs, scattered light, flat field), and how well it predicts other presses.

Presses that the fit has not seen say how good it is: it is done again without a part of them, which it then predicts.
What the membrane looks like around a sphere is given, so that nothing here solves anything.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gelgap.render.contact_pixels import PressPicture
from gelgap.render.flat_field import FlatField, FlatFieldMaps, save_maps
from gelgap.render.light_fit import LightFit
from gelgap.render.light_task import HeldOut, LightTask, flat_field_maps, most_error
from gelgap.render.press_light import Bars
from gelgap.render.press_poses import check_presses, place_presses, rough_marks
from gelgap.render.press_profiles import PressProfiles
from gelgap.render.sensor import Sensor, save_sensor
from gelgap.render.sphere_size import Membranes, SphereSize, fit_sphere_size

FEWEST_PRESSES = 6
FEWEST_FOR_ORDER_3 = 12
FOLDS = 3
# In a fit of at least this many presses, a single one hardly bends it.
_MANY_PRESSES = 20
# The number of presses by which sizes of an unknown sphere are compared, with light of a low order.
_PRESSES_FOR_SIZE = 12


@dataclass(frozen=True)
class LightCalibration:
    """A fitted sensor without its flat field, the flat field, and what is known of the fit's quality."""

    sensor: Sensor
    maps: FlatFieldMaps
    gain: tuple[tuple[float, ...], ...]
    volume_mm3: float
    poses_mm: np.ndarray  # (presses, 3): x, y, depth as refined
    names: tuple[str, ...]
    left_out: tuple[str, ...]
    rms_code_values: float
    held_out: tuple[HeldOut, ...]
    led_azimuths_deg: np.ndarray  # (leds, 2): value, standard error (NaN without held-out fits)
    led_elevations_deg: np.ndarray
    sphere_size: SphereSize | None = None  # of an unknown sphere
    nearness_error_per_mm: float = float("nan")  # standard error of 1 / the camera's distance; NaN: not known


def calibrate_light(
    sensor: Sensor,
    reference: np.ndarray,
    presses: Sequence[PressPicture],
    membranes: Membranes,
    *,
    order: int | None = None,
    degree: int | None = None,
    far: bool = True,
    shadows: bool = True,
    keep_camera: bool = False,
    folds: int = FOLDS,
) -> LightCalibration:
    """Fit LEDs, scattered light and flat field to pictures of pressed spheres.

    Parameters
    ----------
    sensor
        The start: what the camera sees, coat, and LEDs in the right directions (within 30°); the camera's distance and
        the LEDs' places, sizes and colours are fitted.
    reference
        uint8 (h, w, 3) without contact.
    presses
        Six presses or more, spread over the view; if none has a diameter, one is fitted.
    membranes
        Gives by sphere diameter in mm the membrane around such a sphere, down to a depth in mm if one is known;
        called with all diameters once the pictures are known to be right. `gelgap.domains.sphere_profiles` is one.
    order, degree
        Of scattered light; by default 3 and 2 from 12 presses on, and 2 and 1 below.
    far
        Whether a press changes the picture where it does not touch (`loaded` and `gain` of the flat field).
    shadows
        Whether the dent casts shadows in the fit's own model.
    keep_camera
        Whether the camera stays where it is; otherwise its distance is fitted, and it shows the same of the gel.
    folds
        Into how many parts the presses are divided to be held out, one part after the other; 0: none is.

    Raises
    ------
    ValueError
        If the sensor has no LEDs of its own, presses are too few, sizes differ, no contact is found, a sphere cannot
        reach its marked radius, or the fit predicts held-out presses worse than the unchanged reference does.
    """
    if sensor.illumination is None:
        raise ValueError(
            f"sensor {sensor.name!r} has no LEDs of its own to start from; give it an [illumination]"
        )
    if len(presses) < FEWEST_PRESSES:
        raise ValueError(
            f"{len(presses)} presses are too few to fit a sensor's light: it takes {FEWEST_PRESSES}, better 24, spread "
            "over the view; its LEDs alone can be fitted to three (--leds-only)"
        )
    if folds > len(presses):
        raise ValueError(
            f"{len(presses)} presses cannot be held out in {folds} parts; at most {len(presses)} parts"
        )
    check_presses(reference, presses)
    size = unknown_sphere_size(sensor, reference, presses, membranes, keep_camera=keep_camera)
    if size is not None:
        presses = [replace(press, sphere_diameter_mm=size.diameter_mm) for press in presses]
    depths = [press.depth_mm for press in presses if press.depth_mm is not None]
    profiles = membranes(
        {press.sphere_diameter_mm for press in presses}, max(depths) if len(depths) == len(presses) else None
    )
    placed = place_presses(sensor.camera, reference, presses, profiles)
    rich = len(presses) >= FEWEST_FOR_ORDER_3
    order, degree = (
        (3 if rich else 2) if order is None else order,
        (2 if rich else 1) if degree is None else degree,
    )
    task = LightTask(sensor, placed, order, degree, far, shadows, keep_camera)
    everything = np.arange(len(presses))
    fit, field = task.fit(everything)
    suspects = outliers = _suspects(fit)
    if len(suspects):
        others, other_field = task.fit(np.setdiff1d(everything, suspects))
        outliers = task.unexplained(others, other_field, suspects)
        if len(outliers) == len(suspects):
            fit, field = others, other_field
        elif len(outliers):
            fit, field = task.fit(np.setdiff1d(everything, outliers))
    used = np.setdiff1d(everything, outliers)
    held_out, geometries, nearness = [], [], []
    for fold in range(folds):
        without, these = np.delete(used, np.s_[fold::folds]), used[fold::folds]
        other, other_field = task.fit(without)
        geometries.append(_led_angles(other.bars))
        nearness.append(1 / other.distance_mm)
        seen = task.seen_as(other)
        held_out += [seen.predicted(other, other_field, without, int(press)) for press in these]
    _refuse_if_worse(held_out)
    lit = task.lit_sensor(fit)
    angles, errors = _led_angles(fit.bars), _jackknife_errors(geometries, fit.bars)
    nearness_error = float("nan") if keep_camera else _jackknife_error(np.array(nearness))
    volumes = [placed.profiles[k].volume_mm3(pose[2]) for k, pose in zip(used, fit.presses, strict=True)]
    return LightCalibration(
        sensor=lit,
        maps=flat_field_maps(lit, placed, field),
        gain=tuple(map(tuple, field.gain.T.tolist())),
        volume_mm3=float(np.median(volumes)),
        poses_mm=fit.presses,
        names=tuple(placed.names[k] for k in used),
        left_out=tuple(placed.names[k] for k in outliers),
        rms_code_values=fit.rms_code_values,
        held_out=tuple(held_out),
        led_azimuths_deg=np.column_stack([angles[0], errors[0]]),
        led_elevations_deg=np.column_stack([angles[1], errors[1]]),
        sphere_size=size,
        nearness_error_per_mm=float(nearness_error),
    )


def unknown_sphere_size(
    sensor: Sensor,
    reference: np.ndarray,
    presses: Sequence[PressPicture],
    membranes: Membranes,
    *,
    keep_camera: bool = False,
) -> SphereSize | None:
    """Return the size of an unknown sphere, None if all are known."""
    if all(press.sphere_diameter_mm is not None for press in presses):
        return None
    if any(press.sphere_diameter_mm is not None or press.radius_px is None for press in presses):
        raise ValueError(
            "some presses have no sphere_diameter_mm; a sphere of unknown size must be that of all presses, each with "
            "radius_px"
        )
    mm_per_px = sensor.camera.footprint_mm((reference.shape[1], 1))[0] / reference.shape[1]
    contacts_mm = [mm_per_px * press.radius_px for press in presses if not rough_marks(press)]
    some = np.unique(np.linspace(0, len(presses) - 1, _PRESSES_FOR_SIZE).astype(int))

    def press_errors(profiles: PressProfiles) -> np.ndarray:
        if not all(map(profiles.reaches, contacts_mm)):
            return np.full(len(some), 255.0**2)  # such a sphere leaves no such mark
        diameter = 2 * profiles.sphere_radius_mm
        tried = [replace(presses[k], sphere_diameter_mm=diameter) for k in some]
        placed = place_presses(sensor.camera, reference, tried, {diameter: profiles})
        task = LightTask(sensor, placed, 2, 1, far=False, shadows=True, keep_camera=keep_camera)
        fit, _ = task.fit(np.arange(len(some)), rounds=2)
        return fit.press_errors()

    mark_mm = mm_per_px * float(np.median([press.radius_px for press in presses]))
    return fit_sphere_size(mark_mm, membranes, press_errors)


def _led_angles(bars: Bars) -> np.ndarray:
    """Return (2, leds): azimuth and elevation in degrees."""
    return np.degrees([np.angle(np.exp(1j * bars.azimuth)), np.arctan2(bars.height, bars.distance)])


def _jackknife_errors(geometries: list[np.ndarray], bars: Bars) -> np.ndarray:
    """Return the standard errors of LED angles from fits that each left one part of the presses out."""
    if not geometries:
        return np.full((2, len(bars.azimuth)), np.nan)
    off = np.array(geometries) - _led_angles(bars)
    off[:, 0] = (off[:, 0] + 180) % 360 - 180
    return _jackknife_error(off)


def _jackknife_error(values: np.ndarray) -> np.ndarray:
    """Return the standard error of what was fitted without one part of the presses each time; NaN for no fit."""
    groups = len(values)
    if groups < 2:
        return np.full(values.shape[1:], np.nan)
    return np.sqrt((groups - 1) / groups * ((values - values.mean(0)) ** 2).sum(0))


def _suspects(fit: LightFit) -> np.ndarray:
    """Return the presses whose errors stand far out of the others', of few presses the worst; enough are always kept.

    An outlier among few presses bends the fit towards itself, and only a fit without it shows what it is.
    """
    errors = np.sqrt(fit.press_errors())
    far_out = np.flatnonzero(errors > most_error(errors))
    if len(errors) < _MANY_PRESSES:
        far_out = np.union1d(far_out, errors.argmax())
    worst_first = far_out[np.argsort(-errors[far_out])]
    return np.sort(worst_first[: len(errors) - FEWEST_PRESSES])


def _refuse_if_worse(held_out: list[HeldOut]) -> None:
    if not held_out:
        return
    fitted, unchanged = (
        np.median([getattr(press, kind) for press in held_out], axis=0) for kind in ("refined", "unchanged")
    )
    if fitted.sum() <= unchanged.sum():
        raise ValueError(
            "the fit predicts presses that it has not seen worse than the unchanged reference picture does (inside "
            f"the contact {fitted[0]:.1f} against {unchanged[0]:.1f} dB, around it {fitted[1]:.1f} against "
            f"{unchanged[1]:.1f} dB); check the LEDs' directions, the spheres' diameters and the camera's field of view"
        )


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
