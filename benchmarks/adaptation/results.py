"""The adaptation benchmark's report: every table and figure that is there, as Markdown, LaTeX and one HTML page."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gelgap.adapt import NamedFigure, ResultTable, write_pages
from gelgap.benchmarks.adaptation.jobs import Line, read_lines
from gelgap.benchmarks.adaptation.statistics import critical_difference, plot_critical_difference, ranks
from gelgap.benchmarks.adaptation.tables import (
    GROUPS,
    TABLE_METHODS,
    GroupOracles,
    Results,
    further_table,
    mean_of,
    over_groups,
    result_tables,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RUNS = "runs.jsonl"
ORACLES = "oracles.json"
SHOWN_GROUPS = (("wmb1i1", "mb0i0"),)
"""The groups whose scatter plots and t-SNE are drawn, as in the paper's figures 4 and 5."""
SHOWN_METHODS = ("source-only", "dann", "daregram", "dsan")


def is_benchmark(folder: Path) -> bool:
    """Return whether a folder holds the records of the benchmark."""
    return (folder / RUNS).is_file() and (folder / ORACLES).is_file()


def write_oracles(folder: Path, oracles: dict[tuple[str, str], GroupOracles]) -> None:
    """Keep the groups' oracles beside the runs, so that a report needs no data."""
    from gelgap.benchmarks.common.tables import write_json

    write_json(folder / ORACLES, {" → ".join(group): found for group, found in oracles.items()})


def load_results(folder: Path) -> Results:
    """Read the finished runs of the paper's methods; groups and methods without any run are left out.

    Raises
    ------
    FileNotFoundError
        If there are no records.
    """
    return _results(folder, [line for line in _lines(folder) if line.job.method in TABLE_METHODS])


def load_further(folder: Path) -> Results:
    """Read the finished runs of all methods, of the groups and seeds that methods beside the paper's were run on."""
    lines = _lines(folder)
    further = [line.job for line in lines if line.job.method not in TABLE_METHODS]
    places = {(job.source, job.target, job.seed) for job in further}
    return _results(
        folder, [line for line in lines if (line.job.source, line.job.target, line.job.seed) in places]
    )


def _lines(folder: Path) -> list[Line]:
    if not is_benchmark(folder):
        raise FileNotFoundError(
            f"{folder} holds no records of the adaptation benchmark ({RUNS} and {ORACLES}); "
            "`gelgap benchmark adaptation` writes them"
        )
    return [line for line in read_lines(folder / RUNS) if not line.job.changes]


def _results(folder: Path, lines: Sequence[Line]) -> Results:
    content = json.loads((folder / ORACLES).read_text(encoding="utf-8"))
    oracles = {tuple(name.split(" → ")): _oracles(found) for name, found in content.items()}
    groups = [g for g in oracles if any((line.job.source, line.job.target) == g for line in lines)]
    groups.sort(key=lambda group: GROUPS.index(group) if group in GROUPS else len(GROUPS))
    known = [m for m in TABLE_METHODS if any(line.job.method == m for line in lines)]
    methods = [*known, *dict.fromkeys(ln.job.method for ln in lines if ln.job.method not in known)]
    seeds = sorted({line.job.seed for line in lines})
    return Results(lines, groups, methods, seeds, {group: oracles[group] for group in groups})


def _oracles(content: dict) -> GroupOracles:
    return GroupOracles(tuple(content["pose_n"]), tuple(content["geometry_n"]))


def benchmark_tables(folder: Path) -> list[ResultTable]:
    """Return the tables of all parts of the benchmark that were run."""
    from gelgap.benchmarks.adaptation import (
        ablation,
        cost,
        gaps,
        search,
        speed,
    )

    tables = result_tables(load_results(folder))
    if (further := load_further(folder)).lines:
        tables.append(further_table(further))
    if search_lines := read_lines(folder / search.RECORD, search.SearchLine):
        tables += search.search_tables(search_lines)
    if ablation_lines := read_lines(folder / ablation.RECORD):
        tables.append(ablation.ablation_table(ablation_lines, ablation.GROUPS))
    gaps_file = folder / "gaps" / gaps.RESULTS
    if gaps_file.is_file():
        found = gaps.GapResults.load(gaps_file)
        tables += [gaps.gap_table(found), *gaps.crossed_tables(found)]
    cost_file = folder / "cost" / cost.RESULTS
    if cost_file.is_file():
        tables.append(cost.cost_table(cost.load_costs(cost_file)))
    speed_file = folder / speed.RESULTS
    if speed_file.is_file():
        tables.append(speed.speed_table(speed.load_speeds(speed_file)))
    return tables


