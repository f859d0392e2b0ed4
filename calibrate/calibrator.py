"""Fitting the whole light of a real sensor (LEDs, scattered light, flat field), and how well it predicts other presses.

Presses that the fit has not seen say how good it is: it is done again without a part of them, which it then predicts.
What the membrane looks like around a sphere is given, so that nothing here solves anything.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from gelgap.calibrate.fit import MOST_BLUR_PX, LightFit
from gelgap.calibrate.light import Bars, Light, gain_of
from gelgap.calibrate.pictures import PressPicture, check_presses
from gelgap.calibrate.poses import MODELLED_MM, SCORED_RADII, PlacedPresses, place_presses
from gelgap.calibrate.profiles import PressProfiles
from gelgap.calibrate.residual import residual_around
from gelgap.render.flat_field import LOADED_BOUNDS, FlatField, FlatFieldMaps, save_maps
from gelgap.render.light.leds import Illumination
from gelgap.render.light.scattered import LARGEST, Scattered
from gelgap.render.normal_table import NormalTable
from gelgap.render.renderer import MembraneRenderer
from gelgap.render.sensor import BallResidual, Markers, Sensor, save_sensor

Membranes = Callable[[set[float], float | None], Mapping[float, PressProfiles]]
FEWEST_PRESSES = 6
FEWEST_FOR_ORDER_3 = 12
# Code values; a fit from a right start leaves 1 to 3, camera noise included; one from a wrong start ten times as much.
DOUBTFUL_RMS = 5.0
NEAREST_CAMERA_MM = 15.0
# Presses nearer to each other than this share of their imprints' radius are at one place.
_SAME_PLACE = 0.1
_FEWEST_FITTED = 3
# Shares of the table of normals that are tried, from the fitted light alone to the table alone.
TABLE_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
# A residual around balls that gains in one region may cost a held-out press this much in the other.
_MOST_LOST_DB = 0.2
# In a fit of at least this many presses, a single one hardly bends it.
_MANY_PRESSES = 20


@dataclass(frozen=True)
class HeldOut:
    """How a press that the fit had not seen was predicted, PSNR in dB: inside its contact, and from one to two radii.

    `marked` takes the press as far off its mark as the fitted ones say (`LightFit.expected_mm`), and uses nothing of
    its picture but its level far from the contact; `refined` moves its centre and depth in its own picture. Both are
    drawn by the fitted light and the share of the table of normals that predicts best, with what both leave around the
    ball if that is kept. `unchanged` is the reference, `table` the table alone, of the presses that were fitted;
    `picture` is the one as marked.
    """

    name: str
    unchanged: tuple[float, float]
    table: tuple[float, float]
    marked: tuple[float, float]
    refined: tuple[float, float]
    picture: np.ndarray = field(repr=False)  # uint8 (h, w, 3)


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
    check_presses(reference, presses)
    depths = [press.depth_mm for press in presses if press.depth_mm is not None]
    profiles = membranes(
        {press.sphere_diameter_mm for press in presses}, max(depths) if len(depths) == len(presses) else None
    )
    placed = place_presses(sensor.camera, reference, presses, profiles)
    order, degree = (3, 2) if len(presses) >= FEWEST_FOR_ORDER_3 else (2, 1)
    task = LightTask(sensor, placed, order, degree, keep_camera=keep_camera)
    everything = np.arange(len(presses))
    fit = task.fit(everything)
    suspects = outliers = _suspects(fit)
    if len(suspects):
        others = task.fit(np.setdiff1d(everything, suspects))
        # Those that a light fitted without them leaves far out: one bad press can spoil others.
        errors = np.array([others.refined(int(press)).rms_against_picture() for press in suspects])
        outliers = suspects[errors > _most_error(np.sqrt(others.press_errors()))]
        if len(outliers) == len(suspects):
            fit = others
        elif len(outliers):
            fit = task.fit(np.setdiff1d(everything, outliers))
    used = fit.which
    parts = [used[part] for part in held_out_parts(placed.centers_px[used], placed.radii_px[used], folds)]
    blind = [task.fit(np.setdiff1d(used, part)) for part in parts]
    drawn = [press for other, part in zip(blind, parts, strict=True) for press in _drawn(other, part)]
    share = table_share([press.levels(TABLE_SHARES) for press in drawn]) if drawn else 0.0
    residual = fit.ball_residual(share) if drawn else None
    residuals = {other: other.ball_residual(share) for other in blind}
    whole = [replace(press, residual=residuals[press.fit]) for press in drawn]
    if residual is None or not _predicts_better(whole, drawn, share):
        residual, whole = None, drawn
    held_out = [press.held_out(share) for press in whole]
    if held_out:
        _check_prediction(held_out)
    lit, own = task.lit_sensor(fit), [fit.placed.profiles[k] for k in used]
    volumes = [one.volume_mm3(pose[2]) for one, pose in zip(own, fit.presses, strict=True)]
    return LightCalibration(
        sensor=lit.model_copy(update={"table_share": share, "ball_residual": residual}),
        maps=task.flat_field(fit, lit),
        gain=tuple(map(tuple, fit.field.gain.T.tolist())),
        volume_mm3=float(np.median(volumes)),
        poses_mm=fit.presses,
        rms_code_values=fit.rms_code_values,
        names=tuple(placed.names[k] for k in used),
        left_out=tuple(placed.names[k] for k in outliers),
        held_out=tuple(held_out),
        levels=placed.levels[used],
        has_dots=placed.has_dots,
        at_limits=tuple(_at_limits(fit, [led.name for led in sensor.illumination.leds])),
    )


def held_out_parts(centers_px: np.ndarray, radii_px: np.ndarray, folds: int) -> list[np.ndarray]:
    """Return the indices of presses at `centers_px` (n, 2) that are held out together, at most `folds` times.

    Presses at one place are alike: one that is fitted would tell what the others look like.

    Raises
    ------
    ValueError
        If they lie at so few places that too few are left to fit.
    """
    firsts: list[int] = []  # of each place
    place = np.empty(len(centers_px), int)
    for press, (center, radius) in enumerate(zip(centers_px, radii_px, strict=True)):
        near = np.hypot(*(centers_px[firsts] - center).T) < _SAME_PLACE * radius
        if not near.any():
            firsts.append(press)
        place[press] = near.argmax() if near.any() else len(firsts) - 1
    parts = [np.flatnonzero(place % folds == fold) for fold in range(min(folds, len(firsts)))]
    if any(len(place) - len(part) < _FEWEST_FITTED for part in parts):
        raise ValueError(
            f"{len(place)} presses lie at {len(firsts)} places, and those of one place are held out together: fewer "
            f"than {_FEWEST_FITTED} would be left to fit; press at more places"
        )
    return parts


def _check_prediction(held_out: Sequence[HeldOut]) -> None:
    """Refuse a fit that is worse than the unchanged reference in a region; the table of normals says what is wrong."""
    marked = np.median([press.marked for press in held_out], axis=0)
    unchanged = np.median([press.unchanged for press in held_out], axis=0)
    table = np.median([press.table for press in held_out], axis=0)
    for where, fitted, least, plain in zip(("inside", "around"), marked, unchanged, table, strict=True):
        if fitted > least:
            continue
        advice = (
            "their table of normals predicts them, so that pictures and marks belong together: check the "
            "spheres' diameters, the scale (mm per px or the camera's field of view) and depths or radii"
            if plain > least
            else "nor does their table of normals: check that the reference, the pictures and their marks "
            "belong together, and that the presses are alike where they are near each other"
        )
        raise ValueError(
            f"{where} the contact the fit predicts presses that it has not seen worse than the unchanged reference "
            f"picture does ({fitted:.1f} against {least:.1f} dB); {advice} ({plain:.1f} dB)"
        )


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

    def lit_sensor(self, fit: LightFit) -> Sensor:
        """Return the start sensor under a fitted light, matt and without lens losses, which the flat field holds."""
        coating = self.sensor.coating.model_copy(update={"specular": 0.0})
        camera = fit.camera.model_copy(update={"vignetting": 0.0})
        light, own, count = fit.light, self.sensor.illumination, fit.light.bars.count
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
        names = [led.name for led in own.leds]
        leds = light.bars.leds(names, light.theta[:count], np.array(coating.albedo), camera.exposure)
        illumination = Illumination(name=own.name, leds=leds, scattered=scattered)
        update = {
            "camera": camera,
            "coating": coating,
            "markers": Markers(layout="none"),  # the flat field has those of the reference
            "illumination": illumination,
            "flat_field": None,
            "marks_off": self._marks_off(fit),
            "normal_table": tuple(map(tuple, fit.normal_table().coefficients.tolist())),
        }
        return self.sensor.model_copy(update=update)

    def _marks_off(self, fit: LightFit) -> tuple[tuple[float, ...], ...] | None:
        """Return the sensor's `marks_off`, where all presses are marked by their contacts' radii."""
        presses = [self.placed.presses[k] for k in fit.which]
        if any(press.radius_px is None or press.has_rough_marks for press in presses):
            return None
        radius_mm = float(np.median([press.sphere_diameter_mm for press in presses])) / 2
        units = np.array([1.0, 1.0, 1.0, radius_mm])
        return tuple(map(tuple, (units[:, None] * fit.marks_off() / units[1:]).tolist()))

    def flat_field(self, fit: LightFit, sensor: Sensor) -> FlatFieldMaps:
        """Return the flat field that makes the rendered reference of the fitted sensor the real one."""
        far = fit.field
        rendered = MembraneRenderer(sensor, sensor.illumination, self.placed.size_px).reference_linear(False)
        ratio = gain_of(far.reference, rendered).astype(np.float16).astype(np.float32)  # as it will be read
        offset = (far.reference - ratio * rendered).astype(np.float32)
        loaded = None if far.loaded is None else np.clip(far.loaded, *LOADED_BOUNDS).astype(np.float32)
        return FlatFieldMaps(ratio, loaded, offset, self.placed.dots)


@dataclass(frozen=True)
class _Drawn:
    """A press that a fit has not seen, as its light, its table and perhaps its residual around balls draw it."""

    fit: LightFit
    press: int
    table: NormalTable
    marked: tuple[np.ndarray, ...]
    residual: BallResidual | None = None

    def picture(self, pictures: tuple[np.ndarray, ...], share: float) -> np.ndarray:
        """Return the uint8 picture (h, w, 3) with a share of the table."""
        light, table, away, contact = pictures
        code = light + share * (table - light)
        if self.residual is not None:
            code = code + residual_around(self.residual, away, contact).reshape(code.shape)
        return np.clip(np.round(code), 0, 255).astype(np.uint8)

    def levels(self, shares: Sequence[float]) -> list[tuple[float, float]]:
        """Return the scores as marked, for each share of the table."""
        return [self.fit.placed.scores(self.press, self.picture(self.marked, share)) for share in shares]

    def held_out(self, share: float) -> HeldOut:
        """Return how the press is predicted with a share of the table."""
        seen, press, marked = self.fit.placed, self.press, self.picture(self.marked, share)
        refined = _pictures(self.fit, self.table, press, self.fit.refined(press).presses[0])
        return HeldOut(
            seen.names[press],
            unchanged=seen.scores(press, seen.reference),
            table=seen.scores(press, self.marked[1]),
            marked=seen.scores(press, marked),
            refined=seen.scores(press, self.picture(refined, share)),
            picture=marked,
        )


def _pictures(fit: LightFit, table: NormalTable, press: int, pose_mm: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return a press by light and by table, in code values (h, w, 3), how far from it pixels see, in radii, and it."""
    placed = fit.placed
    reach_mm = max(MODELLED_MM, 1.25 * SCORED_RADII * placed.mark_mm[press])  # it may be off its mark
    seen = placed.seen(press, pose_mm)
    normals = seen.normals.reshape(placed.reference.shape)
    plain = placed.at_level(press, table.picture(placed.clean_reference, normals, placed.camera), fit.field)
    lit = placed.picture_of(fit.light, fit.field, press, pose_mm, reach_mm)
    radius_mm = placed.profiles[press].contact_radius_mm(pose_mm[2])
    away = (seen.positions[:, :2] - pose_mm[:2]) / radius_mm
    return lit, plain, away, np.array([*pose_mm[:2] / placed.half_view_mm, radius_mm])


def _drawn(fit: LightFit, part: np.ndarray) -> list[_Drawn]:
    """Return the presses of a part as the fit without it draws them."""
    table, expected = fit.normal_table(), [(press, fit.expected_mm(press)) for press in part.tolist()]
    return [_Drawn(fit, press, table, _pictures(fit, table, press, pose)) for press, pose in expected]


def _predicts_better(drawn: Sequence[_Drawn], other: Sequence[_Drawn], share: float) -> bool:
    """Return whether the sum of the median PSNRs, inside and around, is larger, and neither much smaller."""
    new, old = (np.median([press.levels((share,))[0] for press in own], axis=0) for own in (drawn, other))
    return bool((new - old).sum() > 0 and (new - old).min() > -_MOST_LOST_DB)


def table_share(levels: Sequence[Sequence[tuple[float, float]]]) -> float:
    """Return the one of `TABLE_SHARES` that predicts best, by PSNR of each press with each share, inside and around.

    That is the largest sum of both medians, of those shares with which neither is below the table's alone.
    """
    medians = np.median(levels, axis=0)
    better = (medians >= medians[-1]).all(axis=1)
    return TABLE_SHARES[int(np.where(better, medians.sum(axis=1), -np.inf).argmax())]


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
