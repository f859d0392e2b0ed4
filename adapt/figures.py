"""Figures of adaptation runs: predicted against true force, and the features of both domains by t-SNE."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gelgap.domains import FORCE_COLUMNS, QUANTITIES

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def force_scatter(
    true_n: np.ndarray,
    predicted_n: Mapping[str, np.ndarray],
    path: str | Path | None = None,
    labels: tuple[str, ...] = FORCE_COLUMNS,
) -> "Figure":
    """Draw predicted against true force, one row per method, one column per axis (the paper's figure 4).

    true_n and every predicted_n are (n, 3) in N, or (n, k) of other labels, each in its unit.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(max(9, 3 * len(labels)), 2.8 * len(predicted_n)), layout="constrained")
    grid = figure.subplots(len(predicted_n), len(labels), squeeze=False)
    for row, (method, predicted) in zip(grid, predicted_n.items(), strict=True):
        for label, (name, axes) in enumerate(zip(labels, row, strict=True)):
            truth, guess = true_n[:, label], predicted[:, label]
            symbol, unit = QUANTITIES[name]
            what = f"force, {unit}" if name in FORCE_COLUMNS else f"{symbol}, {unit}"
            limits = (min(truth.min(), guess.min()), max(truth.max(), guess.max()))
            axes.plot(limits, limits, color="0.6", linewidth=1)
            axes.scatter(truth, guess, s=6, alpha=0.6, linewidths=0)
            axes.set_aspect("equal", adjustable="datalim")
            axes.set_title(f"{method}: {symbol}, MAE {np.abs(truth - guess).mean():.3f} {unit}", fontsize=9)
            axes.set_xlabel(f"true {what}", fontsize=8)
            axes.set_ylabel(f"predicted {what}", fontsize=8)
    return _saved(figure, path)


def feature_tsne(
    features: Mapping[str, tuple[np.ndarray, np.ndarray]], path: str | Path | None = None, seed: int = 0
) -> "Figure":
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
