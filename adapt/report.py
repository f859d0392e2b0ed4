"""The report of a folder of adaptation runs: tables of their errors, predicted against true force, and t-SNE."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from gelgap.adapt.evaluation import CONSTANT, Evaluation, r2_text, shared_unit, worse_than_constant
from gelgap.adapt.methods.registry import find_method
from gelgap.adapt.result_table import NamedFigure, ResultTable, write_page
from gelgap.adapt.run_record import Run, load_predictions, load_runs
from gelgap.adapt.selection import Candidate, alarm, scores, select
from gelgap.data.frames.labels import FORCE_COLUMNS, QUANTITIES

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_report(runs_dir: str | Path, out_dir: str | Path | None = None) -> Path:
    """Write report.html about all finished runs below a folder; return its path.

    Raises
    ------
    FileNotFoundError
        If there is no finished run.
    """
    runs = load_runs(runs_dir)
    tables, figures = [], []
    for labels in dict.fromkeys(run.labels for run in runs):
        same_labels = [run for run in runs if run.labels == labels]
        if judged := [run for run in same_labels if run.target_test is not None]:
            tables += [error_table(judged), axis_table(judged)]
        if unlabelled := [run for run in same_labels if run.target_test is None]:
            tables += label_free_tables(unlabelled)
        tables.append(training_table(same_labels))
    tables += unseen_tables(runs)
    for group, labels in dict.fromkeys((run.group, run.labels) for run in runs):
        figures += _figures([run for run in runs if (run.group, run.labels) == (group, labels)])
    out = Path(runs_dir if out_dir is None else out_dir)
    return write_page(out / "report.html", "Adaptation runs", tables, figures)


def error_table(runs: Sequence[Run]) -> ResultTable:
    """Return the target's mean MAE, mean ± deviation over seeds: a row per group, a column per rule and method.

    The best method comes first, then rules without a network and oracles by their errors. The runs have the same
    labels; where these have several units, it is in % of their ranges.
    """
    titles = method_titles(runs)
    rows = [_name(run, titles) | {"error": _mean_mae(_errors(run)[0])} for run in runs]
    known = {row["method"] for row in rows}
    one_each = {(run.group, run.seed, _mean_mae(_errors(run)[1])): run for run in runs}
    for run in one_each.values():
        rules = {CONSTANT: _errors(run)[1]} | run.baselines | run.oracles
        rows += [
            _name(run, titles) | {"method": name, "error": _mean_mae(error)}
            for name, error in rules.items()
            if name not in known
        ]
    errors = pd.DataFrame(rows).groupby(["group", "method"], sort=False)["error"]
    table = errors.agg(mean_and_deviation).unstack(sort=False)
    # A method that lacks a group has no mean.
    means = errors.mean().unstack(sort=False).mean(skipna=False)
    table.loc["mean"] = means.map("{:.3f}".format, na_action="ignore")
    order = list(means.sort_values().index)
    table = table[[name for name in order if name in known] + [name for name in order if name not in known]]
    unit = shared_unit(runs[0].labels) or "% of the range"
    failed = [f"{run.method} on {run.group}, seed {run.seed}: {run.problem}" for run in runs if run.problem]
    note = "Sorted by error; another seed or processor may well change the order of near ones. "
    if mixed := int(pd.DataFrame(rows).duplicated(["group", "method", "seed"]).sum()):
        note += f"± is not over seeds alone: {mixed} errors differ from others in settings, data or weights. "
    note += f"Failed, and counted with the source's mean force: {'; '.join(failed)}." if failed else ""
    return ResultTable.of(
        f"Mean error on the target's test frames{_of_labels(runs)}, {unit}", table, note.strip()
    )


def axis_table(runs: Sequence[Run]) -> ResultTable:
    """Return every run's MAE and R² of each label on the target; the runs have the same labels."""
    labels = runs[0].labels
    unit = _unit(runs)
    titles = method_titles(runs)
    known = [QUANTITIES[name] for name in labels]
    rows = []
    notes = []
    for run in runs:
        error, of_constant = _errors(run)
        row = _name(run, titles)
        for what, mae, percent in zip(known, error.mae, error.mae_percent, strict=True):
            row[str(what)] = f"{mae:.3f} ({percent:.1f} %)"
        for what, r2 in zip(known, error.r2, strict=True):
            row[f"R² {what.symbol.removeprefix('F')}"] = r2_text(r2)
        rows.append(row | {f"constant mean, {unit}": f"{_mean_mae(of_constant):.3f}"})
        if warning := worse_than_constant(error):
            notes.append(f"{titles[run.key]} on {run.group}: {warning}")
    kind = "axis" if labels == FORCE_COLUMNS else "label"
    return ResultTable.of(f"Error per {kind} on the target", pd.DataFrame(rows), "; ".join(notes))


