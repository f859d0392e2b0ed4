"""What a fit of a real sensor's light bears: sets of presses disturbed in many ways, fitted, and others predicted.

Even presses are fitted by `calibrate_light`, odd ones rendered where they were marked and compared with their pictures,
which have suffered the same. Beside it the undisturbed fit's pictures, which then suffered the same: the most that can
be expected.
"""

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gelgap.benchmarks.common.tables import print_table, write_json
from gelgap.benchmarks.render.disturbances import DISTURBANCES, SPOILT, Disturbance, codes
from gelgap.domains import PressSet, sphere_profiles, taxim_presses
from gelgap.render import (
    LightCalibration,
    Markers,
    MembraneRenderer,
    PressPicture,
    PressProfiles,
    Sensor,
    calibrate_light,
    save_calibration,
)
from gelgap.render.calibration.poses import place_presses
from gelgap.render.imaging import srgb_decode

SET = "gelsight"
SYNTHETIC = "gelsight-mini-like"
PREDICTED = 8
QUICK = ("start: LEDs turned by 30°", "outlier: another press's picture")
DOTS = Markers(columns=9, rows=7, pitch_mm=1.9, diameter_mm=0.6)
# How much of the picture is cut off on the left and at the top, so that presses lie on the edge of the view.
CUT = 0.2


@dataclass(frozen=True)
class Fitted:
    """A fitted sensor and what it predicts of the presses that were not fitted."""

    calibration: LightCalibration
    renderer: MembraneRenderer
    membranes: list[tuple[np.ndarray, np.ndarray, np.ndarray]]
    seconds: float

    def pictures(self, markers: bool = False) -> list[np.ndarray]:
        """Return the predicted pictures."""
        return [self.renderer.picture(*membrane, markers=markers) for membrane in self.membranes]


def fit(
    found: PressSet,
    fitted: tuple[PressPicture, ...],
    predicted: tuple[PressPicture, ...],
    profiles: dict[float, PressProfiles],
) -> Fitted:
    """Fit some presses and place others."""
    started = time.process_time()
    calibration = calibrate_light(
        found.start, found.reference, fitted, lambda diameters, deepest: profiles, folds=0
    )
    seconds = time.process_time() - started
    size_px = found.reference.shape[1], found.reference.shape[0]
    with tempfile.TemporaryDirectory() as folder:
        sensor = save_calibration(calibration, Path(folder) / "fitted.toml")
        renderer = MembraneRenderer(sensor, sensor.illumination, size_px)
    placed = place_presses(sensor.camera, found.reference, predicted, profiles)
    extent_mm = tuple(side / 2 + 1 for side in sensor.camera.footprint_mm(size_px))
    membranes = [
        own.membrane(tuple(pose[:2]), pose[2], extent_mm)
        for own, pose in zip(placed.profiles, placed.poses_mm, strict=True)
    ]
    return Fitted(calibration, renderer, membranes, seconds)


def scores(pictures: list[np.ndarray], presses: tuple[PressPicture, ...]) -> np.ndarray:
    """Return (presses, 2): PSNR in dB inside the contact, and from one to two radii."""
    out = []
    for picture, press in zip(pictures, presses, strict=True):
        rows, columns = np.indices(picture.shape[:2])
        share = np.hypot(columns - press.center_px[0], rows - press.center_px[1]) / press.radius_px
        square = (picture.astype(float) - press.picture) ** 2
        means = [square[where].mean() for where in (share < 1, (share >= 1) & (share < 2))]
        out.append(10 * np.log10(255**2 / np.maximum(means, 1e-9)))
    return np.array(out)


def with_pictures(presses, pictures) -> tuple[PressPicture, ...]:
    """Return the presses with other pictures."""
    return tuple(replace(press, picture=picture) for press, picture in zip(presses, pictures, strict=True))


