"""The calibration: pictures of a real sensor's presses in, a fitted sensor and how well it predicts out."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from gelgap.calibrate.check import hold_out
from gelgap.calibrate.fit import MOST_BLUR_PX, LightFit
from gelgap.calibrate.light import Bars, Light
from gelgap.calibrate.pictures import PressPicture, check_presses
from gelgap.calibrate.poses import PlacedPresses, place_presses
from gelgap.calibrate.profiles import PressProfiles
from gelgap.calibrate.sensor_file import LightCalibration, flat_field, lit_sensor
from gelgap.render.sensor import Sensor

Membranes = Callable[[set[float], float | None], Mapping[float, PressProfiles]]
FEWEST_PRESSES = 6
FEWEST_FOR_ORDER_3 = 12
# Code values; a fit from a right start leaves 1 to 3, camera noise included; one from a wrong start ten times as much.
DOUBTFUL_RMS = 5.0
NEAREST_CAMERA_MM = 15.0
# In a fit of at least this many presses, a single one hardly bends it.
_MANY_PRESSES = 20


@threadpool_limits.wrap(limits=1, user_api="blas")  # on busy cores several threads are many times slower
def calibrate_light(
    sensor: Sensor,
    reference: np.ndarray,
    presses: Sequence[PressPicture],
    membranes: Membranes,
    *,
    keep_camera: bool = False,
    folds: int = 3,
) -> LightCalibration:
    """Fit LEDs, scattered light and flat field to pictures of pressed spheres.

    Parameters
    ----------
    sensor
        The start: what the camera sees, coat, and LEDs in the right directions (within 30°); the camera's distance and
        the LEDs' places, sizes and colours are fitted. `lit_from_dents` finds directions.
    reference
        uint8 (h, w, 3) without contact.
    presses
        Six presses or more, spread over the view, each with its sphere's diameter.
    membranes
        Gives by sphere diameter in mm the membrane around such a sphere, down to a depth in mm if one is known;
        called with all diameters once the pictures are known to be right: `sphere_profiles` of
        `gelgap.calibrate.membranes`.
    keep_camera
        Whether the camera stays as it is; otherwise its distance and blur are fitted, and it shows the same of the gel.
    folds
        Into how many parts the presses are divided to be held out, one part after the other; 0: none is. Presses at
        one place are held out together.

    Raises
    ------
    ValueError
        If the sensor has no LEDs of its own, presses are too few, sizes differ, no contact is found, a sphere cannot
        reach its marked radius, or held-out presses are predicted, as marked, worse than by the unchanged reference,
        inside or around the contact.
    """
    _check_input(sensor, presses, folds)
    check_presses(reference, presses)
    profiles = membranes({press.sphere_diameter_mm for press in presses}, _deepest_mm(presses))
    placed = place_presses(sensor.camera, reference, presses, profiles)
    order, degree = (3, 2) if len(presses) >= FEWEST_FOR_ORDER_3 else (2, 1)
    task = LightTask(sensor, placed, order, degree, keep_camera=keep_camera)
    fit, outliers = _fit_without_outliers(task)
    checked = hold_out(task.fit, fit, folds)
    lit = lit_sensor(sensor, fit)
    return LightCalibration(
        sensor=lit.model_copy(update={"table_share": checked.share, "ball_residual": checked.residual}),
        maps=flat_field(lit, fit),
        gain=tuple(map(tuple, fit.field.gain.T.tolist())),
        volume_mm3=_usual_volume_mm3(fit),
        poses_mm=fit.presses,
        rms_code_values=fit.rms_code_values,
        names=tuple(placed.names[k] for k in fit.which),
        left_out=tuple(placed.names[k] for k in outliers),
        held_out=checked.presses,
        levels=placed.levels[fit.which],
        has_dots=placed.has_dots,
        at_limits=tuple(_at_limits(fit, [led.name for led in sensor.illumination.leds])),
    )


def _check_input(sensor: Sensor, presses: Sequence[PressPicture], folds: int) -> None:
    if sensor.illumination is None:
        raise ValueError(f"sensor {sensor.name!r} has no LEDs of its own; `lit_from_dents` finds some")
    if len(presses) < FEWEST_PRESSES:
        raise ValueError(
            f"{len(presses)} presses are too few to fit a sensor's light: it takes {FEWEST_PRESSES}, better 24, spread "
            "over the view"
        )
    if folds > len(presses):
        raise ValueError(
            f"{len(presses)} presses cannot be held out in {folds} parts; at most {len(presses)} parts"
        )


def _deepest_mm(presses: Sequence[PressPicture]) -> float | None:
    """Return the greatest depth; None unless all are known."""
    depths = [press.depth_mm for press in presses if press.depth_mm is not None]
    return max(depths) if len(depths) == len(presses) else None


def _usual_volume_mm3(fit: LightFit) -> float:
    """Return the median volume of the fitted presses' dents."""
    profiles = [fit.placed.profiles[k] for k in fit.which]
    volumes = [around.volume_mm3(pose[2]) for around, pose in zip(profiles, fit.presses, strict=True)]
    return float(np.median(volumes))


