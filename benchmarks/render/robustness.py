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
from typing import Any

import cv2
import numpy as np

from gelgap.benchmarks.common import Results, Setting, run_missing, show, write_json
from gelgap.benchmarks.render.sensors import SET, median_and_worst, saved_renderer, scores
from gelgap.domains import PressSet, sphere_profiles, taxim_presses
from gelgap.render import LightCalibration, PressPicture, PressProfiles, Sensor, calibrate_light
from gelgap.render.calibration.poses import place_presses
from gelgap.render.imaging import srgb_decode, srgb_encode

Presses = tuple[PressPicture, ...]
PREDICTED = 8
SPOILT = 2  # which of the fitted presses is made an outlier
QUICK = ("start: LEDs turned by 30°", "outlier: another press's picture")


@dataclass(frozen=True)
class Disturbance:
    """What happens to every picture, to the presses that are fitted, and to the sensor that the fit starts from."""

    picture: Callable[[np.ndarray], np.ndarray] = lambda picture: picture
    fitted: Callable[[Presses], Presses] = lambda presses: presses
    start: Callable[[Sensor], Sensor] = lambda sensor: sensor


def exposed(picture: np.ndarray, factor: float) -> np.ndarray:
    """Return the picture at a multiple of the exposure."""
    return np.round(255 * srgb_encode(factor * srgb_decode(picture / 255))).astype(np.uint8)


def compressed(picture: np.ndarray) -> np.ndarray:
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 50])
    return cv2.imdecode(data, cv2.IMREAD_COLOR)


def noisy(picture: np.ndarray) -> np.ndarray:
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


def spoilt(change: Callable[[PressPicture, PressPicture], dict[str, Any]]) -> Disturbance:
    """Return what changes one fitted press, given it and its neighbour in the list."""

    def fitted(presses: Presses) -> Presses:
        press = replace(presses[SPOILT], **change(*presses[SPOILT : SPOILT + 2]))
        return (*presses[:SPOILT], press, *presses[SPOILT + 1 :])

    return Disturbance(fitted=fitted)


def turned(sensor: Sensor, angle_deg: float = 30.0) -> Sensor:
    """Return a start whose LEDs are all turned about the sensor's axis."""
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    leds = []
    for led in sensor.illumination.leds:
        moved = {name: turn @ getattr(led, name) for name in ("position_mm", "facing")}
        leds.append(led.model_copy(update={name: tuple(own.tolist()) for name, own in moved.items()}))
    light = sensor.illumination.model_copy(update={"leds": tuple(leds)})
    return sensor.model_copy(update={"illumination": light})


DISTURBANCES = {
    "undisturbed": Disturbance(),
    "start: LEDs turned by 30°": Disturbance(start=turned),
    "circles marked ± 3 px": Disturbance(fitted=marked_badly),
    "centres not marked": Disturbance(
        fitted=lambda presses: tuple(replace(press, center_px=None) for press in presses)
    ),
    "12 presses": Disturbance(fitted=partial(some, count=12)),
    "6 presses": Disturbance(fitted=partial(some, count=6)),
    "exposed 1.6 times, saturated": Disturbance(partial(exposed, factor=1.6)),
    "blurred by 2 px": Disturbance(lambda picture: cv2.GaussianBlur(picture, (0, 0), 2.0)),
    "JPEG of quality 50": Disturbance(compressed),
    "noise of 5 code values": Disturbance(noisy),
    "outlier: another press's picture": spoilt(lambda press, other: {"picture": other.picture}),
    "outlier: centre marked 1 mm off": spoilt(
        lambda press, other: {"center_px": (press.center_px[0] + 34, press.center_px[1])}
    ),
    "outlier: two imprints": spoilt(
        lambda press, other: {"picture": np.minimum(press.picture, other.picture)}
    ),
    "outlier: light at 70 %": spoilt(lambda press, other: {"picture": exposed(press.picture, 0.7)}),
}


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

    def fit(self, found: PressSet) -> tuple[LightCalibration, list[np.ndarray], float]:
        """Fit all presses of a set; return also the pictures of those to predict, as marked, and the fit's time."""
        started = time.process_time()
        calibration = calibrate_light(
            found.start, found.reference, found.presses, lambda diameters, deepest: self.profiles, folds=0
        )
        fit_s = time.process_time() - started
        renderer = saved_renderer(calibration, found.reference.shape[1::-1])
        camera = renderer.sensor.camera
        placed = place_presses(camera, self.found.reference, self.predicted, self.profiles)
        extent_mm = tuple(side / 2 + 1 for side in camera.footprint_mm(placed.size_px))
        pictures = [
            renderer.picture(*own.membrane(tuple(pose[:2]), pose[2], extent_mm))
            for own, pose in zip(placed.profiles, placed.poses_mm, strict=True)
        ]
        return calibration, pictures, fit_s

    @cached_property
    def best(self) -> tuple[LightCalibration, list[np.ndarray], float]:
        """The undisturbed fit."""
        return self.fit(replace(self.found, presses=self.fitted))

    def measure(self, setting: Setting) -> Results:
        """Fit the disturbed presses and predict the others."""
        case, (_, ideal, _) = DISTURBANCES[setting["disturbance"]], self.best
        fitted, real = (
            tuple(replace(press, picture=case.picture(press.picture)) for press in presses)
            for presses in (self.fitted, self.predicted)
        )
        results = {"undisturbed": levels(list(map(case.picture, ideal)), real)}
        reference = case.picture(self.found.reference)
        found = PressSet(reference, case.fitted(fitted), case.start(self.found.start))
        try:
            calibration, pictures, fit_s = self.fit(found)
        except ValueError as refusal:
            return results | {"own": levels([], []), "fit, s": 0.0, "note": f"refused: {refusal}"}
        note = ", ".join(calibration.left_out)
        return results | {"own": levels(pictures, real), "fit, s": fit_s, "note": note}


def levels(pictures: Sequence[np.ndarray], presses: Sequence[PressPicture]) -> dict[str, list[float]]:
    """Return PSNR in dB inside the contact, and from one to two radii, of each press."""
    found = [scores(*pair) for pair in zip(pictures, presses, strict=True)]
    return {region: [own[region] for own in found] for region in ("inside", "ring")}


def run(quick: bool, out_dir: Path) -> None:
    """Print how disturbed presses are predicted; write JSON to `out_dir`. Quick: two disturbances."""
    found = taxim_presses(SET)
    trial = Trial(found, sphere_profiles({press.sphere_diameter_mm for press in found.presses}))
    settings = [{"disturbance": name} for name in (QUICK if quick else DISTURBANCES)]
    kept = out_dir / "sensor-robustness.jsonl"
    records = run_missing(trial.measure, settings, kept, workers=1)
    regions = [f"{whose}.{region}" for whose in ("own", "undisturbed") for region in ("inside", "ring")]
    table = records[["disturbance", *regions, "fit, s", "note"]].reset_index(drop=True)
    table = table.assign(**{region: table[region].map(median_and_worst) for region in regions})
    table.columns = [
        *("disturbance", "inside", "ring", "undisturbed fit: inside", "ring"),
        *("fit, s", "left out, notes"),
    ]
    show(
        f"{SET}: {len(trial.fitted)} presses fitted, {len(trial.predicted)} others predicted as marked; PSNR in dB, "
        "median (worst)",
        table,
        f"the outlier is {trial.fitted[SPOILT].name}",
        {"fit, s": "{:.1f}"},
    )
    write_json(out_dir / "sensor-robustness.json", {"disturbances": records})
    kept.unlink()
