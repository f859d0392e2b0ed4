"""Real sensors predicted: sets of ball presses in a folder, each fitted in part and predicted where it was not fitted.

A set is a clone of a published repository, a folder of the package `taxim`, or a folder of one's own: `presses.toml`,
`reference.png`, a sensor `start.toml` (its LEDs may be missing) and perhaps `other-presses.toml`, which are predicted
after a fit of the first. Presses of one place are held out together. Predicted presses are taken where they are marked;
of their pictures only the brightness far from the contact is used. Nothing of a set is copied.
"""

import csv
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import show, write_json
from gelgap.benchmarks.render.rivals import Fitted
from gelgap.benchmarks.render.sensors import Study, median_and_worst, saved_renderer
from gelgap.domains import PressSet, lit_from_dents, sphere_profiles, taxim_presses
from gelgap.render import Camera, LightCalibration, Markers, PressPicture, Sensor, difference_picture
from gelgap.render.calibration.calibrator import FEWEST_FOR_ORDER_3, LightTask
from gelgap.render.calibration.fit import LightFit
from gelgap.render.calibration.pictures import read_picture, read_presses
from gelgap.render.calibration.poses import MODELLED_MM, PlacedPresses, place_presses
from gelgap.render.imaging import psnr_db

Parts = Sequence[tuple[np.ndarray, np.ndarray]]
"""Which presses are fitted and which are predicted, part by part."""
METRICS = ("inside", "ring", "within", "whole", "SSIM", "mean abs")
GAIN = 4
FEW = 6
EVERY_OTHER_FROM = 40  # presses from which on every other one is fitted; fewer are cross-validated
PARTS = 3
SAME_PLACE = 0.1  # contact radii
MINI_BALL_MM = 1.4  # as in the preset that was fitted to that set
# DIGIT: places of 30 presses each; contacts marked by eye in the mean of the differences, 0.8 of the rims, in px.
DIGIT_MARKS = ((66, 218, 29), (74, 207, 29), (82, 196, 29), (90, 185, 29), (98, 175, 29))
DIGIT_AT_PLACE, DIGIT_TAKEN = 30, 5
# GelSlim: contacts marked by eye in the differences, 0.8 of the dents' rims, by the picture's number.
GELSLIM_MARKS = {
    8: (258, 121, 22),
    13: (158, 115, 18),
    34: (128, 103, 26),
    37: (127, 160, 23),
    38: (143, 183, 24),
    40: (208, 204, 21),
    42: (265, 208, 22),
    43: (275, 190, 18),
    47: (324, 121, 26),
    48: (318, 75, 26),
}


@dataclass(frozen=True)
class SensorSet:
    """Presses of a sensor; those from `others_from` on are of another list."""

    name: str
    found: PressSet
    others_from: int

    @classmethod
    def of(
        cls,
        name: str,
        reference: Path,
        pictures: Sequence[Path],
        marks: np.ndarray,
        ball_mm: float,
        mm_per_px: float,
    ) -> "SensorSet":
        """Return the presses of one ball with marks (n, 3): x, y and radius in px."""
        flat = read_picture(reference)
        presses = tuple(
            PressPicture(
                read_picture(path),
                ball_mm,
                radius_px=float(r),
                center_px=(float(x), float(y)),
                name=path.stem,
            )
            for path, (x, y, r) in zip(pictures, marks, strict=True)
        )
        return cls.started(name, flat, presses, Sensor(camera=Camera.showing(flat.shape[1] * mm_per_px)))

    @classmethod
    def started(
        cls,
        name: str,
        reference: np.ndarray,
        presses: tuple[PressPicture, ...],
        sensor: Sensor,
        others_from: int = -1,
    ) -> "SensorSet":
        """Return presses with a start whose LEDs, if it has none, come from the dents."""
        others_from = len(presses) if others_from < 0 else others_from
        if sensor.illumination is None:
            sensor = lit_from_dents(sensor, reference, presses[:others_from])
        start = sensor.model_copy(update={"markers": Markers(layout="none")})
        return cls(name, PressSet(reference, presses, start), others_from)

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
    """Read a folder of one's own."""
    presses, others = read_presses(folder / "presses.toml"), ()
    if (folder / "other-presses.toml").is_file():
        others = read_presses(folder / "other-presses.toml")
    reference = read_picture(folder / "reference.png")
    sensor = Sensor.load(folder / "start.toml")
    return SensorSet.started(folder.name, reference, (*presses, *others), sensor, len(presses))


