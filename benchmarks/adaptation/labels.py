"""How many labelled target frames close a gap: fine-tuning, an affine correction and both, without and after DSAN."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gelgap.adapt import NamedFigure, ResultTable
from gelgap.benchmarks.adaptation.gaps import BASE, PROFILE, design
from gelgap.benchmarks.adaptation.jobs import (
    AT_RANDOM,
    BY_POINT,
    Axes,
    Bench,
    Changes,
    TrainingJob,
    configuration_of,
)
from gelgap.benchmarks.adaptation.paper import GROUPS
from gelgap.benchmarks.adaptation.parts import Part
from gelgap.benchmarks.adaptation.running import run_missing
from gelgap.benchmarks.adaptation.tables import by_column, number, numbers
from gelgap.benchmarks.adaptation.work import train_job
from gelgap.benchmarks.common.records import read_records

if TYPE_CHECKING:
    from matplotlib.axes import Axes as PlotAxes
    from matplotlib.figure import Figure

    from gelgap.adapt import ForceModel, SplitFrames

RECORD = "labels.jsonl"
METHODS = ("source-only", "dsan")
LABELS = (1, 5, 20, 100)
WAYS = ("affine", "fine-tuning", "both")
DRAWS = 3
"""How often labelled frames are drawn; errors are means."""
PANELS = ("modulus", "friction")
"""The gap curves whose gaps a picture does not show."""
CLOSED = 1.1
"""A gap counts as closed at this multiple of the error without a gap."""


@dataclass(frozen=True)
class LabelPoint:
    """Error (N) and R² per axis with some labelled frames used in one way, means over the draws."""

    way: str
    labels: int
    mae_n: Axes
    r2: Axes

    @property
    def mean_mae_n(self) -> float:
        """Mean over the axes, N."""
        return float(np.mean(self.mae_n))


@dataclass(frozen=True)
class LabelRecord:
    """A method's run on a group, and what labelled target frames make of it; see `RunRecord`."""

    job: TrainingJob
    profile: str
    configuration: str
    settings: dict[str, Any]
    problem: str | None = None
    points: tuple[LabelPoint, ...] = ()

    @property
    def mean_mae_n(self) -> float:
        """Error without labels, N; NaN if training stopped."""
        return self.points[0].mean_mae_n if self.points else math.nan


def measure(bench: Bench) -> None:
    """Do the missing runs on the nine groups, then those on the gap curves, by default of one seed."""
    bench.generate_set("paired")
    run_missing(bench, label_jobs(GROUPS, bench.seeds or (0,), BY_POINT), RECORD, label_job, LabelRecord)
    own, found = bench.within("gaps", PROFILE), design()
    targets = list(dict.fromkeys(gap.domain for gap in found.gaps if gap.panel in PANELS))
    if not own.is_over():
        own.generate([recipe for recipe in found.recipes if recipe.name in targets])
        jobs = label_jobs([(BASE, target) for target in targets], bench.seeds or (0,), AT_RANDOM)
        run_missing(own, jobs, RECORD, label_job, LabelRecord)


def label_jobs(
    groups: Iterable[tuple[str, str]], seeds: Iterable[int], changes: Changes
) -> list[TrainingJob]:
    """Return the runs that labels are added to."""
    return [
        TrainingJob(source, target, method, seed, changes=changes)
        for seed in seeds
        for source, target in groups
        for method in METHODS
    ]


def label_job(bench: Bench, job: TrainingJob) -> LabelRecord:
    """Adapt once, then use labelled frames of the target's training part in every way."""
    trained = train_job(bench, job)
    points = () if trained.model is None else tuple(label_points(trained.model, trained.frames, job.seed))
    settings = job.method_settings(bench.profile)
    return LabelRecord(job, bench.profile, configuration_of(bench, job), settings, trained.problem, points)


def label_points(model: "ForceModel", frames: "SplitFrames", seed: int) -> Iterable[LabelPoint]:
    """Yield the errors on the target's test frames without labels, and with as many as its training part has.

    Frames beyond the declared range, which nothing is trained on, are not among those drawn.
    """
    from gelgap.adapt import affine_correction, draw_labelled, fine_tune
    from gelgap.domains import within_range

    yield _point("none", 0, [model], frames)
    candidates = within_range(frames.target_train)
    for labels in LABELS:
        if labels > len(candidates):
            continue
        drawn = [draw_labelled(candidates, labels, DRAWS * seed + draw) for draw in range(DRAWS)]
        tuned = [fine_tune(model, own) for own in drawn]
        yield _point("affine", labels, [affine_correction(model, own) for own in drawn], frames)
        yield _point("fine-tuning", labels, tuned, frames)
        both = [affine_correction(one, own) for one, own in zip(tuned, drawn, strict=True)]
        yield _point("both", labels, both, frames)


def _point(way: str, labels: int, models: "Sequence[ForceModel]", frames: "SplitFrames") -> LabelPoint:
    from gelgap.adapt import evaluate

    found = [evaluate(model, frames.target_test) for model in models]
    mae_n, r2 = (np.mean([getattr(one, name) for one in found], axis=0) for name in ("mae_n", "r2"))
    x, y, z = mae_n.tolist()
    return LabelPoint(way, labels, (x, y, z), tuple(r2.tolist()))


def tables(folder: Path) -> list[ResultTable]:
    """Return the tables of the nine groups and of the gap curves, as far as they were run."""
    nine, gaps = _load(folder)
    found = [nine_table(nine)] if nine else []
    return [*found, gap_table(gaps)] if gaps else found


