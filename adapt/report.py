"""The report of a folder of adaptation runs: tables of their errors, scatter plots and t-SNE."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gelgap.adapt.evaluation import Evaluation
from gelgap.adapt.figures import feature_tsne, force_scatter
from gelgap.adapt.result_pages import NamedFigure, write_pages
from gelgap.adapt.result_table import ResultTable
from gelgap.adapt.run_record import Run, load_predictions, load_runs
from gelgap.domains import FORCE_COLUMNS, QUANTITIES


def write_report(runs_dir: str | Path, out_dir: str | Path | None = None) -> Path:
    """Write report.md, report.tex and report.html about all finished runs below a folder; return the HTML's path.

    Raises
    ------
    FileNotFoundError
        If there is no finished run.
    """
    runs = load_runs(runs_dir)
    out = Path(runs_dir if out_dir is None else out_dir)
    tables = []
    for labels in dict.fromkeys(run.labels for run in runs):
        own = [run for run in runs if run.labels == labels]
        tables += [error_table(own), axis_table(own), training_table(own)]
    return write_pages(out, "report", "Adaptation runs", tables, _figures(runs))


def error_table(runs: Sequence[Run]) -> ResultTable:
    """Return the target's mean MAE, mean ± deviation over seeds: a row per group, a column per method, their means.

    The runs have the same labels; where these have several units, it is in % of their ranges.
    """
    unit = runs[0].target_test.unit
    methods = list(dict.fromkeys(run.method for run in runs))
    groups = list(dict.fromkeys(run.group for run in runs))
    errors: dict[tuple[str, str], list[float]] = {}
    for run in runs:
        error = run.target_test
        value = error.mean_mae_percent if unit is None else error.mean_mae
        errors.setdefault((run.group, run.method), []).append(value)
    rows = [[group, *(_mean_and_spread(errors.get((group, m), [])) for m in methods)] for group in groups]
    means = []
    for method in methods:
        found = [np.mean(errors[group, method]) for group in groups if (group, method) in errors]
        means.append(f"{np.mean(found):.3f}" if len(found) == len(groups) else None)
    title = f"Mean error on the target's test frames{_of_labels(runs)}, {unit or '% of the range'}"
    return ResultTable(title, ["group", *methods], [*rows, ["mean", *means]])


def axis_table(runs: Sequence[Run]) -> ResultTable:
    """Return every run's MAE and R² of each label on the target; the runs have the same labels."""
    labels, first = runs[0].labels, runs[0].target_test
    axes = [str(QUANTITIES[name]) for name in labels]
    axes += [f"R² {QUANTITIES[name].symbol.removeprefix('F')}" for name in labels]
    rows = []
    for run in runs:
        error = run.target_test
        shares = zip(error.mae, error.mae_percent, strict=True)
        rows.append(
            [
                *(run.group, run.method, run.seed),
                *(f"{mae:.3f} ({percent:.1f} %)" for mae, percent in shares),
                *(f"{value:.2f}" for value in error.r2),
                _mean_mae(run.target_constant_mean),
            ]
        )
    what = "Error per axis on the target" if labels == FORCE_COLUMNS else "Error per label on the target"
    return ResultTable(what, ["group", "method", "seed", *axes, f"constant mean, {_unit(first)}"], rows)


def training_table(runs: Sequence[Run]) -> ResultTable:
    """Return every run's error on its source, the steps it skipped and the time it took."""
    rows = [
        [
            *(run.group, run.method, run.seed, run.profile["name"]),
            *(_mean_mae(run.source_held_out), _mean_mae(run.source_constant_mean)),
            run.skipped_steps,
            *(f"{run.wall_s[stage]:.1f}" for stage in ("stage1", "stage2")),
        ]
        for run in runs
    ]
    unit = _unit(runs[0].target_test)
    source = ["profile", f"source held out, {unit}", f"its constant mean, {unit}"]
    stages = ["skipped steps", "stage 1, s", "stage 2, s"]
    return ResultTable(f"Training{_of_labels(runs)}", ["group", "method", "seed", *source, *stages], rows)


def _mean_and_spread(errors: Sequence[float]) -> str | None:
    if not errors:
        return None
    spread = f" ± {np.std(errors, ddof=1):.3f}" if len(errors) > 1 else ""
    return f"{np.mean(errors):.3f}{spread}"


def _mean_mae(evaluation: Evaluation | None) -> str | None:
    if evaluation is None:
        return None
    return f"{evaluation.mean_mae_percent if evaluation.unit is None else evaluation.mean_mae:.3f}"


def _unit(evaluation: Evaluation) -> str:
    return evaluation.unit or "%"


def _of_labels(runs: Sequence[Run]) -> str:
    """Return what a title says of labels that are not the force's three axes."""
    labels = runs[0].labels
    return "" if labels == FORCE_COLUMNS else f" ({', '.join(QUANTITIES[name].symbol for name in labels)})"


def _figures(runs: Sequence[Run]) -> list[NamedFigure]:
    """Return, for each group's first seed, the scatter and the t-SNE of its methods; labels by labels."""
    figures = []
    for group, labels in dict.fromkeys((run.group, run.labels) for run in runs):
        of_group = [run for run in runs if (run.group, run.labels) == (group, labels)]
        seed = min(run.seed for run in of_group)
        arrays = {run.method: load_predictions(run) for run in of_group if run.seed == seed}
        truth = next(iter(arrays.values()))["target_true_n"]
        predicted = {method: a["target_predicted_n"] for method, a in arrays.items()}
        scatter = force_scatter(truth, predicted, labels=labels)
        plane = feature_tsne({m: (a["source_features"], a["target_features"]) for m, a in arrays.items()})
        name, caption = group.replace(" → ", "-"), f"{group}, seed {seed}{_of_labels(of_group)}"
        what = "force" if set(labels) <= set(FORCE_COLUMNS) else "labels"
        name += "" if labels == FORCE_COLUMNS else f"-{'-'.join(labels)}"
        figures += [
            NamedFigure(
                f"scatter-{name}",
                f"{caption}: predicted against true {what}",
                scatter,
            ),
            NamedFigure(f"tsne-{name}", f"{caption}: features of both domains", plane),
        ]
    return figures
