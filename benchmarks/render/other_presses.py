"""Presses unlike those that a model was fitted to: deeper ones, elsewhere in the view, or after very few."""

from collections.abc import Callable, Sequence

import numpy as np

from gelgap.benchmarks.common.tables import print_table
from gelgap.benchmarks.render.predictions import METRICS, Prediction, score_presses, table_row
from gelgap.render import PressPicture
from gelgap.render.calibration.calibrator import LightTask

Model = Callable[[np.ndarray, np.ndarray], Prediction]
"""Fits presses of some indices, and predicts presses of others."""
FEW = 6


def splits(poses_mm: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return fitted and predicted indices of presses (n, 3) at x, y and depth."""
    x, y, depth = poses_mm.T
    every = np.arange(len(poses_mm))
    parts = {"odd presses after six": (every[:: -(-len(every) // FEW)], every[1::2])}
    for name, order in (
        ("right half after the left", x),
        ("outer half after the inner", np.hypot(x - x.mean(), y - y.mean())),
        ("deeper half after the shallower", depth),
        ("shallower half after the deeper", -depth),
    ):
        fitted, predicted = np.array_split(np.argsort(order, kind="stable"), 2)
        parts[name] = np.sort(fitted), np.sort(predicted)
    return parts


def measure_other_presses(
    task: LightTask, presses: Sequence[PressPicture], models: Sequence[Model]
) -> dict[str, dict[str, list[list[float]]]]:
    """Print how each model predicts presses unlike its own; return the metrics by split and model."""
    fit = task.fit(np.arange(len(presses)))
    rows, metrics = [], {}
    for name, (fitted, predicted) in splits(fit.presses).items():
        real = [presses[k] for k in predicted]
        metrics[name] = {}
        for model in models:
            prediction = model(fitted, predicted)
            values = metrics[name][prediction.name] = score_presses(prediction, real)
            rows.append([name, *table_row(prediction, values)[:1], *table_row(prediction, values)[2:8]])
    shallow, deep = np.percentile(fit.presses[:, 2], (0, 100))
    print_table(
        "presses unlike the fitted ones; PSNR in dB, median (worst)",
        ["predicted", "model", *METRICS],
        rows,
        note=f"depths by a fit of all presses: {shallow:.2f} to {deep:.2f} mm",
    )
    return metrics