def _fit_without_outliers(task: "LightTask") -> tuple[LightFit, np.ndarray]:
    """Return the fit of all presses that a light can explain, and the indices of those that none can."""
    everything = np.arange(len(task.placed.presses))
    fit = task.fit(everything)
    suspects = _suspects(fit)
    if not len(suspects):
        return fit, suspects
    others = task.fit(np.setdiff1d(everything, suspects))
    # Those that a light fitted without them leaves far out: one bad press can spoil others.
    errors = np.array([others.refined(int(press)).rms_against_picture() for press in suspects])
    outliers = suspects[errors > _most_error(np.sqrt(others.press_errors()))]
    if len(outliers) == len(suspects):
        return others, outliers
    if len(outliers):
        return task.fit(np.setdiff1d(everything, outliers)), outliers
    return fit, outliers


def _suspects(fit: LightFit) -> np.ndarray:
    """Return the presses whose errors stand far out of the others', of few presses the worst; enough are always kept.

    An outlier among few presses bends the fit towards itself, and only a fit without it shows what it is.
    """
    errors = np.sqrt(fit.press_errors())
    far_out = np.flatnonzero(errors > _most_error(errors))
    if len(errors) < _MANY_PRESSES:
        far_out = np.union1d(far_out, errors.argmax())
    worst_first = far_out[np.argsort(-errors[far_out])]
    return np.sort(worst_first[: len(errors) - FEWEST_PRESSES])


def _most_error(errors: np.ndarray) -> float:
    """Return the rms error above which a press stands far out of the others."""
    middle = np.median(errors)
    return float(max(middle + 6 * np.median(np.abs(errors - middle)), 2.5 * middle))


def _at_limits(fit: LightFit, names: Sequence[str]) -> Iterator[str]:
    """Yield what lies at an end of its range, except that a camera may look from as far as can be told."""
    bars = fit.light.bars
    for part, limits in bars.limits.items():
        for number, value in enumerate(getattr(bars, part), start=1):
            if np.isclose(value, limits).any():
                yield f"{part} of LED {names[number - 1] or number} ({value:.1f} mm)"
    if fit.nearness_range is not None:
        if np.isclose(1 / fit.distance_mm, fit.nearness_range[1]):
            yield f"the camera's distance ({fit.distance_mm:.1f} mm)"
        if fit.camera.point_spread_px >= MOST_BLUR_PX:
            yield f"the camera's point spread ({fit.camera.point_spread_px:.1f} px of a picture 320 px wide)"


@dataclass(frozen=True)
class LightTask:
    """What every fit has in common, of all presses or of a part of them."""

    sensor: Sensor
    placed: PlacedPresses
    order: int
    degree: int
    keep_camera: bool = False

    def fit(self, which: np.ndarray) -> LightFit:
        """Fit the presses of the indices `which`."""
        placed, camera = self.placed, self.sensor.camera
        at_mm = placed.poses_mm[which, :2]
        far = placed.far_field(which)
        around_mm = np.median(placed.mark_mm[which])
        box_mm = np.column_stack([at_mm.min(0) - around_mm, at_mm.max(0) + around_mm])
        nearest_mm = 1.05 * max(camera.footprint_mm(placed.size_px)) / 2  # out of the view, upright ones too
        bars = Bars.of(self.sensor.illumination.leds, nearest_mm)
        where = placed.half_view_mm, tuple(box_mm.ravel().tolist()), bars
        light = Light(self.order, self.degree, *where, theta=np.zeros((0, 3)))
        # The camera may look from as near as it was given, or nearer than most, to nearly parallel.
        range_mm = camera.farthest_mm(placed.size_px), min(NEAREST_CAMERA_MM, -camera.position_mm[2])
        nearness_range = None if self.keep_camera else (1 / range_mm[0], 1 / range_mm[1])
        fit = LightFit(placed, which, far, light, nearness_range)
        fit.run()
        return fit