def read_taxim(folder: Path) -> SensorSet:
    """Read a folder of the package `taxim`; the ball of the Mini's, which is not said, is the preset's."""
    found = taxim_presses(str(folder))
    presses = tuple(
        replace(press, sphere_diameter_mm=press.sphere_diameter_mm or MINI_BALL_MM) for press in found.presses
    )
    return SensorSet(f"taxim {folder.name}", replace(found, presses=presses), len(presses))


def read_fots(folder: Path) -> SensorSet:
    """Read Rancho-zhao/FOTS: circles marked by its authors, 19.58 px a mm; the ball is taken for 5 mm."""
    root = folder.parent
    rows = list(csv.DictReader((folder / "annotate.csv").read_text(encoding="utf-8").splitlines()))
    pictures = [root / "gelsight" / row["img_names"].rpartition("/")[2] for row in rows]
    marks = np.array([[float(row[name]) for name in ("center_x", "center_y", "radius")] for row in rows])
    return SensorSet.of("FOTS", root / "0000.png", pictures, marks, ball_mm=5.0, mm_per_px=1 / 19.58)


def read_digit(folder: Path) -> SensorSet:
    """Read rohankotanu/3DCal-tests, a DIGIT: some of the presses at each of five places."""
    root, step = folder.parent, DIGIT_AT_PLACE // DIGIT_TAKEN
    numbers = range(0, DIGIT_AT_PLACE * len(DIGIT_MARKS), step)
    pictures = [next((root / "probe_images").glob(f"{number}_*.png")) for number in numbers]
    marks = np.repeat(DIGIT_MARKS, DIGIT_TAKEN, axis=0)
    return SensorSet.of("DIGIT", folder / "blank.png", pictures, marks, ball_mm=4.0, mm_per_px=0.0517)


def read_gelslim(folder: Path) -> SensorSet:
    """Read siyuandong16/gelsight_heightmap_reconstruction, a GelSlim with dots; ball and scale as its code says."""
    pictures = [folder / f"sample_{number}.jpg" for number in GELSLIM_MARKS]
    marks = np.array(list(GELSLIM_MARKS.values()))
    return SensorSet.of("GelSlim", folder / "ref.jpg", pictures, marks, ball_mm=7.6, mm_per_px=0.10577)


READERS: dict[str, Callable[[Path], SensorSet]] = {
    "presses.toml": read_own,
    "dataPack.npz": read_taxim,
    "annotate.csv": read_fots,
    "blank.png": read_digit,
    "sample_8.jpg": read_gelslim,
}


class Predictors:
    """What predicts presses of one set, each after a fit of the presses of some indices."""

    def __init__(self, own: SensorSet) -> None:
        found = own.found
        profiles = sphere_profiles({press.sphere_diameter_mm for press in found.presses})
        self.placed = place_presses(found.start.camera, found.reference, found.presses, profiles)
        self.start = found.start
        self.fit = cache(self._fit)

    @property
    def presses(self) -> list[PressPicture]:
        """The presses, each with the circle that it is judged by."""
        marks = zip(self.placed.centers_px, self.placed.radii_px, strict=True)
        return [
            replace(press, center_px=tuple(center), radius_px=float(radius))
            for press, (center, radius) in zip(self.placed.presses, marks, strict=True)
        ]

    def _form(self, fitted: tuple[int, ...]) -> tuple[int, int]:
        return (3, 2) if len(fitted) >= FEWEST_FOR_ORDER_3 else (2, 1)

    def _fit(self, fitted: tuple[int, ...]) -> tuple[LightFit, float, float]:
        """Return the fit, the level at which its sensor shows its own reference, and its time."""
        task = LightTask(self.start, self.placed, *self._form(fitted))
        started = time.process_time()
        fit = task.fit(np.array(fitted))
        fit_s = time.process_time() - started
        renderer = saved_renderer(LightCalibration(**task.result(fit)), self.placed.size_px)
        return fit, psnr_db(renderer.reference(), self.placed.reference), fit_s

    def unchanged(self, fitted: tuple[int, ...]) -> Fitted:
        return lambda press: lambda: self.placed.reference, None

    def table(self, fitted: tuple[int, ...]) -> Fitted:
        table = self.placed.table(np.array(fitted), self._form(fitted)[1])
        centers = self.placed.centers_px
        return lambda press: lambda: self.placed.at_level(press, table.picture(centers[press])), None

    def gelgap(self, fitted: tuple[int, ...]) -> Fitted:
        fit, *_ = self.fit(fitted)
        seen = self.placed.seen_from(fit.distance_mm)

        def draw(press: int) -> Callable[[], np.ndarray]:
            return partial(
                seen.picture_of, fit.light, fit.field, press, fit.expected_mm(seen, press), MODELLED_MM
            )

        return draw, None


