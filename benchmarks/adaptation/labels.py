"""How many labelled target frames close a gap: fine-tuning, an affine correction and both, without and after DSAN."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from gelgap.adapt import NamedFigure, ResultTable
from gelgap.benchmarks.adaptation import board
from gelgap.benchmarks.adaptation.study import Part, Study, grid, trained
from gelgap.benchmarks.common import Results, Setting, read_records, result_table

if TYPE_CHECKING:
    from gelgap.adapt import ForceModel, SplitFrames

RECORD = "labels.jsonl"
METHODS = ("source-only", "dsan")
LABELS = (1, 5, 20, 100)
WAYS = ("affine", "fine-tuning", "both")
SEEDS = (0, 1, 2, 3, 4)
DRAWS = 3
"""How often labelled frames are drawn; errors are means."""


def measure(study: Study) -> None:
    """Do the missing runs on the nine groups, by default of five seeds."""
    runs = grid([("paired", group) for group in board.GROUPS], METHODS, study.seeds or SEEDS)
    study.generate_for(runs)
    study.run(label_run, runs, RECORD)


def label_run(study: Study, run: Setting) -> Results:
    """Adapt once, then use labelled frames of the target's training part in every way."""
    frames, model, results = trained(study, run)
    points = [] if model is None else list(label_points(model, frames, run["seed"]))
    return {"problem": results["problem"], "mae_n": results["mae_n"], "points": points}


def label_points(model: "ForceModel", frames: "SplitFrames", seed: int) -> Iterator[Results]:
    """Yield the errors on the target's test frames without labels, and with as many as its training part has.

    They are means over the draws. Frames beyond the declared range, which nothing is trained on, are not drawn.
    """
    from gelgap.adapt import affine_correction, draw_labelled, evaluate, fine_tune
    from gelgap.domains import within_range

    def point(way: str, labels: int, models: "Iterable[ForceModel]") -> Results:
        found = [evaluate(one, frames.target_test) for one in models]
        means = {name: np.mean([getattr(one, name) for one in found], axis=0) for name in ("mae_n", "r2")}
        return {"way": way, "labels": labels, **{name: mean.tolist() for name, mean in means.items()}}

    yield point("none", 0, [model])
    candidates = within_range(frames.target_train)
    for labels in LABELS:
        if labels <= len(candidates):
            drawn = [draw_labelled(candidates, labels, DRAWS * seed + draw) for draw in range(DRAWS)]
            tuned = [fine_tune(model, own) for own in drawn]
            yield point("affine", labels, [affine_correction(model, own) for own in drawn])
            yield point("fine-tuning", labels, tuned)
            yield point("both", labels, map(affine_correction, tuned, drawn))


def load_points(file: Path) -> pd.DataFrame:
    """Return every point of a file's records, with its mean error over the axes; that without labels in every way."""
    runs = read_records(file).reindex(columns=["source", "target", "method", "seed", "points"])
    runs = runs.explode("points").dropna(subset="points").reset_index(drop=True)
    found = pd.DataFrame(runs["points"].tolist(), columns=["way", "labels", "mae_n"])
    points = runs.drop(columns="points").join(found)
    points["error_n"] = points["mae_n"].map(np.mean)
    points["way"] = points["way"].map({way: [way] for way in WAYS} | {"none": list(WAYS)})
    return points.explode("way")


def curves(points: pd.DataFrame) -> pd.DataFrame:
    """Return the mean error with each number of labels (columns) by method and way."""
    table = points.pivot_table(index=["method", "way"], columns="labels", values="error_n")
    rows = pd.MultiIndex.from_product([METHODS, WAYS], names=["adapted by", "with the labels"])
    return table.reindex(rows, columns=(0, *LABELS))


def tables(folder: Path) -> list[ResultTable]:
    """Return the error by number of labels, mean over the groups, if it was measured."""
    points = load_points(folder / RECORD)
    if points.empty:
        return []
    groups, seeds = len(points[["source", "target"]].drop_duplicates()), points["seed"].nunique()
    table = result_table(
        "A few labelled target frames, nine groups: mean MAE, N",
        curves(points).rename(columns="{} labels".format),
        f"Mean over {groups} groups, {seeds} seed(s) and {DRAWS} draws of the frames; paired contacts, split "
        "by contact point. Both: fine-tuned, then corrected.",
        {"": "{:.3f}"},
    )
    return [table]


def figures(folder: Path) -> list[NamedFigure]:
    """Return the curves of error against labels, if they were measured."""
    from matplotlib.figure import Figure

    points = load_points(folder / RECORD)
    if points.empty:
        return []
    found = curves(points)
    styles = [f"C{WAYS.index(way)}o{'--' if method == METHODS[0] else '-'}" for method, way in found.index]
    figure = Figure(figsize=(5.5, 3.8), layout="constrained")
    axes = figure.subplots()
    found.set_axis(found.index.map(", ".join)).T.reset_index(drop=True).plot(ax=axes, style=styles)
    axes.set_xticks(range(len(found.columns)), map(str, found.columns))
    axes.set(xlabel="labelled target frames", ylabel="target MAE, N", ylim=(0, None))
    axes.legend(fontsize=7)
    return [NamedFigure("few-labels", "Target MAE against the number of labelled target frames", figure)]


PART = Part(measure, tables, figures, chosen=("seeds",))
