"""Fitting the whole light of a real sensor (LEDs, scattered light, flat field), and how well it predicts other presses.

Presses that the fit has not seen say how good it is: it is done again without a part of them, which it then predicts.
What the membrane looks like around a sphere is given, so that nothing here solves anything.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gelgap.render.contact_pixels import PressPicture
from gelgap.render.far_field import FarField, far_field
from gelgap.render.flat_field import LOADED_BOUNDS, RATIO_BOUNDS, FlatField, FlatFieldMaps, save_maps
from gelgap.render.illumination import Illumination
from gelgap.render.imaging import srgb_decode
from gelgap.render.light_fit import CameraRange, LightFit
from gelgap.render.light_options import LightOptions
from gelgap.render.press_light import Bars
from gelgap.render.press_poses import SCORED_RADII, PlacedPresses, check_presses, place_presses
from gelgap.render.press_profiles import PressProfiles
from gelgap.render.renderer import MembraneRenderer
from gelgap.render.scattered import LARGEST, Scattered
from gelgap.render.sensor import Sensor, save_sensor

FEWEST_PRESSES = 6
FEWEST_FOR_ORDER_3 = 12
FOLDS = 3
NEAREST_CAMERA_MM = 15.0
_MARGIN_MM = 0.5


@dataclass(frozen=True)
class HeldOut:
    """How a press that the fit had not seen was predicted, PSNR in dB: inside its contact, and from one to two radii.

    `marked` takes the press where it was marked or found; `refined` moves its centre and depth in its own picture.
    """

    name: str
    unchanged: tuple[float, float]
    marked: tuple[float, float]
    refined: tuple[float, float]
    picture: np.ndarray  # uint8 (h, w, 3), predicted, refined


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
    nearness_error_per_mm: float = float("nan")  # standard error of 1 / the camera's distance; NaN: not known


def calibrate_light(
    sensor: Sensor,
    reference: np.ndarray,
    presses: Sequence[PressPicture],
    membranes: Callable[[set[float], float | None], Mapping[float, PressProfiles]],
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
        Six presses or more, spread over the view.
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
    depths = [press.depth_mm for press in presses]
    profiles = membranes(
        {press.sphere_diameter_mm for press in presses}, None if None in depths else max(depths)
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
    outliers = _outliers(fit, len(presses))
    if len(outliers):
        others, other_field = task.fit(np.setdiff1d(everything, outliers))
        outliers = task.unexplained(others, other_field, outliers)
        fit, field = task.fit(np.setdiff1d(everything, outliers))
    used = np.setdiff1d(everything, outliers)
    held_out, geometries, nearness = [], [], []
    for fold in range(folds):
        without, these = np.delete(used, np.s_[fold::folds]), used[fold::folds]
        other, other_field = task.fit(without)
        geometries.append(_led_angles(other.bars))
        nearness.append(1 / other.distance_mm)
        seen = task.seen_as(other)
        held_out += [seen.predicted(other, other_field, int(press)) for press in these]
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
        nearness_error_per_mm=float(nearness_error),
    )


@dataclass(frozen=True)
class LightTask:
    """What every fit has in common, of all presses or of a part of them."""

    sensor: Sensor
    placed: PlacedPresses
    order: int
    degree: int
    far: bool
    shadows: bool
    keep_camera: bool = False

    @property
    def scale_mm(self) -> float:
        return self.sensor.camera.footprint_mm(self.placed.size_px)[0] / 2

    def fit(self, which: np.ndarray) -> tuple[LightFit, FarField]:
        """Fit the presses of the indices `which`."""
        placed, scale = self.placed, self.scale_mm
        poses = placed.poses_mm[which]
        field = placed.untouched
        if self.far:
            field = far_field(
                placed.reference,
                [placed.pictures[k] for k in which],
                placed.centers_px[which],
                placed.radii_px[which],
                poses[:, :2] / scale,
            )
        (x0, y0), (x1, y1) = poses[:, :2].min(0) - _MARGIN_MM, poses[:, :2].max(0) + _MARGIN_MM
        nearest_mm = 1.05 * scale
        options = LightOptions(
            self.order, self.degree, True, self.shadows, scale, (x0, x1, y0, y1), nearest_mm
        )
        fit = LightFit(
            options,
            placed.samples(which, field, scale),
            poses,
            [placed.profiles[k] for k in which],
            placed.sigma_mm[which],
            Bars.of(self.sensor.illumination.leds, nearest_mm),
            np.array(self.sensor.camera.position_mm),
            None if self.keep_camera else self._camera_range(which),
        )
        fit.run()
        return fit, field

    def _camera_range(self, which: np.ndarray) -> CameraRange:
        """Return from where the camera may look: as near as it was given, or nearer than most, to nearly parallel."""
        camera = self.sensor.camera
        nearest_mm = min(NEAREST_CAMERA_MM, -camera.position_mm[2])
        bounds = 1 / camera.farthest_mm(self.placed.size_px), 1 / nearest_mm
        return CameraRange(bounds, lambda distance_mm: self.placed.seen_from(distance_mm).poses_mm[which])

    def seen_as(self, fit: LightFit) -> "LightTask":
        """Return the task with the camera where a fit has put it, as predictions of the fit need it."""
        placed = self.placed.seen_from(fit.distance_mm)
        return replace(self, sensor=self.sensor.model_copy(update={"camera": placed.camera}), placed=placed)

    def predicted(self, fit: LightFit, field: FarField, press: int) -> HeldOut:
        """Predict a press under a fitted light."""
        placed, scale = self.placed, self.scale_mm
        refined_pose = self.refined_pose(fit, field, press)
        scored_mm = SCORED_RADII * placed.radii_px[press] * 2 * scale / placed.size_px[0]
        marked = placed.picture_of(
            fit.light, field, press, placed.poses_mm[press], scale, reach_mm=scored_mm + _MARGIN_MM
        )
        refined = placed.picture_of(fit.light, field, press, refined_pose, scale)
        scores = [placed.scores(press, picture) for picture in (placed.reference, marked, refined)]
        return HeldOut(placed.names[press], *scores, picture=refined)

    def unexplained(self, fit: LightFit, field: FarField, presses: np.ndarray) -> np.ndarray:
        """Return those presses that a light fitted without them leaves far out: one bad press can spoil others."""
        most = _most_error(_errors(fit, len(fit.presses)))
        seen = self.seen_as(fit)
        errors = [seen.refined(fit, field, int(press)).rms_against_picture() for press in presses]
        return presses[np.array(errors) > most]

    def refined_pose(self, fit: LightFit, field: FarField, press: int) -> np.ndarray:
        """Return (3,): x, y and depth at which a fitted light explains a press's own picture best."""
        return self.refined(fit, field, press).presses[0]

    def refined(self, fit: LightFit, field: FarField, press: int) -> LightFit:
        """Return a fitted light with a press that is moved to where the light explains its picture best."""
        placed, which = self.placed, np.array([press])
        samples = placed.samples(which, field, self.scale_mm)
        start, sigma, profiles = placed.poses_mm[which], placed.sigma_mm[which], [placed.profiles[press]]
        own = LightFit(fit.options, samples, start, profiles, sigma, fit.bars, fit.camera_mm)
        own.theta = fit.theta
        own.refine_presses(4)
        return own

    def lit_sensor(self, fit: LightFit) -> Sensor:
        """Return the start sensor under a fitted light, matt and without lens losses, which the flat field holds."""
        light, coating = fit.light, self.sensor.coating.model_copy(update={"specular": 0.0})
        camera = self.placed.seen_from(fit.distance_mm).camera.model_copy(update={"vignetting": 0.0})
        count, options, own = len(light.bars.azimuth), light.options, self.sensor.illumination
        linear = np.clip(light.theta[count:] / camera.exposure, -LARGEST, LARGEST)
        ambient, scattered = np.split(linear, [options.ambient_columns])
        ambient = np.pad(ambient, ((0, 3 - len(ambient)), (0, 0)))
        names = tuple(led.name for led in own.leds)
        leds = light.bars.leds(names, light.theta[:count], np.array(coating.albedo), camera.exposure)
        illumination = Illumination(
            name=own.name,
            leds=leds,
            scattered=Scattered(
                order=options.order,
                degree=options.degree if options.order else 0,
                coefficients=tuple(map(tuple, scattered.T.tolist())),
                ambient=tuple(map(tuple, ambient.T.tolist())),
                span_mm=tuple(map(float, options.span_mm)),
                scale_mm=options.scale_mm,
            ),
        )
        update = {"camera": camera, "coating": coating, "illumination": illumination, "flat_field": None}
        return self.sensor.model_copy(update=update)