def measure(own: SensorSet, out_dir: Path, quick: bool) -> pd.DataFrame:
    """Return how the presses of a set are predicted, all parts of a split together; write pictures of three."""
    predict = Predictors(own)
    splits = own.splits(predict.placed)
    if quick:
        splits = dict(list(splits.items())[:1])
    models = {
        ("the reference, unchanged", ""): predict.unchanged,
        ("plain table", "marked"): predict.table,
        ("gelgap", "marked"): predict.gelgap,
    }
    rows = []
    for split, parts in splits.items():
        named = {f"{split} {part}": indices for part, indices in enumerate(parts)}
        study = Study(predict.presses, models, named, clear=predict.placed.clear_of_dots)
        for model, press in models:
            settings = [{"predicted": part, "model": model, "press": press} for part in named]
            found = [study.measure(setting) for setting in settings]
            levels = {name: [value for part in found for value in part[name]] for name in METRICS}
            rows.append(
                {"set": own.name, "predicted": f"{split}: {len(levels['ring'])}", "model": model, **levels}
            )
            if model == "gelgap":
                fits = [predict.fit(tuple(map(int, fitted))) for fitted, _ in parts]
                rows[-1] |= {
                    "fit, s": [fit_s for *_, fit_s in fits],
                    "untouched": [level for _, level, _ in fits],
                }
                if len(rows) == len(models):
                    write_pictures(
                        predict, parts, levels["within"], out_dir / f"{own.name.replace(' ', '-')}.png"
                    )
    return pd.DataFrame(rows)


def write_pictures(predict: Predictors, parts: Parts, levels: Sequence[float], path: Path) -> None:
    """Write real, predicted and 128 + 4 × difference of the presses with the best, median and worst level."""
    import cv2

    pairs = [(fitted, press) for fitted, predicted in parts for press in predicted]
    rows = []
    for at in np.argsort(levels)[[-1, len(levels) // 2, 0]]:
        fitted, press = pairs[at]
        draw, _ = predict.gelgap(tuple(map(int, fitted)))
        real, predicted = predict.presses[press].picture, draw(int(press))()
        rows.append(np.hstack([real, predicted, difference_picture(predicted, real, GAIN)]))
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), np.vstack(rows)[..., ::-1]):
        raise RuntimeError(f"{path} could not be written")


def run(quick: bool, out_dir: Path, data: Path) -> None:
    """Print how each set in a folder is predicted; write JSON and pictures. Quick: held-out places alone."""
    sets = list(find_sets(data))
    if not sets:
        raise ValueError(f"--data {data} holds no set of presses; {', '.join(READERS)} mark one")
    records = pd.concat([measure(own, out_dir, quick) for own in sets], ignore_index=True)
    cells = dict.fromkeys(("inside", "ring", "whole"), median_and_worst)
    cells |= {"SSIM": lambda v: f"{np.median(v):.3f}", "mean abs": lambda v: f"{np.median(v):.2f}"}
    cells |= {"untouched": lambda v: f"{min(v):.1f}" if isinstance(v, list) else ""}
    cells |= {"fit, s": lambda v: f"{np.mean(v):.1f}" if isinstance(v, list) else ""}
    table = records.assign(**{name: records[name].map(cell) for name, cell in cells.items()})
    show(
        "real sensors, presses predicted as marked; PSNR in dB, median (worst)",
        table[["set", "predicted", "model", *cells]],
        "untouched: the rendered reference beside the real one, worst of the fits; mean abs: of the whole, code "
        "values; PSNR of pixels without dots",
    )
    write_json(out_dir / "sensor-sets.json", {"predictions": records})
