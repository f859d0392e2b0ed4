"""Real sensors predicted: sets of ball presses in a folder, each fitted in part and predicted where it was not fitted.

A set is a folder with `presses.toml`, `reference.png`, a sensor `start.toml` (its LEDs may be missing) and perhaps
`other-presses.toml`, which are predicted after a fit of the first; or a folder of the package `taxim`. Presses of one
place are held out together. Predicted presses are taken where they are marked; of their pictures only the brightness
far from the contact is used.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import write_json
from gelgap.benchmarks.render import rivals
from gelgap.benchmarks.render.rivals import Draw, Fitted
from gelgap.benchmarks.render.sensors import Study, show_scores
from gelgap.domains import PressSet, lit_from_dents, sphere_profiles, taxim_presses
from gelgap.render import Markers, Sensor
from gelgap.render.calibration.calibrator import FEWEST_FOR_ORDER_3, LightTask
from gelgap.render.calibration.pictures import read_picture, read_presses
from gelgap.render.calibration.poses import MODELLED_MM, PlacedPresses, place_presses

Parts = Sequence[tuple[np.ndarray, np.ndarray]]
"""Which presses are fitted and which are predicted, part by part."""
METRICS = ("inside", "ring", "within", "whole", "SSIM", "mean abs")
FEW = 6
EVERY_OTHER_FROM = 40  # presses from which on every other one is fitted; fewer are cross-validated
PARTS = 3
SAME_PLACE = 0.1  # contact radii
MINI_BALL_MM = 1.4  # as in the preset that was fitted to that set


@dataclass(frozen=True)
class SensorSet:
    """Presses of a sensor; those from `others_from` on are of another list."""

    name: str
    found: PressSet
    others_from: int

    def splits(self, placed: PlacedPresses) -> dict[str, Parts]:
        """Return by name what is predicted from what."""
        own, marks = np.arange(self.others_from), placed.centers_px
        others = np.arange(self.others_from, len(marks))
        near = np.hypot(*(marks[:, None] - marks[None]).T) < SAME_PLACE * placed.radii_px
        _, place = np.unique(near.argmax(axis=0)[own], return_inverse=True)
        places = place.max() + 1
        parts = 2 if places >= EVERY_OTHER_FROM else places if places <= FEW else PARTS
        held_out = [own[place % parts == part] for part in range(parts)]
        if places >= EVERY_OTHER_FROM:
            held_out = held_out[1:]
        splits = {"places held out": [(np.setdiff1d(own, part), part) for part in held_out]}
        if places >= 4 * FEW:
            left, right = np.array_split(np.argsort(marks[own, 0], kind="stable"), 2)
            splits["right half after the left"] = [(np.sort(left), np.sort(right))]
        if len(own) > FEW:
            few = np.linspace(0, len(own) - 1, FEW).astype(int)
            splits["all others after six"] = [(few, np.setdiff1d(own, few))]
        if len(others):
            splits["other list"] = [(own, others)]
        return splits


def find_sets(folder: Path) -> Iterator[SensorSet]:
    """Read the sets that lie in a folder or below it, in order of their names."""
    for path in sorted({file.parent for mark in READERS for file in folder.rglob(mark)}):
        for mark, read in READERS.items():
            if (path / mark).is_file():
                yield read(path)


def read_own(folder: Path) -> SensorSet:
    """Read a folder of one's own; LEDs that its start does not have come from the dents."""
    presses, others = read_presses(folder / "presses.toml"), ()
    if (folder / "other-presses.toml").is_file():
        others = read_presses(folder / "other-presses.toml")
    sensor, reference = Sensor.load(folder / "start.toml"), read_picture(folder / "reference.png")
    if sensor.illumination is None:
        sensor = lit_from_dents(sensor, reference, presses)
    start = sensor.model_copy(update={"markers": Markers(layout="none")})
    return SensorSet(folder.name, PressSet(reference, (*presses, *others), start), len(presses))


