"""How many labelled target frames close a gap: fine-tuning, an affine correction and both, without and after DSAN."""

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from operator import attrgetter
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
    from gelgap.domains import DomainRecipe

RECORD = "labels.jsonl"
METHODS = ("source-only", "dsan")
LABELS = (1, 5, 20, 100)
COUNTS = (0, *LABELS)
WAYS = ("affine", "fine-tuning", "both")
HEADS = ["gap", "adapted by", "with the labels"]
SEEDS = (0, 1, 2, 3, 4)
DRAWS = 3
"""How often labelled frames are drawn; errors are means."""
BASE = "mb0i0"
PATH = PROFILE = "smoke"
UNSEEN = {
    "modulus": ("elastomer.young_modulus_mpa", "scale", (0.5, 0.7, 1.4)),
    "friction": ("elastomer.friction", "set", (0.12, 0.5)),
}
"""Gaps from the base which a picture does not show: a field of the domain, its change and values."""
CLOSED = 1.1
"""A gap counts as closed at this multiple of the error without a gap."""


def measure(study: Study) -> None:
    """Do the missing runs on the nine groups, then those on single gaps, by default of five seeds."""
    seeds = study.seeds or SEEDS
    nine = grid([("paired", group) for group in board.GROUPS], METHODS, seeds)
    study.generate_for(nine)
    study.run(label_run, nine, RECORD)
    if time.time() < study.stop:
        folder, recipes = study.out / "gaps", unseen_gaps().values()
        own = replace(study, data=folder / "data", out=folder / "runs", profile=PROFILE)
        own.generate(list(recipes))
        cases = [("paired", (BASE, recipe.name)) for recipe in recipes]
        own.run(label_run, grid(cases, METHODS, seeds, board.AT_RANDOM), RECORD)


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


def curves(points: pd.DataFrame, targets: Sequence[str] | None = None) -> pd.DataFrame:
    """Return the mean error with each number of labels (columns) by method and way, and by target if some are given."""
    names = {} if targets is None else {"target": targets}
    names |= {"method": METHODS, "way": WAYS}
    table = points.pivot_table(index=list(names), columns="labels", values="error_n")
    return table.reindex(pd.MultiIndex.from_product(names.values(), names=names), columns=COUNTS)


def tables(folder: Path) -> list[ResultTable]:
    """Return the tables of the nine groups and of the gap curves, as far as they were run."""
    shown = zip((nine_table, gap_table), _load(folder), strict=True)
    return [table(points) for table, points in shown if len(points)]


def _load(folder: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    return load_points(folder / RECORD), load_points(folder / "gaps" / "runs" / RECORD)


def nine_table(points: pd.DataFrame) -> ResultTable:
    """Error by number of labels, mean over the groups."""
    groups, seeds = len(points[["source", "target"]].drop_duplicates()), points["seed"].nunique()
    return result_table(
        "A few labelled target frames, nine groups: mean MAE, N",
        curves(points).rename_axis(HEADS[1:]).rename(columns="{} labels".format),
        f"Mean over {groups} groups, {seeds} seed(s) and {DRAWS} draws of the frames; paired contacts, split "
        "by contact point. Both: fine-tuned, then corrected.",
        {"": "{:.3f}"},
    )


def unseen_gaps() -> "dict[str, DomainRecipe]":
    """Return the base and its variants by what differs, such as modulus × 0.5."""
    from gelgap.domains import Factor, Sweep, sweep_variants

    found: dict[str, DomainRecipe] = {}
    for name, (field, change, values) in UNSEEN.items():
        factors = (Factor(field=field, change=change, values=values),)
        sweep = Sweep(name=name, base=BASE, path=PATH, method="one-at-a-time", factors=factors)
        base, *variants = (variant.recipe for variant in sweep_variants(sweep, quality="draft"))
        of_base = attrgetter(field)(base)
        own = {f"{name} × {round(attrgetter(field)(one) / of_base, 6):g}": one for one in variants}
        found |= {"none": base, **own}
    return found


def gap_names() -> dict[str, str]:
    """Return what differs by domain."""
    return {recipe.name: name for name, recipe in unseen_gaps().items()}


def gap_table(points: pd.DataFrame) -> ResultTable:
    """How many labels close a gap of modulus or friction."""
    names = gap_names()
    frame = curves(points, [target for target in names if target in set(points["target"])])
    least = curves(points[points["target"] == BASE])[0].reindex(frame.index.droplevel("target"))
    closed = frame.le(CLOSED * least.to_numpy(), axis=0)
    frame["closed with"] = closed.idxmax(axis=1).where(closed.any(axis=1))
    return result_table(
        f"Labels that close a gap which pictures do not show, from {BASE}, profile {PROFILE}: mean MAE, N",
        frame.rename(index=names, columns={n: f"{n} labels" for n in COUNTS}).rename_axis(HEADS),
        f"Closed: at most {CLOSED:g} of the same method's error without labels and without a gap. A dash: not with as "
        f"many labels as the target has to train on. Split at random; mean over {DRAWS} draws of the frames.",
        {"": "{:.3f}", "closed with": "{:.0f}"},
    )


def figures(folder: Path) -> list[NamedFigure]:
    """Return the curves of error against labels: the nine groups' mean, and single gaps, as far as they were run."""
    from matplotlib.figure import Figure

    nine, gaps = _load(folder)
    panels: dict[str, tuple[pd.DataFrame, list[str]]] = {}
    if len(nine):
        found = curves(nine)
        dashes = ["--" if method == METHODS[0] else "-" for method, _ in found.index]
        styles = [f"C{number % len(WAYS)}o{dash}" for number, dash in enumerate(dashes)]
        panels["nine groups"] = found.set_axis(found.index.map(", ".join)), styles
    if len(gaps):
        found = curves(gaps, gaps["target"].unique()).xs((METHODS[0], "both"), level=("method", "way"))
        named = found.rename(gap_names() | {BASE: "no gap"})
        panels["one gap, source-only, fine-tuned and corrected"] = named, ["o-"] * len(named)
    if not panels:
        return []
    figure = Figure(figsize=(5.5 * len(panels), 3.8), layout="constrained")
    places = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, (title, (found, styles)) in zip(places, panels.items(), strict=True):
        found.T.reset_index(drop=True).plot(ax=axes, style=styles, title=title)
        axes.set_xticks(range(len(COUNTS)), map(str, COUNTS))
        axes.set_xlabel("labelled target frames")
        axes.legend(fontsize=7)
    places[0].set(ylabel="target MAE, N", ylim=(0, None))
    return [NamedFigure("few-labels", "Target MAE against the number of labelled target frames", figure)]


PART = Part(measure, tables, figures)
