"""Figures of adaptation runs: predicted against true force, and the features of both domains by t-SNE."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gelgap.adapt.evaluation import AXES

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def force_scatter(
    true_n: np.ndarray, predicted_n: Mapping[str, np.ndarray], path: str | Path | None = None
) -> "Figure":
    """Draw predicted against true force, one row per method, one column per axis (the paper's figure 4).

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
