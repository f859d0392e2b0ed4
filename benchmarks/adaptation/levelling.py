"""What changes of a target's light cost, with and without levelling.

A network learns the forces of `wmb0i0`. Each change is made to all pictures of the target `wmb0i1`, not to its
reference; normalisations are those of the changed training pictures (AdaBN), and the error is that of the changed test
pictures. The folder has the domains of the adaptation benchmark: `source`, `target`, and `-touches` of both.

    python -m gelgap.benchmarks.adaptation.levelling --data DIR --out levelling.jsonl
    python -m gelgap.benchmarks.adaptation.levelling --table levelling.jsonl
"""

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.adapt.evaluation import evaluate
from gelgap.adapt.inputs import INPUTS
from gelgap.adapt.model import with_statistics_of
from gelgap.adapt.profile import Profile
from gelgap.adapt.result_table import ResultTable
from gelgap.adapt.split import split_for_training
from gelgap.adapt.trainer import train_source
from gelgap.benchmarks.adaptation.study import begun_by_touches
from gelgap.benchmarks.common import Results, Setting, read_records, run_missing
from gelgap.data import LabelledFrames, open_domain
from gelgap.data.frames.dataset import DerivedFrames

SOURCE, TARGET = "wmb0i0", "wmb0i1"
EPOCHS = 40
"""Of stage 1."""
SETTINGS: list[Setting] = [
    {"input": shown, "levelled": levelled} for shown in ("touch", "pictures") for levelled in (False, True)
]
Change = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Pictures (n, h, w, 3) and their places in a clip, 0 to 1, (n, 1, 1, 1), to changed pictures, in codes."""
CHANGES: dict[str, Change] = {
    "none": lambda codes, place: codes,
    "gain +1 %": lambda codes, place: 1.01 * codes,
    "gain +2 %": lambda codes, place: 1.02 * codes,
    "gain +5 %": lambda codes, place: 1.05 * codes,
    "gain −20 %": lambda codes, place: 0.8 * codes,
    "red +2 %, blue −2 %": lambda codes, place: codes * np.array([1.02, 1.0, 0.98]),
    "+3 codes": lambda codes, place: codes + 3.0,
    "drift to −10 %": lambda codes, place: codes * (1 - 0.1 * place),
}


class Relit(DerivedFrames):
    """Frames whose pictures a change has been made to, in the order of their columns `frame_id`."""

    def __init__(self, whole: LabelledFrames, name: str):
        super().__init__(whole, whole.columns, name.encode())
        self._relight = CHANGES[name]
        order = np.argsort(np.argsort(whole.columns["frame_id"]))
        self._place = order / max(len(order) - 1, 1)

    def picture(self, index: int) -> np.ndarray:
        return self._relit(super().picture(index)[None], self._place[index : index + 1])[0]

    def load(self, size_px: tuple[int, int], markers: bool) -> np.ndarray:
        return self._relit(super().load(size_px, markers), self._place)

    def _relit(self, pictures: np.ndarray, place: np.ndarray) -> np.ndarray:
        codes = self._relight(pictures.astype(float), place[:, None, None, None])
        return np.clip(np.rint(codes), 0, 255).astype(np.uint8)


def measured(data: Path, setting: Setting) -> Results:
    """Return the mean error of each change, N, and the core's time of training and of one frame."""
    shown = setting["input"]
    changes = {"input": shown, "levelling": setting["levelled"], "source_epochs": EPOCHS, "split_by": "point"}
    if INPUTS[shown].from_touch:
        changes |= {"shift_px": 0, "marker_hiding": 0.0}
    profile = Profile.preset("benchmark").replace(**changes)
    source, target = data / "source" / SOURCE, data / "target" / TARGET
    # A touch joins the trajectory of its point after the split.
    frames = split_for_training(
        open_domain(source), open_domain(target), profile.replace(input="pictures"), seed=0
    )
    if INPUTS[shown].from_touch:
        touches = (
            open_domain(at.parent.with_name(f"{at.parent.name}-touches") / at.name) for at in (source, target)
        )
        frames = begun_by_touches(frames, *touches)
    start = time.process_time()
    model = train_source(frames.source_train, profile)
    training_s = time.process_time() - start
    mae_n: dict[str, float] = {}
    start = time.process_time()
    for name in CHANGES:
        seen, judged = Relit(frames.target_train, name), Relit(frames.target_test, name)
        mae_n[name] = round(evaluate(with_statistics_of(model, seen), judged).mean_mae_n, 4)
    per_frame_s = (time.process_time() - start) / len(CHANGES) / (len(seen) + len(judged))
    return {
        "mae_n": mae_n,
        "training_core_s": round(training_s, 1),
        "frame_core_ms": round(1e3 * per_frame_s, 2),
    }


def table(records: pd.DataFrame) -> ResultTable:
    """Return the errors of each input, levelled or not, under each change, and what they cost."""
    rows = records.rename(columns={f"mae_n.{name}": f"{name}, N" for name in CHANGES})
    columns = [
        shown + (", levelled" if levelled else "")
        for shown, levelled in zip(rows["input"], rows["levelled"], strict=True)
    ]
    costs = {"training_core_s": "training, s of a core", "frame_core_ms": "a frame, ms of a core"}
    rows = rows.rename(columns=costs)[[*(f"{name}, N" for name in CHANGES), *costs.values()]]
    return ResultTable.of("Light that changes", rows.set_axis(columns).T.rename_axis("change of light"))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--table", type=Path, metavar="FILE", help="print the table of a file of records")
    parser.add_argument("--data", type=Path, metavar="DIR", help="the domains")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", default=Path("levelling.jsonl"), help="the records"
    )
    given = parser.parse_args()
    if given.table is None and given.data is None:
        parser.error("name --data, to measure, or --table")
    if given.table is not None and not given.table.is_file():
        parser.error(f"--table {given.table}: no such file")
    if given.table is not None:
        records = read_records(given.table)
    else:
        records = run_missing(partial(measured, given.data), SETTINGS, given.out, workers=1)
    print(table(records).markdown())


if __name__ == "__main__":
    main()
