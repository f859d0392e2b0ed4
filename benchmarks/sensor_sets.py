"""Real sensors predicted: all sets of ball presses below a folder, each by the cross-validation of `gelgap calibrate`.

A set is a folder with `presses.toml`, `reference.png` and a sensor `start.toml` (its LEDs may be missing), one of the
package `taxim`, or a clone of a published repository. Each press is predicted by a fit of others, made at other places.
Nothing of a set is copied. `python -m gelgap.benchmarks.sensor_sets --table FILE` prints the table of a file of records
again.
"""

import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.adapt.result_table import ResultTable
from gelgap.assets.image_file import read_image
from gelgap.benchmarks.common import print_tables, read_records, write_records
from gelgap.calibrate.calibrator import calibrate_light
from gelgap.calibrate.membranes import sphere_profiles
from gelgap.calibrate.pictures import PressPicture, read_presses
from gelgap.calibrate.start import lit_from_dents
from gelgap.calibrate.taxim_sets import PressSet, taxim_presses
from gelgap.render import Camera, Markers, Sensor

MODELS = {
    "the reference, unchanged": "unchanged",
    "table of normals, as marked": "table",
    "gelgap, press as marked": "marked",
    "gelgap, press refined": "refined",
}
"""What a press is predicted by, and its field of a `HeldOut`."""
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


def read_own(folder: Path) -> PressSet:
    """Read a folder of one's own; LEDs that its start does not have come from the dents."""
    reference, presses = read_image(folder / "reference.png"), read_presses(folder / "presses.toml")
    start = Sensor.load(folder / "start.toml")
    if start.illumination is None:
        start = lit_from_dents(start, reference, presses)
    return PressSet(reference, tuple(presses), start)


def marked_set(
    reference: Path, pictures: Sequence[Path], marks: np.ndarray, ball_mm: float, mm_per_px: float
) -> PressSet:
    """Return presses of one ball with marked circles (n, 3): x, y and radius in px. LEDs are sought in the dents."""
    flat = read_image(reference)
    presses = tuple(
        PressPicture(read_image(path), ball_mm, radius_px=r, center_px=(x, y), name=path.stem)
        for path, (x, y, r) in zip(pictures, marks.tolist(), strict=True)
    )
    bare = Sensor(camera=Camera.showing(flat.shape[1] * mm_per_px), markers=Markers(layout="none"))
    return PressSet(flat, presses, lit_from_dents(bare, flat, presses))


def read_fots(folder: Path) -> PressSet:
    """Read Rancho-zhao/FOTS: circles marked by its authors, 19.58 px a mm; the ball is taken for 5 mm."""
    table, root = pd.read_csv(folder / "annotate.csv"), folder.parent
    pictures = [root / "gelsight" / name.rpartition("/")[2] for name in table["img_names"]]
    marks = table[["center_x", "center_y", "radius"]].to_numpy(float)
    return marked_set(root / "0000.png", pictures, marks, ball_mm=5.0, mm_per_px=1 / 19.58)


def read_digit(folder: Path) -> PressSet:
    """Read rohankotanu/3DCal-tests, a DIGIT: some of the presses at each of five places."""
    numbers = range(0, DIGIT_AT_PLACE * len(DIGIT_MARKS), DIGIT_AT_PLACE // DIGIT_TAKEN)
    probed = folder.parent / "probe_images"
    pictures = [next(probed.glob(f"{number}_*.png"), probed / f"{number}_.png") for number in numbers]
    marks = np.repeat(np.array(DIGIT_MARKS, float), DIGIT_TAKEN, axis=0)
    return marked_set(folder / "blank.png", pictures, marks, ball_mm=4.0, mm_per_px=0.0517)


def read_gelslim(folder: Path) -> PressSet:
    """Read siyuandong16/gelsight_heightmap_reconstruction, a GelSlim with markers; ball and scale as its code says."""
    pictures = [folder / f"sample_{number}.jpg" for number in GELSLIM_MARKS]
    marks = np.array(list(GELSLIM_MARKS.values()), float)
    return marked_set(folder / "ref.jpg", pictures, marks, ball_mm=7.6, mm_per_px=0.10577)


READERS: dict[str, Callable[[Path], PressSet]] = {
    "presses.toml": read_own,
    "dataPack.npz": lambda folder: taxim_presses(str(folder)),
    "annotate.csv": read_fots,
    "blank.png": read_digit,
    "sample_8.jpg": read_gelslim,
}


def find_sets(folder: Path) -> dict[str, Callable[[], PressSet]]:
    """Return what reads each set that lies in a folder or below it, by the set's place, in order."""
    found: dict[str, Callable[[], PressSet]] = {}
    for path in sorted({file.parent for mark in READERS for file in folder.rglob(mark)}):
        mark = next(mark for mark in READERS if (path / mark).is_file())
        found[str(path.relative_to(folder))] = partial(READERS[mark], path)
    return found


def run(quick: bool, out_dir: Path, data: Path) -> None:
    """Print how each set in a folder is predicted, and write `sensors.jsonl`. Quick: two folds instead of three."""
    rows, refused = [], []
    folds = 2 if quick else 3
    for name, read in find_sets(data).items():
        started = time.process_time()
        try:
            found = read()
            fit = calibrate_light(found.start, found.reference, found.presses, sphere_profiles, folds=folds)
        except (ValueError, OSError) as error:
            refused.append(f"{name} is refused: {error}.")
            continue
        seconds = time.process_time() - started
        for model, kind in MODELS.items():
            levels = [getattr(press, kind) for press in fit.held_out]
            rows.append(
                {
                    "set": name,
                    "presses": len(levels),
                    "model": model,
                    "inside": tuple(inside for inside, _ in levels),
                    "ring": tuple(ring for _, ring in levels),
                    "fit, s": seconds,
                    "folds": folds,
                }
            )
    if not rows and not refused:
        raise ValueError(f"--data {data} holds no set of presses; {', '.join(READERS)} mark one")
    write_records(out_dir / "sensors.jsonl", pd.DataFrame(rows), ("set", "model"))
    for table in tables(read_records(out_dir / "sensors.jsonl")) if rows else []:
        table.show()
    for reason in refused:
        print(reason)


def tables(records: pd.DataFrame) -> list[ResultTable]:
    """Return how each set is predicted by each model: PSNR in dB, inside the contact and around, medians (worst)."""
    rows = []
    for name, own in records.groupby("set", sort=False):
        levels = own.set_index("model")
        row = {"set": name, "presses": own["presses"].iloc[0]}
        for model in MODELS:
            regions = levels.loc[model, ["inside", "ring"]]
            row[model] = ", ".join(map(median_and_worst, regions))
        rows.append(row | {"fits, s": own["fit, s"].iloc[0]})
    folds = records["folds"].iloc[0]
    note = (
        f"ring: from one to two radii; fits: core s of one of all presses and {folds} that leave a part out"
    )
    title = "Real sensors, presses predicted by fits of others: PSNR in dB, inside and ring, median (worst)"
    return [ResultTable.of(title, pd.DataFrame(rows), note, {"fits, s": "{:.0f}"})]


def median_and_worst(levels: Sequence[float]) -> str:
    """Return levels of several presses in words."""
    return f"{np.median(levels):.1f} ({np.min(levels):.1f})"


if __name__ == "__main__":
    print_tables(__doc__, tables)
