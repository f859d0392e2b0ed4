"""A real sensor predicted: some presses of a published calibration set fitted, the others rendered and compared.

gelgap's predictions are its own renderer's pictures. `marked` takes a press where it was marked by hand, and uses
nothing of its picture; `refined` moves its centre and depth in its own picture. Beside them: what else predicts
(`rivals`). `run` has a ball, scale and marks that are known; of `run_unknown_ball` they hardly are.
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
from gelgap.render import LightCalibration, MembraneRenderer, PressPicture, Sensor, save_calibration
from gelgap.render.calibration.calibrator import LightTask, unknown_sphere_size
from gelgap.render.calibration.poses import PlacedPresses, place_presses
from gelgap.render.imaging import psnr_db

SET, MINI_SET = "gelsight", "gelsight_mini"
LEVELS = ("inside", "ring", "within", "whole")  # regions, in each of which PSNR is taken
EXTENT_MM = (10.5, 8.2)
WHOLE = "whole: + flat field of pressed pictures"
VARIANTS: dict[str, dict[str, Any]] = {
    "LEDs alone, camera kept at 25 mm": {"order": 0, "degree": 0, "far": False, "keep_camera": True},
    "+ scattered light, order 2 × (1, x, y)": {"order": 2, "degree": 1, "far": False, "keep_camera": True},
    "+ camera's distance fitted": {"order": 2, "degree": 1, "far": False},
    "+ order 3 × quadratics, flat field from the reference alone": {"order": 3, "degree": 2, "far": False},
    WHOLE: {"order": 3, "degree": 2},
    "whole without scattered light": {"order": 0, "degree": 0},
}
"""Forms of the model: fields of a `LightTask`."""
Model = Callable[[tuple[int, ...]], Fitted]
"""Fits the presses of some indices."""
Models = Mapping[tuple[str, str], Model]
"""By a model's name and the way in which predicted presses are placed."""


def run(quick: bool, out_dir: Path) -> None:
    """Print how presses are predicted; write `sensors.json` to `out_dir`. Quick: fewer presses and models."""
    found = taxim_presses(SET)
    placed = placed_presses(found)
    plain, shipped = "table without physics", "Taxim, table as shipped (all presses)"
    models = {
        ("the reference, unchanged", ""): partial(rivals.unchanged, found),
        (plain, "marked"): partial(rivals.plain_table, found, 0),
        (f"{plain}, quadratic in the place", "marked"): partial(rivals.plain_table, found, 2),
    }
    note = f"Taxim's own pipeline is left out; install it: {rivals.INSTALL}"
    if not rivals.missing_packages():
        depths_mm, note = placed.poses_mm[:, 2], ""
        models[shipped, "marked"] = partial(rivals.taxim, found, SET, None)
        models[f"{shipped}, the ball as deep as in gelgap", "marked"] = partial(
            rivals.taxim, found, SET, depths_mm
        )
    for name in (WHOLE,) if quick else VARIANTS:
        models |= light_models(name, LightTask(found.start, placed, **VARIANTS[name]), ("marked", "refined"))
    odd = range(1, len(found.presses), 8 if quick else 2)
    report(SET, found.presses, models, odd, note, out_dir / "sensors.json")


def run_unknown_ball(quick: bool, out_dir: Path) -> None:
    """Print how presses of a ball are predicted whose size is fitted, too; write `unknown-ball.json` to `out_dir`.

    The published marks go round whole dents, so every press is placed in its own picture. Quick: two presses, the
    whole model alone.
    """
    found = taxim_presses(MINI_SET)
    size = unknown_sphere_size(found.start, found.reference, found.presses[::2], sphere_profiles)
    presses = tuple(replace(press, sphere_diameter_mm=size.diameter_mm) for press in found.presses)
    found = replace(found, presses=presses)
    placed = placed_presses(found)
    models = {("the reference, unchanged", ""): partial(rivals.unchanged, found)}
    for name in (WHOLE,) if quick else VARIANTS:
        models |= light_models(name, LightTask(found.start, placed, **VARIANTS[name]), ("refined",))
    low, high = size.interval_mm
    note = f"ball fitted to the even presses: {size.diameter_mm:.2f} mm, between {low:.2f} and {high:.2f} mm"
    odd = range(1, 5 if quick else len(presses), 2)
    report(MINI_SET, presses, models, odd, note, out_dir / "unknown-ball.json")


