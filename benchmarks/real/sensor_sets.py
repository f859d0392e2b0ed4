"""Real sensors predicted: all sets of ball presses below a folder, each by the cross-validation of `gelgap calibrate`.

A set is a folder with `presses.toml`, `reference.png` and a sensor `start.toml` (its LEDs may be missing), or one of
the package `taxim`. Each press is predicted by a fit of others.
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd

from gelgap.benchmarks.common import write_json
from gelgap.benchmarks.render.sensors import show_scores
from gelgap.domains import PressSet, lit_from_dents, sphere_profiles, taxim_presses
from gelgap.render import Sensor, calibrate_light
from gelgap.render.calibration.pictures import read_picture, read_presses

MODELS = {
    "the reference, unchanged": "unchanged",
    "plain table, press as marked": "table",
    "gelgap, press as marked": "marked",
    "gelgap, press refined": "refined",
}
"""What a press is predicted by, and its field of a `HeldOut`."""


def read_own(folder: Path) -> PressSet:
    """Read a folder of one's own; LEDs that its start does not have come from the dents."""
    reference, presses = read_picture(folder / "reference.png"), read_presses(folder / "presses.toml")
    start = Sensor.load(folder / "start.toml")
    if start.illumination is None:
        start = lit_from_dents(start, reference, presses)
    return PressSet(reference, tuple(presses), start)


READERS: dict[str, Callable[[Path], PressSet]] = {
    "presses.toml": read_own,
    "dataPack.npz": lambda folder: taxim_presses(str(folder)),
}


def find_sets(folder: Path) -> Iterator[tuple[str, PressSet]]:
    """Read the sets that lie in a folder or below it, in order of their places; each with its folder's name."""
    for path in sorted({file.parent for mark in READERS for file in folder.rglob(mark)}):
        mark = next(mark for mark in READERS if (path / mark).is_file())
        yield path.name, READERS[mark](path)


def run(quick: bool, out_dir: Path, data: Path) -> None:
    """Print how each set in a folder is predicted, and write `sensor-sets.json`. Quick: two folds instead of three."""
    rows, refused = [], []
    for name, found in find_sets(data):
        started = time.process_time()
        folds = 2 if quick else 3
        try:
            fit = calibrate_light(found.start, found.reference, found.presses, sphere_profiles, folds=folds)
        except ValueError as error:
            refused.append(f"{name} is refused: {error}.")
            continue
        seconds = time.process_time() - started
        for model, kind in MODELS.items():
            inside, ring = zip(*(getattr(press, kind) for press in fit.held_out), strict=True)
            levels = {"inside": inside, "ring": ring}
            rows.append({"set": name, "presses": len(inside), "model": model, **levels, "fit, s": seconds})
    if not rows and not refused:
        raise ValueError(f"--data {data} holds no set of presses; {' or '.join(READERS)} marks one")
    records = pd.DataFrame(rows, columns=["set", "presses", "model", "inside", "ring", "fit, s"])
    note = f"ring: from one to two radii; fit: of all presses, and {folds} folds. {' '.join(refused)}"
    title = "real sensors, presses predicted by fits of others; PSNR in dB, median (worst)"
    show_scores(title, records, ("set", "presses", "model", "fit, s"), note)
    write_json(out_dir / "sensor-sets.json", {"predictions": records, "refused": refused})
