"""Figures and tables of adaptation runs: predicted against true force, feature t-SNE, Markdown and LaTeX tables."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gelgap.adapt.evaluation import AXES
from gelgap.adapt.runs import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_LATEX = {
    "_": r"\_",
    r"λ\_t": r"$\lambda_t$",
    "%": r"\%",
    "→": r"$\to$",
    "±": r"$\pm$",
    "×": r"$\times$",
    "≥": r"$\ge$",
    "<": "$<$",
    "²": "$^2$",
    "…": "--",
    "–": "--",
    "−": "$-$",
}
"""What tables use beyond ASCII letters, and how LaTeX says it; in this order."""


def force_scatter(
    true_n: np.ndarray, predicted_n: Mapping[str, np.ndarray], path: str | Path | None = None
) -> "Figure":
    """Draw predicted against true force, one row a method and one column an axis (the paper's figure 4).

    true_n and every predicted_n are (n, 3) in N.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 2.8 * len(predicted_n)), layout="constrained")
    grid = figure.subplots(len(predicted_n), 3, squeeze=False)
    for row, (method, predicted) in zip(grid, predicted_n.items(), strict=True):
        for axis, axes in enumerate(row):
            truth, guess = true_n[:, axis], predicted[:, axis]
            limits = (min(truth.min(), guess.min()), max(truth.max(), guess.max()))
            axes.plot(limits, limits, color="0.6", linewidth=1)
            axes.scatter(truth, guess, s=6, alpha=0.6, linewidths=0)
            axes.set_aspect("equal", adjustable="datalim")
            axes.set_title(f"{method}: F{AXES[axis]}, MAE {np.abs(truth - guess).mean():.3f} N", fontsize=9)
            axes.set_xlabel("true force, N", fontsize=8)
            axes.set_ylabel("predicted force, N", fontsize=8)
    return _saved(figure, path)


def feature_tsne(
    features: Mapping[str, tuple[np.ndarray, np.ndarray]], path: str | Path | None = None, seed: int = 0
) -> "Figure":
    """Draw source and target features of each method in a common t-SNE plane per method (the paper's figure 5).

    features maps a method to source (n, D) and target (m, D) features; at least 3 frames in all.
    """
    from matplotlib.figure import Figure
    from sklearn.manifold import TSNE

    figure = Figure(figsize=(3.6 * len(features), 3.6), layout="constrained")
    for axes, (method, (source, target)) in zip(
        figure.subplots(1, len(features), squeeze=False)[0], features.items(), strict=True
    ):
        together = np.concatenate([source, target]).astype(np.float32)
        perplexity = min(30.0, (len(together) - 1) / 3)
        plane = TSNE(perplexity=perplexity, random_state=seed, init="pca").fit_transform(together)
        axes.scatter(*plane[: len(source)].T, s=6, label="source", linewidths=0)
        axes.scatter(*plane[len(source) :].T, s=6, label="target", linewidths=0)
        axes.set(title=method, xticks=[], yticks=[])
        axes.legend(fontsize=8)
    return _saved(figure, path)


def _saved(figure: "Figure", path: str | Path | None) -> "Figure":
    if path is not None:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=130)
    return figure


def mean_over_seeds(runs: Sequence[Run]) -> dict[tuple[str, str], tuple[float, float, int]]:
    """Return, per group and method, the mean and standard deviation of the target's mean MAE (N) and the seeds."""
    values: dict[tuple[str, str], list[float]] = {}
    for run in runs:
        values.setdefault((run.group, run.method), []).append(run.target_test.mean_mae_n)
    return {
        key: (float(np.mean(x)), float(np.std(x, ddof=1)) if len(x) > 1 else 0.0, len(x))
        for key, x in values.items()
    }


def error_rows(runs: Sequence[Run]) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of the table of target MAE in N: a row a group, a column a method, then the means."""
    methods = list(dict.fromkeys(run.method for run in runs))
    groups = list(dict.fromkeys(run.group for run in runs))
    found = mean_over_seeds(runs)

    def cell(group: str, method: str) -> str:
        if (group, method) not in found:
            return "–"
        mean, deviation, seeds = found[group, method]
        return f"{mean:.3f}" + (f" ± {deviation:.3f}" if seeds > 1 else "")

    rows = [[group, *(cell(group, method) for method in methods)] for group in groups]
    means = []
    for method in methods:
        values = [found[group, method][0] for group in groups if (group, method) in found]
        means.append(f"{np.mean(values):.3f}" if len(values) == len(groups) else "–")
    return ["group", *methods], [*rows, ["mean", *means]]


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [header, ["---", *("---:" for _ in header[1:])], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def latex_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a LaTeX tabular (booktabs)."""

    def line(cells: Sequence[str]) -> str:
        text = " & ".join(cells)
        for character, command in _LATEX.items():
            text = text.replace(character, command)
        return text + r" \\"

    body = [r"\begin{tabular}{l" + "r" * (len(header) - 1) + "}", r"\toprule", line(header), r"\midrule"]
    return "\n".join([*body, *map(line, rows), r"\bottomrule", r"\end{tabular}"]) + "\n"