def figures(folder: Path) -> list[NamedFigure]:
    """Return the curves of error against labels."""
    nine, gaps = _load(folder)
    caption = "Target MAE against the number of labelled target frames"
    return [NamedFigure("few-labels", caption, plot_labels(nine, gaps))] if nine or gaps else []


def _load(folder: Path) -> tuple[list[LabelRecord], list[LabelRecord]]:
    own, gaps = folder / RECORD, folder / "gaps" / "runs" / RECORD
    nine, of_gaps = (read_records(path, LabelRecord) for path in (own, gaps))
    return [r for r in nine if r.points], [r for r in of_gaps if r.points]


def curve(records: Sequence[LabelRecord], method: str, way: str) -> list[float]:
    """Return the mean error without labels and with each of `LABELS`, N; NaN where no record has that many labels."""
    own = [record for record in records if record.job.method == method]
    wanted = [("none", 0), *((way, labels) for labels in LABELS)]
    errors = [
        [point.mean_mae_n for record in own for point in record.points if (point.way, point.labels) == place]
        for place in wanted
    ]
    return [float(np.mean(values)) if values else math.nan for values in errors]


def nine_table(records: Sequence[LabelRecord]) -> ResultTable:
    """Error by number of labels, mean over the groups."""
    rows = [(method, way) for method in METHODS for way in WAYS]
    curves = np.array([curve(records, *row) for row in rows])
    columns = {"with the labels": [way for _, way in rows]}
    columns |= {f"{n} labels": numbers(curves[:, i]) for i, n in enumerate((0, *LABELS))}
    groups, seeds = {r.job.group for r in records}, {r.job.seed for r in records}
    return by_column(
        "A few labelled target frames, nine groups: mean MAE, N",
        "adapted by",
        [method for method, _ in rows],
        columns,
        f"Mean over {len(groups)} groups, {len(seeds)} seed(s) and {DRAWS} draws of the frames; paired contacts, split "
        "by contact point. Both: fine-tuned, then corrected.",
    )


def gap_table(records: Sequence[LabelRecord]) -> ResultTable:
    """How many labels close a gap of modulus or friction."""
    sizes = {gap.domain: f"{gap.panel} × {gap.size:g}" for gap in design().gaps if gap.panel in PANELS} | {
        BASE: "none"
    }
    rows = [
        (target, method, way)
        for target in dict.fromkeys(sorted((r.job.target for r in records), key=list(sizes).index))
        for method in METHODS
        for way in WAYS
    ]
    of_target = {target: [r for r in records if r.job.target == target] for target, _, _ in rows}
    curves = [curve(of_target[target], method, way) for target, method, way in rows]
    base = [curve(of_target.get(BASE, []), method, way)[0] for _, method, way in rows]
    columns = {
        "adapted by": [method for _, method, _ in rows],
        "with the labels": [way for _, _, way in rows],
        **{f"{n} labels": numbers([own[i] for own in curves]) for i, n in enumerate((0, *LABELS))},
        "closed with": [_closed_with(own, least) for own, least in zip(curves, base, strict=True)],
    }
    return by_column(
        f"Labels that close a gap which pictures do not show, from {BASE}, profile {PROFILE}: mean MAE, N",
        "gap",
        [sizes[target] for target, _, _ in rows],
        columns,
        f"Closed: at most {CLOSED:g} of the same method's error without labels and without a gap. A dash: not with as "
        f"many labels as the target has to train on. Split at random; mean over {DRAWS} draws of the frames.",
    )


def _closed_with(errors_n: Sequence[float], least_n: float) -> str:
    enough = [n for n, error in zip((0, *LABELS), errors_n, strict=True) if error <= CLOSED * least_n]
    return number(enough[0], ".0f") if enough else "–"


def plot_labels(nine: Sequence[LabelRecord], gaps: Sequence[LabelRecord]) -> "Figure":
    """Draw error against labels: the nine groups' mean by method and way, and single gaps by one way, as far as run."""
    from matplotlib.figure import Figure

    drawn = [(draw, records) for draw, records in ((_draw_nine, nine), (_draw_gaps, gaps)) if records]
    figure = Figure(figsize=(5.5 * len(drawn), 3.8), layout="constrained")
    panels = figure.subplots(1, len(drawn), sharey=True, squeeze=False)[0]
    for axes, (draw, records) in zip(panels, drawn, strict=True):
        draw(axes, records)
        axes.set_xticks(range(len(LABELS) + 1), [str(n) for n in (0, *LABELS)])
        axes.set_xlabel("labelled target frames")
        axes.legend(fontsize=7)
    panels[0].set(ylabel="target MAE, N", ylim=(0, None))
    return figure


def _draw_nine(axes: "PlotAxes", records: Sequence[LabelRecord]) -> None:
    for method, style in zip(METHODS, ("o--", "o-"), strict=True):
        for colour, way in enumerate(WAYS):
            axes.plot(curve(records, method, way), style, color=f"C{colour}", label=f"{method}, {way}")
    axes.set_title("nine groups, cpu profile")


def _draw_gaps(axes: "PlotAxes", records: Sequence[LabelRecord]) -> None:
    sizes = {gap.domain: f"{gap.panel} × {gap.size:g}" for gap in design().gaps if gap.panel in PANELS}
    for target in dict.fromkeys(record.job.target for record in records):
        own = [record for record in records if record.job.target == target]
        name = "no gap" if target == BASE else sizes[target]
        axes.plot(curve(own, "source-only", "both"), "o-", label=name)
    axes.set_title("one gap, source-only, fine-tuned and corrected")


PART = Part(measure, tables, figures)
run = PART.run