@dataclass(frozen=True)
class Trial:
    """A set of presses, divided, and its undisturbed fit."""

    found: PressSet
    fitted: tuple[PressPicture, ...]
    predicted: tuple[PressPicture, ...]
    profiles: dict[float, PressProfiles]
    best: Fitted

    @classmethod
    def of(cls, found: PressSet, profiles: dict[float, PressProfiles]) -> "Trial":
        """Fit the even presses as they are."""
        odd = found.presses[1::2]
        predicted = odd[:: max(len(odd) // PREDICTED, 1)]
        return cls(
            found,
            found.presses[::2],
            predicted,
            profiles,
            fit(found, found.presses[::2], predicted, profiles),
        )

    def row(self, case: Disturbance) -> dict[str, object]:
        """Fit the disturbed presses and predict the others."""
        found = replace(case.start(self.found), reference=case.picture(self.found.reference))
        fitted, predicted = (
            with_pictures(presses, [case.picture(press.picture) for press in presses])
            for presses in (self.fitted, self.predicted)
        )
        best = scores([case.picture(picture) for picture in self.best.pictures()], predicted)
        try:
            own = (
                self.best
                if case.name == "undisturbed"
                else fit(found, case.fitted(fitted), predicted, self.profiles)
            )
        except ValueError as refusal:
            return self._result(case.name, np.empty((0, 2)), best, 0.0, f"refused: {refusal}")
        note = ", ".join(own.calibration.left_out)
        if case.outlier:
            note = f"{note or 'none'} named; it was {self.fitted[SPOILT].name}"
        return self._result(case.name, scores(own.pictures(), predicted), best, own.seconds, note)

    def cut(self) -> dict[str, object]:
        """Cut the view so that presses lie on its edge."""
        height, width, _ = self.found.reference.shape
        top, left = round(CUT * height), round(CUT * width)
        view = np.s_[top:, left:]

        def cut(presses: tuple[PressPicture, ...]) -> tuple[PressPicture, ...]:
            moved = [
                replace(
                    press,
                    picture=press.picture[view].copy(),
                    center_px=(press.center_px[0] - left, press.center_px[1] - top),
                )
                for press in presses
            ]
            return tuple(press for press in moved if min(press.center_px) > -0.5 * press.radius_px)

        camera = self.found.start.camera
        fov_deg = 2 * np.degrees(
            np.arctan((1 - CUT) * np.tan(np.radians(camera.horizontal_field_of_view_deg / 2)))
        )
        start = self.found.start.model_copy(
            update={"camera": camera.model_copy(update={"horizontal_field_of_view_deg": float(fov_deg)})}
        )
        found = PressSet(self.found.reference[view].copy(), (), start)
        fitted, predicted = cut(self.fitted), cut(self.predicted)
        own = fit(found, fitted, predicted, self.profiles)
        kept = {press.name for press in predicted}
        best = [
            picture[view]
            for picture, press in zip(self.best.pictures(), self.predicted, strict=True)
            if press.name in kept
        ]
        edge = sum(
            not all(
                press.radius_px < c < side - press.radius_px
                for c, side in zip(press.center_px, found.reference.shape[1::-1], strict=True)
            )
            for press in fitted
        )
        note = f"{edge} of {len(fitted)} fitted presses on the edge"
        return self._result(
            "view cut at the presses",
            scores(own.pictures(), predicted),
            scores(best, predicted),
            own.seconds,
            note,
        )

    def dotted(self) -> list[dict[str, object]]:
        """Draw dots on all pictures, fit, and predict the pictures without and with them."""
        sensor = self.best.renderer.sensor.model_copy(update={"markers": DOTS, "flat_field": None})
        painter = MembraneRenderer(sensor, sensor.illumination, self.best.renderer.size_px)
        extent_mm = (self.best.membranes[0][0].max(), self.best.membranes[0][1].max())
        by_name = dict(zip(self.best.calibration.names, self.best.calibration.poses_mm, strict=True))

        def painted(picture: np.ndarray, membrane) -> np.ndarray:
            bare, dots = (painter.linear(*membrane, markers=markers) for markers in (False, True))
            return codes(srgb_decode(picture / 255) * dots / np.maximum(bare, 1e-6))

        fitted = []
        for press in self.fitted:
            x, y, depth = by_name[press.name]
            membrane = self.profiles[press.sphere_diameter_mm].membrane((x, y), depth, extent_mm)
            fitted.append(replace(press, picture=painted(press.picture, membrane)))
        flat = (*self.best.membranes[0][:2], np.zeros_like(self.best.membranes[0][2]))
        found = replace(
            self.found,
            reference=painted(self.found.reference, flat),
            start=self.found.start.model_copy(update={"markers": DOTS}),
        )
        own = fit(found, tuple(fitted), self.predicted, self.profiles)
        membranes, best = self.best.membranes, self.best.pictures()
        dotted = [painted(p.picture, m) for p, m in zip(self.predicted, membranes, strict=True)]
        best_dotted = [painted(p, m) for p, m in zip(best, membranes, strict=True)]
        with_dots = with_pictures(self.predicted, dotted)
        rows = (
            ("dots, predicted without", own.pictures(), self.predicted, best),
            ("dots, predicted with", own.pictures(markers=True), with_dots, best_dotted),
        )
        return [
            self._result(name, scores(pictures, real), scores(undisturbed, real), own.seconds, "")
            for name, pictures, real, undisturbed in rows
        ]

    @staticmethod
    def _result(name: str, own: np.ndarray, best: np.ndarray, seconds: float, note: str) -> dict[str, object]:
        return {"case": name, "scores": own, "undisturbed": best, "fit_s": seconds, "note": note}


def synthetic_set(profiles: dict[float, PressProfiles], size_px: tuple[int, int], count: int) -> PressSet:
    """Return rendered pictures of presses of one ball on a sensor whose light is its LEDs', with noise."""
    sensor = Sensor.preset(SYNTHETIC).model_copy(update={"markers": Markers(layout="none")})
    renderer = MembraneRenderer(sensor, sensor.illumination, size_px)
    ((diameter_mm, own),) = profiles.items()
    width_mm, height_mm = sensor.camera.footprint_mm(size_px)
    rng = np.random.default_rng(0)
    presses = []
    for k in range(count):
        point = rng.uniform(-0.32, 0.32, 2) * (width_mm, height_mm)
        depth_mm = rng.uniform(0.4, 0.55) * diameter_mm / 2
        membrane = own.membrane(tuple(point), depth_mm, (width_mm / 2 + 1, height_mm / 2 + 1))
        picture = renderer.picture(*membrane, rng=rng)
        radius = own.contact_radius_mm(depth_mm)
        height = own.sphere_radius_mm - depth_mm - np.sqrt(own.sphere_radius_mm**2 - radius**2)
        rim = np.array([[*point, height], [point[0] + radius, point[1], height]])
        center, edge = sensor.camera.project_px(rim, size_px) - 0.5
        presses.append(
            PressPicture(
                picture,
                diameter_mm,
                radius_px=float(np.hypot(*(edge - center))),
                center_px=tuple(center.tolist()),
                name=f"press {k}",
            )
        )
    return PressSet(renderer.reference(rng=rng), tuple(presses), sensor)


def measure(
    name: str, found: PressSet, profiles: dict[float, PressProfiles], quick: bool
) -> list[dict[str, object]]:
    """Print and return one set's table."""
    trial = Trial.of(found, profiles)
    steps: list[Callable[[], list]] = [
        lambda case=case: [trial.row(case)] for case in DISTURBANCES if not quick or case.name in QUICK
    ]
    if not quick:
        steps += [lambda: [trial.cut()], trial.dotted]
    results = [result for step in steps for result in step()]
    print_table(
        f"{name}: {len(trial.fitted)} presses fitted, {len(trial.predicted)} others predicted as marked; "
        "PSNR in dB, median (worst)",
        ["disturbance", "inside", "ring", "undisturbed fit: inside", "ring", "fit, s", "left out, notes"],
        [
            [
                result["case"],
                *(
                    _median_and_worst(values)
                    for kind in ("scores", "undisturbed")
                    for values in result[kind].T
                ),
                round(result["fit_s"], 1),
                result["note"],
            ]
            for result in results
        ],
    )
    return results


def _median_and_worst(values: np.ndarray) -> str:
    if not len(values):
        return ""
    return f"{np.median(values):.1f} ({values.min():.1f})"


def run(quick: bool, out_dir: Path) -> None:
    """Print how disturbed presses are predicted; write JSON to `out_dir`. Quick: two disturbances of the real set."""
    found = taxim_presses(SET)
    profiles = sphere_profiles({press.sphere_diameter_mm for press in found.presses})
    results = {SET: measure(SET, found, profiles, quick)}
    if not quick:
        profiles = sphere_profiles({4.0})
        rendered = synthetic_set(profiles, (640, 480), 24)
        results[SYNTHETIC] = measure(f"rendered {SYNTHETIC}", rendered, profiles, quick)
    write_json(out_dir / "sensor-robustness.json", results)
