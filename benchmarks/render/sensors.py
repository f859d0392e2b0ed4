"""A real sensor predicted: some presses of a published calibration set fitted, the others rendered and compared.

gelgap's predictions are its own renderer's pictures. `marked` takes a press where it was marked by hand, `corrected`
moves it as the marks of the fitted presses were moved on average; both use nothing of its picture. `refined` moves its
centre and depth in its own picture. Beside them: what else predicts (`rivals`).
"""

import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import Results, Setting, run_missing, show, write_json
from gelgap.benchmarks.render import rivals
from gelgap.benchmarks.render.rivals import Fitted
from gelgap.domains import PressSet, sphere_profiles, taxim_presses
from gelgap.render import (
    LightCalibration,
    MembraneRenderer,
    PressPicture,
    PressProfiles,
    Sensor,
    save_calibration,
)
from gelgap.render.calibration.calibrator import FEWEST_FOR_ORDER_3, LightTask
from gelgap.render.calibration.fit import LightFit
from gelgap.render.calibration.poses import place_presses
from gelgap.render.imaging import psnr_db

SET = "gelsight"
LEVELS = ("contact", "inside", "ring", "within", "whole")  # regions, in each of which PSNR is taken
EXTENT_MM = (10.5, 8.2)
WHOLE = "whole: + flat field of pressed pictures"
Model = Callable[[tuple[int, ...]], Fitted]
"""Fits the presses of some indices."""


VARIANTS: dict[str, dict[str, Any]] = {
    "LEDs alone, camera kept at 25 mm": {"order": 0, "degree": 0, "far": False, "keep_camera": True},
    "+ scattered light, order 2 × (1, x, y)": {"order": 2, "degree": 1, "far": False, "keep_camera": True},
    "+ camera's distance fitted": {"order": 2, "degree": 1, "far": False},
    "+ order 3 × quadratics, flat field from the reference alone": {"order": 3, "degree": 2, "far": False},
    WHOLE: {"order": 3, "degree": 2},
    "whole without scattered light": {"order": 0, "degree": 0},
}
"""Forms of the model: fields of a `LightTask`."""


def light_task(
    found: PressSet, form: Mapping[str, Any], profiles: Mapping[float, PressProfiles] | None = None
) -> LightTask:
    """Return what a form of the model is fitted with; the membranes around the balls are solved if not given."""
    if profiles is None:
        profiles = sphere_profiles({press.sphere_diameter_mm for press in found.presses})
    placed = place_presses(found.start.camera, found.reference, found.presses, profiles)
    return LightTask(found.start, placed, **form)


def saved_renderer(calibration: LightCalibration, size_px: tuple[int, int]) -> MembraneRenderer:
    """Return gelgap's renderer of a calibration, through the files that a user would have."""
    with tempfile.TemporaryDirectory() as folder:
        save_calibration(calibration, Path(folder) / "fitted.toml")
        sensor = Sensor.load(Path(folder) / "fitted.toml")
        return MembraneRenderer(sensor, sensor.illumination, size_px)


class FittedLight:
    """A form of the model, or its small form where presses are few, fitted to the presses of some indices."""

    def __init__(self, task: LightTask, fitted: Sequence[int]) -> None:
        placed, which = task.placed, np.array(fitted)
        if len(which) < FEWEST_FOR_ORDER_3:
            task = replace(task, order=min(task.order, 2), degree=min(task.degree, 1))
        started = time.process_time()
        self.fit: LightFit = task.fit(which)
        self.fit_s = time.process_time() - started
        self.renderer = saved_renderer(LightCalibration(**task.result(self.fit)), placed.size_px)
        self.placed = placed.seen_from(self.fit.distance_mm)
        self.corrected_mm = corrected_poses(self.placed.poses_mm, which, self.fit.presses)

    def pose_mm(self, way: str, press: int) -> np.ndarray:
        """Return x, y and depth of a press: marked, corrected or refined."""
        if way == "refined":
            return self.fit.refined(self.placed, press).presses[0]
        return {"marked": self.placed.poses_mm, "corrected": self.corrected_mm}[way][press]

    def draw(self, way: str, press: int) -> Callable[[], np.ndarray]:
        """Return what draws a press's picture; the membrane is there already."""
        pose = self.pose_mm(way, press)
        membrane = self.placed.profiles[press].membrane(pose[:2], pose[2], EXTENT_MM)
        return partial(self.renderer.picture, *membrane, markers=False)


def corrected_poses(marked_mm: np.ndarray, fitted: np.ndarray, refined_mm: np.ndarray) -> np.ndarray:
    """Return marked poses (n, 3) moved as those of the fitted presses were: centres on average, depths by regression.

    Marked radii are so uncertain that most of their spread is not the depths'.
    """
    own = marked_mm[fitted]
    poses = marked_mm + (refined_mm - own).mean(axis=0)
    marked, refined = own[:, 2] - own[:, 2].mean(), refined_mm[:, 2] - refined_mm[:, 2].mean()
    slope = np.clip(marked @ refined / max(marked @ marked, 1e-9), 0, 1)
    poses[:, 2] = refined_mm[:, 2].mean() + slope * (marked_mm[:, 2] - own[:, 2].mean())
    return poses


def light_models(
    name: str, task: Callable[[], LightTask], ways: Iterable[str]
) -> dict[tuple[str, str], Model]:
    """Return models by name and the way in which predicted presses are placed; all have one fit in common."""
    fitted_light = lru_cache(1)(lambda fitted: FittedLight(task(), fitted))

    def model(way: str, fitted: tuple[int, ...]) -> Fitted:
        light = fitted_light(fitted)
        return partial(light.draw, way), light.fit_s

    return {(name, way): partial(model, way) for way in ways}


