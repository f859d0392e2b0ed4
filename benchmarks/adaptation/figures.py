"""The adaptation benchmark's figures of the groups: errors, ranks, times, and predictions of example groups."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gelgap.adapt import NamedFigure
from gelgap.benchmarks.adaptation.compared import MAIN_METHODS
from gelgap.benchmarks.adaptation.results import CEILING, GroupOracles, Results, mean_of, over_groups
from gelgap.benchmarks.adaptation.statistics import plot_critical_difference

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN_GROUPS = (("wmb1i1", "mb0i0"),)
"""The groups whose scatter plots and t-SNE are drawn, as in the paper's figures 4 and 5."""
SHOWN_METHODS = ("source-only", "dann", "daregram", "dsan")


def group_figures(results: Results, oracles: dict[tuple[str, str], GroupOracles]) -> list[NamedFigure]:
    """Return errors by group, mean ranks (of two methods or more) and errors against time."""
    figures = [NamedFigure("groups", "Target MAE by group and method", plot_groups(results, oracles))]
    ranked = [i for i, method in enumerate(results.methods) if method != CEILING]
    if len(ranked) > 1:
        methods = [results.methods[i] for i in ranked]
        diagram = plot_critical_difference(
            methods, results.group_errors_n[ranked], "Mean ranks over the groups"
        )
        figures.append(NamedFigure("critical-difference", "Mean ranks and critical difference", diagram))
    return [*figures, NamedFigure("time", "Target MAE against training time", plot_time(results))]


def prediction_figures(folder: Path) -> list[NamedFigure]:
    """Return scatter plots and t-SNE of the paper's example groups, if their runs were kept."""
    from gelgap.adapt import feature_tsne, force_scatter, load_predictions, load_run

    figures = []
    for group in SHOWN_GROUPS:
        runs = [load_run(path.parent) for path in folder.glob(f"{'-'.join(group)}-*/run.json")]
        found = {run.method: run for run in runs}
        arrays = {method: load_predictions(found[method]) for method in SHOWN_METHODS if method in found}
        if not arrays:
            continue
        truth = next(iter(arrays.values()))["target_true_n"]
        scatter = force_scatter(truth, {method: a["target_predicted_n"] for method, a in arrays.items()})
        plane = feature_tsne({m: (a["source_features"], a["target_features"]) for m, a in arrays.items()})
        name, pair = "-".join(group), " → ".join(group)
        figures.append(NamedFigure(f"scatter-{name}", f"{pair}: predicted against true force", scatter))
        figures.append(NamedFigure(f"tsne-{name}", f"{pair}: features of both domains", plane))
    return figures


def plot_groups(results: Results, oracles: dict[tuple[str, str], GroupOracles]) -> "Figure":
    """Draw the main methods' errors in each group as bars beside the constant mean and the pose oracle."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.8), layout="constrained")
    axes = figure.subplots()
    shown = [method for method in results.methods if method in MAIN_METHODS]
    place, width = np.arange(len(results.groups)), 0.8 / max(len(shown), 1)
    for i, method in enumerate(shown):
        errors = results.of(method)
        deviations = [np.std(e[~np.isnan(e)], ddof=1) if (~np.isnan(e)).sum() > 1 else 0.0 for e in errors]
        left = place - 0.4 + (i + 0.5) * width
        axes.bar(left, mean_of(errors, axis=1), width, yerr=deviations, label=method)
    axes.hlines(results.constant_mean_n, place - 0.4, place + 0.4, "k", "dotted", label="constant mean")
    pose = [np.mean(oracles[group].pose_n) for group in results.groups]
    axes.hlines(pose, place - 0.4, place + 0.4, "k", label="pose oracle")
    axes.set_xticks(place, ["\n→ ".join(group) for group in results.groups], fontsize=8)
    axes.set_ylabel("target MAE, N")
    figure.legend(loc="outside upper center", fontsize=8, ncols=(len(shown) + 3) // 2)
    return figure


def plot_time(results: Results) -> "Figure":
    """Draw each method's error against the training time of both stages."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5, 3.5), layout="constrained")
    axes = figure.subplots()
    stage2 = mean_of(results.values("stage2_s"), axis=(1, 2))
    for i, method in enumerate(results.methods):
        error = float(over_groups(results.errors_n[i]))
        axes.plot(np.nan_to_num(results.stage1_s) + stage2[i], error, "o", alpha=0.7, label=method)
    axes.set(xlabel="both stages, s of one core", ylabel="target MAE, N")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=8)
    return figure