def read_taxim(folder: Path) -> SensorSet:
    """Read a folder of the package `taxim`; the ball of the Mini's, which is not said, is the preset's."""
    found = taxim_presses(str(folder))
    presses = tuple(
        replace(press, sphere_diameter_mm=press.sphere_diameter_mm or MINI_BALL_MM) for press in found.presses
    )
    return SensorSet(f"taxim {folder.name}", replace(found, presses=presses), len(presses))


READERS: dict[str, Callable[[Path], SensorSet]] = {
    "presses.toml": read_own,
    "dataPack.npz": read_taxim,
}


def form(fitted: Sequence[int]) -> dict[str, int]:
    """Return the form of the light that so many presses allow."""
    return {"order": 3, "degree": 2} if len(fitted) >= FEWEST_FOR_ORDER_3 else {"order": 2, "degree": 1}


def plain_table(placed: PlacedPresses, fitted: Sequence[int]) -> Fitted:
    """Predict by a table of the fitted presses, without physics."""
    table = placed.table(np.array(fitted), form(fitted)["degree"])
    return lambda press: lambda: placed.at_level(press, table.picture(placed.centers_px[press])), None


def fitted_light(start: Sensor, placed: PlacedPresses, fitted: Sequence[int]) -> Fitted:
    """Predict by light that is fitted to the fitted presses; a press is expected where those are off their marks."""
    started_s = time.process_time()
    fit = LightTask(start, placed, **form(fitted)).fit(np.array(fitted))
    fit_s, seen = time.process_time() - started_s, placed.seen_from(fit.distance_mm)
    draw: Draw = lambda press: partial(  # noqa: E731
        seen.picture_of, fit.light, fit.field, press, fit.expected_mm(seen, press), MODELLED_MM
    )
    return draw, fit_s


def measure(own: SensorSet, quick: bool) -> pd.DataFrame:
    """Return how each model predicts the presses of a set, all parts of a split together."""
    found = own.found
    profiles = sphere_profiles({press.sphere_diameter_mm for press in found.presses})
    placed = place_presses(found.start.camera, found.reference, found.presses, profiles)
    circles = zip(placed.presses, placed.centers_px, placed.radii_px, strict=True)
    judged = [replace(press, center_px=tuple(at), radius_px=float(radius)) for press, at, radius in circles]
    models = {
        ("the reference, unchanged", ""): partial(rivals.unchanged, found),
        ("plain table", "marked"): partial(plain_table, placed),
        ("gelgap", "marked"): partial(fitted_light, found.start, placed),
    }
    rows = []
    for split, parts in list(own.splits(placed).items())[: 1 if quick else None]:
        study = Study(judged, models, dict(enumerate(parts)), clear=placed.clear_of_dots)
        for model, press in models:
            settings = [{"predicted": part, "model": model, "press": press} for part in study.splits]
            of_parts = pd.DataFrame(map(study.measure, settings))
            levels = {name: of_parts[name].sum() for name in METRICS}  # lists, one after the other
            predicted = f"{split}: {len(levels['ring'])}"
            fit_s = of_parts["fit, s"].mean()
            rows.append({"set": own.name, "predicted": predicted, "model": model, **levels, "fit, s": fit_s})
    return pd.DataFrame(rows)


def run(quick: bool, out_dir: Path, data: Path) -> None:
    """Print how each set in a folder is predicted, and write `sensor-sets.json`. Quick: held-out places alone."""
    sets = list(find_sets(data))
    if not sets:
        raise ValueError(f"--data {data} holds no set of presses; {', '.join(READERS)} mark one")
    records = pd.concat([measure(own, quick) for own in sets], ignore_index=True)
    show_scores(
        "real sensors, presses predicted as marked; PSNR in dB, median (worst)",
        records,
        ("set", "predicted", "model", "fit, s"),
        "mean abs: of the whole, code values; PSNR of pixels without dots",
    )
    write_json(out_dir / "sensor-sets.json", {"predictions": records})