def _errors(run: Run) -> tuple[Evaluation, Evaluation]:
    """Return the errors of a run's model and of the constant mean, or raise ValueError if its target has no labels."""
    if run.target_test is None or run.target_constant_mean is None:
        raise ValueError(f"{run.group}, {run.method}: the target has no labels, so that no errors are known")
    return run.target_test, run.target_constant_mean


def label_free_tables(runs: Sequence[Run]) -> list[ResultTable]:
    """Return what is known of runs whose targets have no labels; the runs have the same labels.

    One table has the selectors' scores of each stage 1 (*before*) and of each adapted model, the other the 5, 50 and
    95 % quantiles of what a model predicts.
    """
    notes = ["Errors are not known. Less is better"]
    scored: dict[Any, dict[str, Any]] = {}
    predicted = []
    titles = method_titles(runs)
    for run in runs:
        row = _name(run, titles)
        called = f"{titles[run.key]} on {run.group}"
        known = run.label_free
        if known is None:
            notes.append(f"{called} failed: {run.problem}")
            continue
        if known.alarm:
            notes.append(f"{called} may predict a constant: its output hardly varies")
        before = row | {"method": "before" + titles[run.key].removeprefix(run.method)}
        if known.scores_before:
            scored.setdefault(tuple(before.values()), before | known.scores_before)
        scored[tuple(row.values())] = row | known.scores
        for name, at in known.quantiles.items():
            row = row | {str(QUANTITIES[name]): ", ".join(f"{value:.2f}" for value in at)}
        predicted.append(row)
    of_labels = _of_labels(runs)
    formats = {"": "{:.3f}", "seed": "{}"}
    return [
        ResultTable.of(
            f"A target without labels{of_labels}",
            pd.DataFrame(scored.values()),
            f"{'; '.join(notes)}.",
            formats,
        ),
        ResultTable.of(f"Predictions at 5, 50 and 95 % of the frames{of_labels}", pd.DataFrame(predicted)),
    ]


def selection_table(runs: Sequence[Run], selector: str) -> pd.DataFrame:
    """Return every selector's score of runs, a row for each, and which one a selector chooses for each group.

    Runs that failed have no score, and they and methods that learn from target labels are not chosen.

    Raises
    ------
    ValueError
        If there is no such selector, or the runs of a group all failed or learn from target labels.
    """
    rows: list[dict[str, Any]] = []
    candidates: dict[str, dict[int, Candidate]] = {}
    for run in runs:
        row = _name(run, {}) | {"profile": run.profile["name"], "folder": run.folder and run.folder.name}
        if run.problem is None:
            candidate = Candidate.of(load_predictions(run))
            row |= {"alarm": alarm(candidate)} | scores(candidate)
            if not find_method(run.method).uses_target_labels:
                candidates.setdefault(run.group, {})[len(rows)] = candidate
        rows.append(row | {"chosen": False})
    for of_group in candidates.values():
        rows[list(of_group)[select(list(of_group.values()), selector)]]["chosen"] = True
    return pd.DataFrame(rows)