def benchmark_figures(folder: Path) -> list[NamedFigure]:
    """Return the figures of all parts of the benchmark that were run."""
    from gelgap.benchmarks.adaptation import gaps

    results = load_results(folder)
    own = [i for i, method in enumerate(results.methods) if method != "supervised"]
    by_group = mean_of(results.balanced_n[own], axis=2)
    mean_ranks = dict(zip([results.methods[i] for i in own], ranks(by_group).mean(axis=1), strict=True))
    figures = [NamedFigure("groups", "Target MAE by group and method", plot_groups(results))]
    if len(own) > 1:
        difference = critical_difference(len(own), len(results.groups))
        figure = plot_critical_difference(mean_ranks, difference, "Mean ranks over the groups")
        figures.append(NamedFigure("critical-difference", "Mean ranks and critical difference", figure))
    figures.append(NamedFigure("time", "Target MAE against training time", plot_time(results)))
    gaps_file = folder / "gaps" / gaps.RESULTS
    if gaps_file.is_file():
        figure = gaps.plot_gaps(gaps.GapResults.load(gaps_file))
        figures.append(NamedFigure("gap-curves", "Target MAE against the size of each gap", figure))
    return figures + prediction_figures(folder)


def prediction_figures(folder: Path) -> list[NamedFigure]:
    """Return scatter plots and t-SNE of the paper's example groups, first seed; none if their runs are gone."""
    from gelgap.adapt import feature_tsne, force_scatter, load_predictions, load_run

    figures = []
    for source, target in SHOWN_GROUPS:
        found = {method: _first_run(folder, source, target, method) for method in SHOWN_METHODS}
        arrays = {method: load_predictions(load_run(path)) for method, path in found.items() if path}
        if not arrays:
            continue
        truth = next(iter(arrays.values()))["target_true_n"]
        shown = {method: a["target_predicted_n"] for method, a in arrays.items()}
        features = {m: (a["source_features"], a["target_features"]) for m, a in arrays.items()}
        pair, group = f"{source} → {target}", f"{source}-{target}"
        scatter, plane = force_scatter(truth, shown), feature_tsne(features)
        figures.append(NamedFigure(f"scatter-{group}", f"{pair}: predicted against true force", scatter))
        figures.append(NamedFigure(f"tsne-{group}", f"{pair}: features of both domains", plane))
    return figures


def _first_run(folder: Path, source: str, target: str, method: str) -> Path | None:
    """Return the folder of the table's run with the least seed; None if none is kept."""
    from gelgap.adapt.runs import run_folder

    lines = [
        line
        for line in sorted(_lines(folder), key=lambda line: line.job.seed)
        if (line.job.source, line.job.target, line.job.method) == (source, target, method)
    ]
    paths = (run_folder(folder, source, target, method, line.job.seed, line.key) for line in lines)
    return next((path for path in paths if path.is_dir()), None)


def plot_groups(results: Results) -> "Figure":
    """Draw each group's errors as bars beside the constant mean and the pose oracle."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.8), layout="constrained")
    axes = figure.subplots()
    place, width = np.arange(len(results.groups)), 0.8 / len(results.methods)
    for i, method in enumerate(results.methods):
        errors = results.errors_n[i]
        spread = [np.std(e[~np.isnan(e)], ddof=1) if (~np.isnan(e)).sum() > 1 else 0.0 for e in errors]
        axes.bar(place - 0.4 + (i + 0.5) * width, mean_of(errors, axis=1), width, yerr=spread, label=method)
    axes.hlines(results.constant_mean_n, place - 0.4, place + 0.4, "k", "dotted", label="constant mean")
    pose = [np.mean(results.oracles[group].pose_n) for group in results.groups]
    axes.hlines(pose, place - 0.4, place + 0.4, "k", label="pose oracle")
    axes.set_xticks(place, ["\n→ ".join(group) for group in results.groups], fontsize=8)
    axes.set_ylabel("target MAE, N")
    figure.legend(loc="outside upper center", fontsize=8, ncols=len(results.methods) + 2)
    return figure


def plot_time(results: Results) -> "Figure":
    """Draw each method's error against the training time of its second stage."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5, 3.5), layout="constrained")
    axes = figure.subplots()
    stage1 = float(np.median([line.stage1_s for line in results.lines if line.stage1_s > 0] or [0.0]))
    stage2 = mean_of(results.values(lambda line: line.stage2_s), axis=(1, 2))
    for i, method in enumerate(results.methods):
        error = float(over_groups(results.balanced_n[i]))
        axes.plot(stage1 + float(stage2[i]), error, "o", alpha=0.7, label=method)
    axes.set(xlabel="both stages, s of one core", ylabel="target MAE, N")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=8)
    return figure


def write_benchmark_report(folder: Path, out_dir: Path | None = None, name: str = "adaptation") -> Path:
    """Write `<name>.md`, `.tex`, `.html` and the figures as PNG; return the HTML's path.

    Raises
    ------
    FileNotFoundError
        If the folder holds no records of the benchmark.
    """
    tables, figures = benchmark_tables(folder), benchmark_figures(folder)
    title = f"Adaptation benchmark, profile {folder.name}"
    return write_pages(folder if out_dir is None else out_dir, name, title, tables, figures)
