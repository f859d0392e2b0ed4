"""The report of a folder of adaptation runs: tables of their errors, scatter plots and t-SNE."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gelgap.adapt.evaluation import Evaluation
from gelgap.adapt.figures import feature_tsne, force_scatter
from gelgap.adapt.result_pages import NamedFigure, write_pages
from gelgap.adapt.result_table import ResultTable
from gelgap.adapt.run_record import Run, load_predictions, load_runs


def write_report(runs_dir: str | Path, out_dir: str | Path | None = None) -> Path:
    """Write report.md, report.tex and report.html about all finished runs below a folder; return the HTML's path.

    Raises
    ------
    FileNotFoundError
        If there is no finished run.
    """
    runs = load_runs(runs_dir)
    out = Path(runs_dir if out_dir is None else out_dir)
    tables = [error_table(runs), axis_table(runs), training_table(runs)]
    return write_pages(out, "report", "Adaptation runs", tables, _figures(runs))


def error_table(runs: Sequence[Run]) -> ResultTable:
    """Return the target's mean MAE, mean ± deviation over seeds: a row per group, a column per method, their means."""
    methods = list(dict.fromkeys(run.method for run in runs))
    groups = list(dict.fromkeys(run.group for run in runs))
    errors_n: dict[tuple[str, str], list[float]] = {}
    for run in runs:
        errors_n.setdefault((run.group, run.method), []).append(run.target_test.mean_mae_n)
    rows = [[group, *(_mean_and_spread(errors_n.get((group, m), [])) for m in methods)] for group in groups]
    means = []
    for method in methods:
        found = [np.mean(errors_n[group, method]) for group in groups if (group, method) in errors_n]
        means.append(f"{np.mean(found):.3f}" if len(found) == len(groups) else None)
    return ResultTable(
        "Mean error on the target's test frames, N", ["group", *methods], [*rows, ["mean", *means]]
    )


def axis_table(runs: Sequence[Run]) -> ResultTable:
    """Return every run's MAE and R² per axis on the target."""
    axes = ["Fx, N", "Fy, N", "Fz, N", "R² x", "R² y", "R² z"]
    rows = []
    for run in runs:
        error = run.target_test
        shares = zip(error.mae_n, error.mae_percent, strict=True)
        rows.append(
            [
                *(run.group, run.method, run.seed),
                *(f"{mae_n:.3f} ({percent:.1f} %)" for mae_n, percent in shares),
                *(f"{value:.2f}" for value in error.r2),
                _mean_mae(run.target_constant_mean),
            ]
        )
    return ResultTable(
        "Error per axis on the target", ["group", "method", "seed", *axes, "constant mean, N"], rows
    )


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
    source = ["profile", "source held out, N", "its constant mean, N"]
    stages = ["skipped steps", "stage 1, s", "stage 2, s"]
    return ResultTable("Training", ["group", "method", "seed", *source, *stages], rows)


def _mean_and_spread(errors_n: Sequence[float]) -> str | None:
    if not errors_n:
        return None
    spread = f" ± {np.std(errors_n, ddof=1):.3f}" if len(errors_n) > 1 else ""
    return f"{np.mean(errors_n):.3f}{spread}"


def _mean_mae(evaluation: Evaluation | None) -> str | None:
    return None if evaluation is None else f"{evaluation.mean_mae_n:.3f}"


def _figures(runs: Sequence[Run]) -> list[NamedFigure]:
    """Return, for each group's first seed, the scatter and the t-SNE of its methods."""
    figures = []
    for group in dict.fromkeys(run.group for run in runs):
        of_group = [run for run in runs if run.group == group]
        seed = min(run.seed for run in of_group)
        arrays = {run.method: load_predictions(run) for run in of_group if run.seed == seed}
        truth = next(iter(arrays.values()))["target_true_n"]
        scatter = force_scatter(truth, {method: a["target_predicted_n"] for method, a in arrays.items()})
        plane = feature_tsne({m: (a["source_features"], a["target_features"]) for m, a in arrays.items()})
        name, caption = group.replace(" → ", "-"), f"{group}, seed {seed}"
        figures += [
            NamedFigure(f"scatter-{name}", f"{caption}: predicted against true force", scatter),
            NamedFigure(f"tsne-{name}", f"{caption}: features of both domains", plane),
        ]
    return figures