def rival_models(
    found: PressSet, depths_mm: np.ndarray, forms: Iterable[str]
) -> dict[tuple[str, str], Model]:
    """Return the tables without physics, and Taxim's forms if it is installed."""
    plain = "table without physics"
    models = {
        (plain, "marked"): partial(rivals.plain_table, found, 0),
        (f"{plain}, quadratic in the place", "marked"): partial(rivals.plain_table, found, 2),
    }
    if not rivals.missing_packages():
        own = {form: rivals.TAXIM_FORMS[form] for form in forms}
        models |= {(n, "marked"): partial(rivals.taxim, found, SET, depths_mm, f) for n, f in own.items()}
    return models


def scores(
    picture: np.ndarray,
    press: PressPicture,
    contact: PressPicture | None = None,
    clear: np.ndarray | bool = True,
) -> dict[str, float]:
    """Return the metrics of one picture, PSNR in dB by region, of pixels that are clear (of dots).

    `contact` marks where the ball really touches.
    """
    from skimage.metrics import structural_similarity

    rows, columns = np.indices(press.picture.shape[:2])

    def radii_from(mark: PressPicture) -> np.ndarray:
        return np.hypot(columns - mark.center_px[0], rows - mark.center_px[1]) / mark.radius_px

    share = radii_from(press)
    regions = {} if contact is None else {"contact": radii_from(contact) < 1}
    regions |= {
        "inside": share < 1,
        "ring": (share >= 1) & (share < 2),
        "within": share < 2,
        "whole": share >= 0,
    }
    return {
        **{name: psnr_db(picture, press.picture, where & clear) for name, where in regions.items()},
        "SSIM": float(structural_similarity(picture, press.picture, channel_axis=2)),
        "mean abs": float(np.abs(picture.astype(float) - press.picture).mean()),
    }


@dataclass(frozen=True)
class Study:
    """Presses, models by name and way of placing, and by name which presses are fitted and which are predicted."""

    presses: Sequence[PressPicture]
    models: Mapping[tuple[str, str], Model]
    splits: Mapping[str, tuple[Sequence[int], Sequence[int]]]
    contacts: Mapping[int, PressPicture] | None = None
    clear: Callable[[int], np.ndarray | bool] = lambda press: True

    def measure(self, setting: Setting) -> Results:
        """Fit a model, predict the presses that were not fitted, and return each metric of all of them."""
        fitted, predicted = self.splits[setting["predicted"]]
        draw, fit_s = self.models[setting["model"], setting["press"]](tuple(map(int, fitted)))
        found, times = [], []
        for press in map(int, predicted):
            frame = draw(press)
            started = time.process_time()
            picture = frame()
            times.append(time.process_time() - started)
            contact = self.contacts and self.contacts[press]
            found.append(scores(picture, self.presses[press], contact, self.clear(press)))
        frame_ms = 1e3 * float(np.median(times))
        return pd.DataFrame(found).to_dict("list") | {"fit, s": fit_s, "ms per frame": frame_ms}

    def records(self, file: Path) -> pd.DataFrame:
        """Return the records of all models on all splits; what a stopped benchmark has measured is read."""
        settings = [
            {"predicted": split, "model": model, "press": press}
            for split in self.splits
            for model, press in self.models
        ]
        return run_missing(self.measure, settings, file, workers=1)


def run(quick: bool, out_dir: Path) -> None:
    """Print how presses are predicted; write JSON to `out_dir`. Quick: fewer presses and models."""
    found = taxim_presses(SET)
    whole = light_task(found, VARIANTS[WHOLE])
    depths_mm, count = whole.placed.poses_mm[:, 2], len(found.presses)
    models = {("the reference, unchanged", ""): partial(rivals.unchanged, found)}
    models |= rival_models(found, depths_mm, (rivals.REFITTED,) if quick else rivals.TAXIM_FORMS)
    for name in (WHOLE,) if quick else VARIANTS:
        task = (lambda: whole) if name == WHOLE else partial(light_task, found, VARIANTS[name])
        corrected = ("corrected",) if name == WHOLE else ()
        models |= light_models(name, task, ("marked", *corrected, "refined"))
    even, odd = range(0, count, 2), range(1, count, 8 if quick else 2)
    kept = out_dir / "sensors.jsonl"
    predictions = Study(found.presses, models, {f"{len(odd)} odd presses": (even, odd)}).records(kept)
    note = ""
    if rivals.missing_packages():
        note = f"Taxim's own pipeline is left out; install it: {rivals.INSTALL}"
    title = f"{SET}: even presses fitted, {len(odd)} odd ones predicted; PSNR in dB, median (worst)"
    show_scores(title, predictions, ("model", "press", "fit, s", "ms per frame"), note)
    write_json(out_dir / "sensors.json", {"predictions": predictions})
    kept.unlink()


def median_and_worst(levels: Sequence[float]) -> str:
    """Return levels of several presses in words; none are an empty text."""
    return f"{np.median(levels):.1f} ({np.min(levels):.1f})" if len(levels) else ""


def show_scores(title: str, records: pd.DataFrame, columns: Sequence[str], note: str = "") -> None:
    """Print records: the given columns, the metrics of several presses, and times where they are among the columns."""
    cells = dict.fromkeys(LEVELS, median_and_worst)
    cells |= {"SSIM": lambda values: f"{np.median(values):.3f}", "mean abs": lambda v: f"{np.median(v):.2f}"}
    cells = {name: cell for name, cell in cells.items() if name in records}
    table = records.assign(**{name: records[name].map(cell) for name, cell in cells.items()})
    times = [name for name in columns if name in ("fit, s", "ms per frame")]
    names = [*(name for name in columns if name not in times), *cells, *times]
    show(title, table[names].reset_index(drop=True), note, dict.fromkeys(times, "{:.1f}"))