def unseen_tables(runs: Sequence[Run]) -> list[ResultTable]:
    """Return what of each group's gap no picture shows, so that no adaptation without labels can learn it."""
    rows = list(dict.fromkeys((run.group, note) for run in runs for note in run.unseen))
    if not rows:
        return []
    frame = pd.DataFrame(rows, columns=["group", "what"])
    note = "Only labels of the target teach it: see `gelgap finetune`."
    return [ResultTable.of("What no picture shows", frame, note)]


def training_table(runs: Sequence[Run]) -> ResultTable:
    """Return every run's error on its source, the steps it skipped and the time it took."""
    unit = _unit(runs)
    rows = []
    for run in runs:
        errors = [e and f"{_mean_mae(e):.3f}" for e in (run.source_held_out, run.source_constant_mean)]
        row = _name(run, {}) | {"profile": run.profile["name"]}
        row |= {f"source held out, {unit}": errors[0], f"its constant mean, {unit}": errors[1]}
        row |= {"skipped steps": run.skipped_steps}
        row |= {f"stage {k}, core s": run.core_s.get(f"stage{k}") for k in (1, 2)}
        rows.append(row)
    formats = {"stage 1, core s": "{:.1f}", "stage 2, core s": "{:.1f}"}
    return ResultTable.of(f"Training{_of_labels(runs)}", pd.DataFrame(rows), formats=formats)


def method_titles(runs: Sequence[Run]) -> dict[str, str]:
    """Return what tables call runs, by their keys: the method, and where profiles differ which one, or how."""
    profiles = pd.DataFrame([run.profile for run in runs]).astype(str)
    differ = list(profiles.columns[profiles.nunique() > 1])
    if "name" in differ:
        return {run.key: f"{run.method}, {run.profile['name']}" for run in runs}
    told = [[f"{name}={run.profile[name]}" for name in differ if name in run.profile] for run in runs]
    return {run.key: ", ".join([run.method, *changes]) for run, changes in zip(runs, told, strict=True)}


def _name(run: Run, titles: Mapping[str, str]) -> dict[str, Any]:
    return {"group": run.group, "method": titles.get(run.key, run.method), "seed": run.seed}


def mean_and_deviation(errors: pd.Series) -> str | None:
    """Return mean ± standard deviation over seeds, and how many are NaN (not run), if any are; None if all are."""
    there = errors.dropna()
    missing = f" ({len(errors) - len(there)} missing)" if len(there) < len(errors) else ""
    deviation = f" ± {there.std():.3f}" if len(there) > 1 else ""
    return f"{there.mean():.3f}{deviation}{missing}" if len(there) else None


def _mean_mae(error: Evaluation) -> float:
    """Return the mean MAE of an evaluation; where its labels have several units, % of their ranges."""
    return error.mean_mae_percent if error.mean_mae is None else error.mean_mae


def _unit(runs: Sequence[Run]) -> str:
    return shared_unit(runs[0].labels) or "%"


def _of_labels(runs: Sequence[Run]) -> str:
    """Return what a title says of labels that are not the force's three axes."""
    labels = runs[0].labels
    return "" if labels == FORCE_COLUMNS else f" ({', '.join(QUANTITIES[name].symbol for name in labels)})"


def _figures(runs: Sequence[Run]) -> list[NamedFigure]:
    """Return the scatter and the t-SNE of the methods of one group with one choice of labels: its first seed's."""
    seed = min(run.seed for run in runs)
    labels = runs[0].labels
    titles = method_titles(runs)
    arrays = {titles[run.key]: load_predictions(run) for run in runs if run.seed == seed and not run.problem}
    if not arrays:
        return []
    first = next(iter(arrays.values()))
    plane = feature_tsne({m: (a["source_features"], a["target_features"]) for m, a in arrays.items()})
    caption = f"{runs[0].group}, seed {seed}{_of_labels(runs)}"
    what = "force" if set(labels) <= set(FORCE_COLUMNS) else "labels"
    if "target_true_n" in first:
        forces = {method: (a["target_true_n"], a["target_predicted_n"]) for method, a in arrays.items()}
        scatter = force_scatter(forces, labels)
        shown = NamedFigure(f"{caption}: predicted against true {what}", scatter)
    else:
        predicted = {method: a["target_predicted_n"] for method, a in arrays.items()}
        histograms = _histograms(first["source_true_n"], predicted, labels)
        shown = NamedFigure(f"{caption}: how often which {what} are predicted", histograms)
    return [shown, NamedFigure(f"{caption}: features of both domains", plane)]