def report(
    name: str, presses: Sequence[PressPicture], models: Models, odd: Sequence[int], note: str, file: Path
) -> None:
    """Fit the even presses, predict odd ones, print the table and write JSON; one that was stopped goes on."""
    kept = file.with_suffix(".jsonl")
    split = f"{len(odd)} odd presses"
    study = Study(presses, models, {split: (range(0, len(presses), 2), odd)})
    settings = [{"predicted": split, "model": model, "press": way} for model, way in models]
    records = run_missing(study.measure, settings, kept, workers=1)
    title = f"{name}: even presses fitted, {len(odd)} odd ones predicted; PSNR in dB, median (worst)"
    show_scores(title, records, ("model", "press", "fit, s", "ms per frame"), note)
    write_json(file, {"predictions": records})
    kept.unlink()


def placed_presses(found: PressSet) -> PlacedPresses:
    """Return the presses where they are marked, with the membranes around their balls, which are solved."""
    profiles = sphere_profiles({press.sphere_diameter_mm for press in found.presses})
    return place_presses(found.start.camera, found.reference, found.presses, profiles)


def saved_renderer(calibration: LightCalibration, size_px: tuple[int, int]) -> MembraneRenderer:
    """Return gelgap's renderer of a calibration, through the files that a user would have."""
    with tempfile.TemporaryDirectory() as folder:
        save_calibration(calibration, Path(folder) / "fitted.toml")
        sensor = Sensor.load(Path(folder) / "fitted.toml")
        return MembraneRenderer(sensor, sensor.illumination, size_px)


class FittedLight:
    """A form of the model, fitted to the presses of some indices."""

    def __init__(self, task: LightTask, fitted: Sequence[int]) -> None:
        started = time.process_time()
        self.fit = task.fit(np.array(fitted))
        self.fit_s = time.process_time() - started
        self.renderer = saved_renderer(LightCalibration(**task.result(self.fit)), task.placed.size_px)

    def draw(self, way: str, press: int) -> Callable[[], np.ndarray]:
        """Return what draws a press's picture, marked or refined; the membrane is there already."""
        placed = self.fit.placed
        pose = placed.poses_mm[press]
        if way == "refined":
            pose = self.fit.refined(press).presses[0]
        membrane = placed.profiles[press].membrane(pose[:2], pose[2], EXTENT_MM)
        return partial(self.renderer.picture, *membrane, markers=False)


def light_models(name: str, task: LightTask, ways: Iterable[str]) -> Models:
    """Return models by name and the way in which predicted presses are placed; all have one fit in common."""
    fitted_light = lru_cache(1)(partial(FittedLight, task))

    def model(way: str, fitted: tuple[int, ...]) -> Fitted:
        light = fitted_light(fitted)
        return partial(light.draw, way), light.fit_s

    return {(name, way): partial(model, way) for way in ways}


def scores(picture: np.ndarray, press: PressPicture) -> dict[str, float]:
    """Return the metrics of one picture, PSNR in dB by region."""
    from skimage.metrics import structural_similarity

    rows, columns = np.indices(press.picture.shape[:2])
    radii = np.hypot(columns - press.center_px[0], rows - press.center_px[1]) / press.radius_px
    regions = (radii < 1, (radii >= 1) & (radii < 2), radii < 2, radii >= 0)
    return {
        **{name: psnr_db(picture, press.picture, where) for name, where in zip(LEVELS, regions, strict=True)},
        "SSIM": float(structural_similarity(picture, press.picture, channel_axis=2)),
        "mean abs": float(np.abs(picture.astype(float) - press.picture).mean()),
    }


@dataclass(frozen=True)
class Study:
    """Presses, models, and by name which presses are fitted and which are predicted."""

    presses: Sequence[PressPicture]
    models: Models
    splits: Mapping[str, tuple[Sequence[int], Sequence[int]]]

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
            found.append(scores(picture, self.presses[press]))
        frame_ms = 1e3 * float(np.median(times))
        return pd.DataFrame(found).to_dict("list") | {"fit, s": fit_s, "ms per frame": frame_ms}


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
