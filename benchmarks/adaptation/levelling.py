"""What changes of a target's light cost with and without levelling: python -m gelgap.benchmarks.adaptation.levelling.

A network learns forces of the source. Each change is made to all pictures of the target, not to its reference; the
network's normalisations are those of the changed training pictures (AdaBN), and its error is that on the changed test
pictures. One row of JSON is written for each, from which the table is made.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.adapt.data import split_for_training
from gelgap.adapt.evaluation import evaluate
from gelgap.adapt.inputs import INPUTS
from gelgap.adapt.model import with_statistics_of
from gelgap.adapt.profile import Profile
from gelgap.adapt.trainer import train_source
from gelgap.benchmarks.adaptation.study import begun_by_touches
from gelgap.data import LabelledFrames, open_domain
from gelgap.data.frames.dataset import DerivedFrames

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
        self._change = name.encode()
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", type=Path, nargs="?", help="a domain as the adaptation benchmark makes it")
    parser.add_argument("target", type=Path, nargs="?", help="the same gel in another light")
    parser.add_argument("--records", type=Path, default=Path("docs/results/levelling.jsonl"))
    parser.add_argument("--epochs", type=int, default=100, help="of stage 1")
    given = parser.parse_args()
    if given.source is not None:
        records = [
            record
            for shown in ("touch", "pictures")
            for levelling in (False, True)
            for record in measured(given.source, given.target, shown, levelling, given.epochs)
        ]
        given.records.write_text("".join(json.dumps(record) + "\n" for record in records), encoding="utf-8")
    print(table(given.records))


def measured(source: Path, target: Path, shown: str, levelling: bool, epochs: int) -> list[dict[str, object]]:
    """Return a record of each change: mean error, N, and the core's time of training and of one frame."""
    changes = {"input": shown, "levelling": levelling, "source_epochs": epochs, "split_by": "point"}
    if INPUTS[shown].from_touch:
        changes["shift_px"] = 0
        changes["marker_hiding"] = 0.0
    profile = Profile.preset("board").replace(**changes)
    # A touch joins the trajectories of its point after the split.
    frames = split_for_training(open_domain(source), open_domain(target), profile.replace(input="pictures"), seed=0)
    if INPUTS[shown].from_touch:
        touches = (
            open_domain(at.parent.with_name(f"{at.parent.name}-touches") / at.name) for at in (source, target)
        )
        frames = begun_by_touches(frames, *touches)
    start = time.process_time()
    model = train_source(frames.source_train, profile)
    trained_s = time.process_time() - start
    records = []
    for name in CHANGES:
        seen, judged = Relit(frames.target_train, name), Relit(frames.target_test, name)
        start = time.process_time()
        errors = evaluate(with_statistics_of(model, seen), judged)
        per_frame_s = (time.process_time() - start) / (len(seen) + len(judged))
        records.append(
            {
                "input": shown,
                "levelled": levelling,
                "change": name,
                "mean_mae_n": round(errors.mean_mae_n, 4),
                "training_core_s": round(trained_s, 1),
                "frame_core_ms": round(1e3 * per_frame_s, 2),
            }
        )
        print(records[-1], flush=True)
    return records


def table(records: Path) -> str:
    """Return the table of a file of records: errors in N, levelled or not, of each input under each change."""
    rows = pd.DataFrame([json.loads(line) for line in records.read_text("utf-8").splitlines()])
    rows["shown"] = rows["input"] + rows["levelled"].map({False: "", True: ", levelled"})
    wide = rows.pivot(index="change", columns="shown", values="mean_mae_n").loc[list(CHANGES)]
    cost = rows.groupby("shown")[["training_core_s", "frame_core_ms"]].mean().T
    cost.index = ["training, s of a core", "a frame, ms of a core"]
    columns = list(dict.fromkeys(rows["shown"]))
    rows = pd.concat([wide, cost])[columns]
    lines = [["", *columns], ["---"] * (1 + len(columns))]
    lines += [
        [what, *(f"{value:.3f}" for value in values)]
        for what, values in zip(rows.index, rows.values, strict=True)
    ]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


if __name__ == "__main__":
    main()