def _histograms(
    source_true_n: np.ndarray, predicted_n: Mapping[str, np.ndarray], labels: tuple[str, ...]
) -> "Figure":
    """Draw which share of a target's frames has which prediction, a panel per label, beside the source's labels."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(max(9, 3 * len(labels)), 3.2), layout="constrained")
    for label, axes in enumerate(figure.subplots(1, len(labels), squeeze=False)[0]):
        shown = {"the source's labels": source_true_n, **predicted_n}
        bins = np.histogram_bin_edges(np.concatenate([values[:, label] for values in shown.values()]), 30)
        for number, (name, values) in enumerate(shown.items()):
            weights = np.full(len(values), 1 / len(values))
            colour = None if number else "0.6"
            axes.hist(values[:, label], bins, weights=weights, histtype="step", label=name, color=colour)
        axes.set(xlabel=str(QUANTITIES[labels[label]]), ylabel="share of frames")
        axes.legend(fontsize=7)
    return figure


def force_scatter(
    forces_n: Mapping[str, tuple[np.ndarray, np.ndarray]], labels: tuple[str, ...] = FORCE_COLUMNS
) -> "Figure":
    """Draw predicted against true force, one row per method, one column per axis (the paper's figure 4).

    forces_n has each method's true and predicted ones, (n, 3) in N, or (n, k) of other labels, each in its unit.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(max(9, 3 * len(labels)), 2.8 * len(forces_n)), layout="constrained")
    grid = figure.subplots(len(forces_n), len(labels), squeeze=False)
    for row, (method, (true, predicted)) in zip(grid, forces_n.items(), strict=True):
        for label, (name, axes) in enumerate(zip(labels, row, strict=True)):
            truth = true[:, label]
            guess = predicted[:, label]
            symbol, unit = QUANTITIES[name]
            what = f"force, {unit}" if name in FORCE_COLUMNS else f"{symbol}, {unit}"
            limits = (min(truth.min(), guess.min()), max(truth.max(), guess.max()))
            axes.plot(limits, limits, color="0.6", linewidth=1)
            axes.scatter(truth, guess, s=6, alpha=0.6, linewidths=0)
            axes.set_aspect("equal", adjustable="datalim")
            axes.set_title(f"{method}: {symbol}, MAE {np.abs(truth - guess).mean():.3f} {unit}", fontsize=9)
            axes.set_xlabel(f"true {what}", fontsize=8)
            axes.set_ylabel(f"predicted {what}", fontsize=8)
    return figure


def feature_tsne(features: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> "Figure":
    """Draw source and target features in one t-SNE plane per method (the paper's figure 5).

    features maps a method to source (n, D) and target (m, D) features; they need at least 3 frames together.
    """
    from matplotlib.figure import Figure
    from sklearn.manifold import TSNE

    figure = Figure(figsize=(3.6 * len(features), 3.6), layout="constrained")
    for axes, (method, (source, target)) in zip(
        figure.subplots(1, len(features), squeeze=False)[0], features.items(), strict=True
    ):
        together = np.concatenate([source, target]).astype(np.float32)
        perplexity = min(30.0, (len(together) - 1) / 3)
        plane = TSNE(perplexity=perplexity, random_state=0, init="pca").fit_transform(together)
        axes.scatter(*plane[: len(source)].T, s=6, label="source", linewidths=0)
        axes.scatter(*plane[len(source) :].T, s=6, label="target", linewidths=0)
        axes.set(title=method, xticks=[], yticks=[])
        axes.legend(fontsize=8)
    return figure
