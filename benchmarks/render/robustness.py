"""How sensitive the calibration of a sensor's light is: presses disturbed in many ways are fitted, others predicted.

Even presses are fitted by `calibrate_light`, odd ones rendered where they were marked and compared with their pictures,
which have suffered the same. Beside it the undisturbed fit's pictures, which then suffered the same: the most that can
be expected.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import cv2
import numpy as np

from gelgap.benchmarks.common import Results, Setting, run_missing, show, write_json
from gelgap.benchmarks.render.scenes import Membrane
from gelgap.benchmarks.render.sensors import median_and_worst, saved_renderer, scores
from gelgap.domains import PressSet, sphere_profiles, taxim_presses
from gelgap.render import (
    LightCalibration,
    Markers,
    MembraneRenderer,
    PressPicture,
    PressProfiles,
    Sensor,
    calibrate_light,
)
from gelgap.render.calibration.poses import place_presses
from gelgap.render.imaging import srgb_decode, srgb_encode

Presses = tuple[PressPicture, ...]
SET, SYNTHETIC, SYNTHETIC_BALL_MM = "gelsight", "gelsight-mini-like", 4.0
PREDICTED = 8
SPOILT = 2  # which of the fitted presses is made an outlier
CUT = 0.2  # how much of the picture is cut off on the left and at the top, so that presses lie on the edge
DOTS = Markers(columns=9, rows=7, pitch_mm=1.9, diameter_mm=0.6)
QUICK = ("start: LEDs turned by 30°", "outlier: another press's picture")


@dataclass(frozen=True)
class Disturbance:
    """What happens to every picture, to every mark (None: the press is lost), to the fitted presses, to the start.

    If not `everywhere`, predicted presses are spared; with `spoils`, one of the fitted presses is an outlier.
    """

    picture: Callable[[np.ndarray, Membrane], np.ndarray] = lambda picture, membrane: picture
    mark: Callable[[PressPicture], PressPicture | None] = lambda press: press
    fitted: Callable[[Presses], Presses] = lambda presses: presses
    start: Callable[[Sensor], Sensor] = lambda sensor: sensor
    everywhere: bool = True
    spoils: bool = False


def codes(linear: np.ndarray) -> np.ndarray:
    """Return uint8 codes of linear values."""
    return np.round(255 * srgb_encode(linear)).astype(np.uint8)


def exposed(picture: np.ndarray, factor: float) -> np.ndarray:
    """Return the picture at a multiple of the exposure."""
    return codes(factor * srgb_decode(picture / 255))


def blurred(picture: np.ndarray, membrane: Membrane) -> np.ndarray:
    return cv2.GaussianBlur(picture, (0, 0), 2 * picture.shape[1] / 640)


def compressed(picture: np.ndarray, membrane: Membrane) -> np.ndarray:
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 50])
    return cv2.imdecode(data, cv2.IMREAD_COLOR)


def noisy(picture: np.ndarray, membrane: Membrane) -> np.ndarray:
    noise = np.random.default_rng(int(picture.sum())).normal(0, 5, picture.shape)
    return np.clip(np.round(picture + noise), 0, 255).astype(np.uint8)


def marked_badly(presses: Presses) -> Presses:
    """Return presses whose circles are marked with an error of 3 px, in the centre and in the radius."""
    rng = np.random.default_rng(0)
    return tuple(
        replace(
            press,
            center_px=tuple(press.center_px + rng.normal(0, 3, 2)),
            radius_px=press.radius_px + min(rng.normal(0, 3), 2.0),
        )
        for press in presses
    )


def some(presses: Presses, count: int) -> Presses:
    """Return `count` of the presses, spread over the list."""
    return presses[:: len(presses) // count][:count]


def one_spoilt(change: Callable[[PressPicture, PressPicture], dict]) -> Disturbance:
    """Return what changes one fitted press, given it and its neighbour in the list."""

    def fitted(presses: Presses) -> Presses:
        press = replace(presses[SPOILT], **change(*presses[SPOILT : SPOILT + 2]))
        return (*presses[:SPOILT], press, *presses[SPOILT + 1 :])

    return Disturbance(fitted=fitted, spoils=True)


def turned(sensor: Sensor, angle_deg: float = 30.0) -> Sensor:
    """Return a start whose LEDs are all turned about the sensor's axis."""
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))

    def turn(vector: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = vector
        return float(cosine * x - sine * y), float(sine * x + cosine * y), z

    leds = sensor.illumination.leds
    return with_leds(
        sensor, [{"position_mm": turn(led.position_mm), "facing": turn(led.facing)} for led in leds]
    )


def shifted(sensor: Sensor, distance_mm: float = 6.0) -> Sensor:
    """Return a start whose LEDs are each moved in a direction of its own."""
    rng, updates = np.random.default_rng(1), []
    for led in sensor.illumination.leds:
        step = rng.normal(size=3)
        x, y, z = led.position_mm + distance_mm * step / np.linalg.norm(step)
        highest = -led.half_extent_z_mm() - 0.05
        updates.append({"position_mm": (float(x), float(y), float(min(z, highest)))})
    return with_leds(sensor, updates)


def with_leds(sensor: Sensor, updates: Sequence[dict]) -> Sensor:
    """Return the sensor with other values of its LEDs."""
    leds = [led.model_copy(update=own) for led, own in zip(sensor.illumination.leds, updates, strict=True)]
    light = sensor.illumination.model_copy(update={"leds": tuple(leds)})
    return sensor.model_copy(update={"illumination": light})


def cut_at(size_px: tuple[int, int]) -> Disturbance:
    """Return what cuts the view so that presses lie on its edge."""
    left, top = (round(CUT * side) for side in size_px)

    def mark(press: PressPicture) -> PressPicture | None:
        moved = replace(press, center_px=(press.center_px[0] - left, press.center_px[1] - top))
        return moved if min(moved.center_px) > -0.5 * press.radius_px else None

    def start(sensor: Sensor) -> Sensor:
        half_view = (1 - CUT) * np.tan(np.radians(sensor.camera.horizontal_field_of_view_deg / 2))
        update = {"horizontal_field_of_view_deg": float(2 * np.degrees(np.arctan(half_view)))}
        return sensor.model_copy(update={"camera": sensor.camera.model_copy(update=update)})

    return Disturbance(lambda picture, membrane: picture[top:, left:].copy(), mark, start=start)


UNDISTURBED = "undisturbed"
DISTURBANCES = {
    UNDISTURBED: Disturbance(),
    "start: LEDs turned by 30°": Disturbance(start=turned),
    "start: each LED 6 mm off": Disturbance(start=shifted),
    "circles marked ± 3 px": Disturbance(fitted=marked_badly),
    "centres not marked": Disturbance(
        fitted=lambda ps: tuple(replace(press, center_px=None) for press in ps)
    ),
    "12 presses": Disturbance(fitted=partial(some, count=12)),
    "6 presses": Disturbance(fitted=partial(some, count=6)),
    "exposed 1.6 times, saturated": Disturbance(lambda picture, membrane: exposed(picture, 1.6)),
    "blurred by 2 px": Disturbance(blurred),
    "JPEG of quality 50": Disturbance(compressed),
    "noise of 5 code values": Disturbance(noisy),
    "outlier: another press's picture": one_spoilt(lambda press, other: {"picture": other.picture}),
    "outlier: centre marked 1 mm off": one_spoilt(
        lambda press, other: {"center_px": (press.center_px[0] + 34, press.center_px[1])}
    ),
    "outlier: two imprints": one_spoilt(
        lambda press, other: {"picture": np.minimum(press.picture, other.picture)}
    ),
    "outlier: light at 70 %": one_spoilt(lambda press, other: {"picture": exposed(press.picture, 0.7)}),
}


@dataclass(frozen=True)
class FittedSensor:
    """A calibration by some presses, and where it puts others, which were not fitted."""

    calibration: LightCalibration
    renderer: MembraneRenderer
    membranes: tuple[Membrane, ...]
    fit_s: float

    def pictures(self, markers: bool = True) -> list[np.ndarray]:
        """Return the predicted pictures."""
        return [self.renderer.picture(*membrane, markers=markers) for membrane in self.membranes]


@dataclass(frozen=True)
class Trial:
    """A set of presses: even ones are fitted, some of the odd ones predicted."""

    found: PressSet
    profiles: dict[float, PressProfiles]

    @property
    def fitted(self) -> Presses:
        return self.found.presses[::2]

    @property
    def predicted(self) -> Presses:
        odd = self.found.presses[1::2]
        return odd[:: max(len(odd) // PREDICTED, 1)]

    def fit(self, found: PressSet, predicted: Presses) -> FittedSensor:
        """Fit all presses of a set and place others as they are marked."""
        started = time.process_time()
        calibration = calibrate_light(
            found.start, found.reference, found.presses, lambda diameters, deepest: self.profiles, folds=0
        )
        fit_s = time.process_time() - started
        renderer = saved_renderer(calibration, found.reference.shape[1::-1])
        camera = renderer.sensor.camera
        placed = place_presses(camera, found.reference, predicted, self.profiles)
        extent_mm = tuple(side / 2 + 1 for side in camera.footprint_mm(placed.size_px))
        posed = zip(placed.profiles, placed.poses_mm, strict=True)
        membranes = tuple(own.membrane(tuple(pose[:2]), pose[2], extent_mm) for own, pose in posed)
        return FittedSensor(calibration, renderer, membranes, fit_s)

    @cached_property
    def best(self) -> FittedSensor:
        """The undisturbed fit."""
        return self.fit(replace(self.found, presses=self.fitted), self.predicted)

    @cached_property
    def fitted_membranes(self) -> list[Membrane]:
        """The membranes of the fitted presses, as the undisturbed fit finds them."""
        extent_mm = tuple(float(axis.max()) for axis in self.best.membranes[0][:2])
        poses = dict(zip(self.best.calibration.names, self.best.calibration.poses_mm, strict=True))
        return [
            self.profiles[press.sphere_diameter_mm].membrane(
                tuple(poses[press.name][:2]), poses[press.name][2], extent_mm
            )
            for press in self.fitted
        ]

    @property
    def disturbances(self) -> dict[str, Disturbance]:
        """All disturbances, those of the view and of the gel included."""
        with_dots = Disturbance(
            self.painted, start=lambda sensor: sensor.model_copy(update={"markers": DOTS})
        )
        return DISTURBANCES | {
            "view cut at the presses": cut_at(self.found.reference.shape[1::-1]),
            "dots, predicted without": replace(with_dots, everywhere=False),
            "dots, predicted with": with_dots,
        }

    @cached_property
    def painter(self) -> MembraneRenderer:
        sensor = self.best.renderer.sensor.model_copy(update={"markers": DOTS, "flat_field": None})
        return MembraneRenderer(sensor, sensor.illumination, self.best.renderer.size_px)

    def painted(self, picture: np.ndarray, membrane: Membrane) -> np.ndarray:
        """Return a picture of a membrane with dots on it."""
        bare, dots = (self.painter.linear(*membrane, markers=markers) for markers in (False, True))
        return codes(srgb_decode(picture / 255) * dots / np.maximum(bare, 1e-6))

    def measure(self, setting: Setting) -> Results:
        """Fit the disturbed presses and predict the others."""
        case, best = self.disturbances[setting["disturbance"]], self.best

        x, y, displacement = best.membranes[0]
        reference = case.picture(self.found.reference, (x, y, np.zeros_like(displacement)))
        pairs = zip(self.fitted, self.fitted_membranes, strict=True)
        marked = [case.mark(replace(press, picture=case.picture(press.picture, own))) for press, own in pairs]
        fitted, predicted, expected = tuple(filter(None, marked)), [], []
        for press, ideal, own in zip(self.predicted, best.pictures(), best.membranes, strict=True):
            real = press.picture
            if case.everywhere:
                real, ideal = (case.picture(picture, own) for picture in (real, ideal))
            if (moved := case.mark(replace(press, picture=real))) is not None:
                predicted.append(moved)
                expected.append(ideal)

        results = {"undisturbed": levels(expected, predicted)}
        found = PressSet(reference, case.fitted(fitted), case.start(self.found.start))
        try:
            own = best if setting["disturbance"] == UNDISTURBED else self.fit(found, tuple(predicted))
        except ValueError as refusal:
            return results | {"own": levels([], []), "fit, s": 0.0, "note": f"refused: {refusal}"}
        note = ", ".join(own.calibration.left_out)
        if case.spoils:
            note = f"{note or 'none'} named; it was {self.fitted[SPOILT].name}"
        if reference.shape != self.found.reference.shape:
            centers, radii = (np.array([getattr(p, n) for p in fitted]) for n in ("center_px", "radius_px"))
            off = (centers <= radii[:, None]) | (centers >= reference.shape[1::-1] - radii[:, None])
            note = f"{off.any(axis=1).sum()} of {len(fitted)} fitted presses on the edge"
        pictures = own.pictures(markers=case.everywhere)
        return results | {"own": levels(pictures, predicted), "fit, s": own.fit_s, "note": note}


def levels(pictures: Sequence[np.ndarray], presses: Sequence[PressPicture]) -> dict[str, list[float]]:
    """Return PSNR in dB inside the contact, and from one to two radii, of each press."""
    found = [scores(picture, press) for picture, press in zip(pictures, presses, strict=bool(pictures))]
    return {region: [own[region] for own in found] for region in ("inside", "ring")}


def synthetic_set(profiles: dict[float, PressProfiles], size_px: tuple[int, int], count: int) -> PressSet:
    """Return rendered pictures of presses of one ball on a sensor whose light is its LEDs', with noise."""
    sensor = Sensor.preset(SYNTHETIC).model_copy(update={"markers": Markers(layout="none")})
    renderer = MembraneRenderer(sensor, sensor.illumination, size_px)
    ((diameter_mm, own),) = profiles.items()
    width_mm, height_mm = sensor.camera.footprint_mm(size_px)
    rng, presses = np.random.default_rng(0), []
    for k in range(count):
        point = rng.uniform(-0.32, 0.32, 2) * (width_mm, height_mm)
        depth_mm = rng.uniform(0.4, 0.55) * diameter_mm / 2
        membrane = own.membrane(tuple(point), depth_mm, (width_mm / 2 + 1, height_mm / 2 + 1))
        picture = renderer.picture(*membrane, rng=rng)
        radius = own.contact_radius_mm(depth_mm)
        height = own.sphere_radius_mm - depth_mm - np.sqrt(own.sphere_radius_mm**2 - radius**2)
        rim = np.array([[*point, height], [point[0] + radius, point[1], height]])
        center, edge = sensor.camera.project_px(rim, size_px) - 0.5
        marks = {"radius_px": float(np.hypot(*(edge - center))), "center_px": tuple(center.tolist())}
        presses.append(PressPicture(picture, diameter_mm, **marks, name=f"press {k}"))
    return PressSet(renderer.reference(rng=rng), tuple(presses), sensor)


def run(quick: bool, out_dir: Path) -> None:
    """Print how disturbed presses are predicted; write JSON to `out_dir`. Quick: two disturbances of the real set."""
    found = taxim_presses(SET)
    trials = {SET: Trial(found, sphere_profiles({press.sphere_diameter_mm for press in found.presses}))}
    if not quick:
        profiles = sphere_profiles({SYNTHETIC_BALL_MM})
        trials[f"rendered {SYNTHETIC}"] = Trial(synthetic_set(profiles, (640, 480), 24), profiles)
    kept, results = out_dir / "sensor-robustness.jsonl", {}
    for name, trial in trials.items():
        settings = [{"set": name, "disturbance": case} for case in (QUICK if quick else trial.disturbances)]
        records = results[name] = run_missing(trial.measure, settings, kept, workers=1)
        regions = [f"{whose}.{region}" for whose in ("own", "undisturbed") for region in ("inside", "ring")]
        table = records[["disturbance", *regions, "fit, s", "note"]].reset_index(drop=True)
        table = table.assign(**{region: table[region].map(median_and_worst) for region in regions})
        table.columns = [
            *("disturbance", "inside", "ring", "undisturbed fit: inside", "ring"),
            *("fit, s", "left out, notes"),
        ]
        show(
            f"{name}: {len(trial.fitted)} presses fitted, {len(trial.predicted)} others predicted as marked; PSNR in "
            "dB, median (worst)",
            table,
            formats={"fit, s": "{:.1f}"},
        )
    write_json(out_dir / "sensor-robustness.json", results)
    kept.unlink()