def flat_field_maps(sensor: Sensor, placed: PlacedPresses, field: FarField) -> FlatFieldMaps:
    """Return what the real reference is, in units of the rendered one."""
    renderer = MembraneRenderer(sensor, sensor.illumination, placed.size_px)
    real = srgb_decode(placed.clean_reference / 255)
    rendered = renderer.reference_linear(markers=False)
    ratio = np.clip(real / np.maximum(rendered, np.maximum(0.2 * real, 1e-6)), *RATIO_BOUNDS)
    loaded = None if field.loaded is None else np.clip(field.loaded, *LOADED_BOUNDS).astype(np.float32)
    return FlatFieldMaps(ratio.astype(np.float32), loaded)


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


def _errors(fit: LightFit, count: int) -> np.ndarray:
    """Return the rms errors of presses in code values."""
    return np.sqrt([np.mean(fit.residual[fit.samples.index == k] ** 2) for k in range(count)])


def _most_error(errors: np.ndarray) -> float:
    """Return the error above which a press stands far out of the others."""
    middle = np.median(errors)
    return float(max(middle + 6 * np.median(np.abs(errors - middle)), 2 * middle))


def _outliers(fit: LightFit, count: int) -> np.ndarray:
    """Return the presses whose errors stand far out of the others'; enough are always kept."""
    errors = _errors(fit, count)
    far_out = np.flatnonzero(errors > _most_error(errors))
    worst_first = far_out[np.argsort(-errors[far_out])]
    return np.sort(worst_first[: count - FEWEST_PRESSES])


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
