"""Errors of force predictions: MAE and R² per axis, in newtons and as a share of the declared range."""

from dataclasses import dataclass

import numpy as np

from gelgap.adapt.model import ForceModel
from gelgap.domains import LabelledFrames

AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Evaluation:
    """Error of n predictions.

    mae_n, mae_percent (of the full range) and r2 hold x, y, z; an axis whose true force is constant has r2 = nan.
    """

    n: int
    mae_n: tuple[float, float, float]
    mae_percent: tuple[float, float, float]
    r2: tuple[float, float, float]

    @property
    def mean_mae_n(self) -> float:
        """Mean over the axes (the paper's error), N."""
        return float(np.mean(self.mae_n))

    @property
    def mean_mae_percent(self) -> float:
        """Mean over the axes, % of the full range."""
        return float(np.mean(self.mae_percent))


def evaluate_predictions(
    true_n: np.ndarray, predicted_n: np.ndarray, force_range_n: np.ndarray
) -> Evaluation:
    """Return the error of predicted forces (n, 3) in N; force_range_n is the declared range (3, 2).

    Raises
    ------
    ValueError
        If there are no frames or a prediction is not finite.
    """
    true_n, predicted_n = np.asarray(true_n, float), np.asarray(predicted_n, float)
    if true_n.shape != predicted_n.shape or true_n.ndim != 2 or len(true_n) == 0:
        raise ValueError(f"forces are {true_n.shape} and {predicted_n.shape}; both must be (n, 3) with n ≥ 1")
    if not np.isfinite(predicted_n).all():
        raise ValueError(
            f"{(~np.isfinite(predicted_n)).any(axis=1).sum()} of {len(true_n)} predictions are not finite"
        )
    mae = np.abs(predicted_n - true_n).mean(axis=0)
    width = np.diff(np.asarray(force_range_n, float), axis=1)[:, 0]
    total = ((true_n - true_n.mean(axis=0)) ** 2).sum(axis=0)
    residual = ((predicted_n - true_n) ** 2).sum(axis=0)
    r2 = np.where(total > 0, 1 - residual / np.where(total > 0, total, 1), np.nan)
    return Evaluation(
        len(true_n), tuple(mae.tolist()), tuple((100 * mae / width).tolist()), tuple(r2.tolist())
    )


def evaluate(model: ForceModel, frames: LabelledFrames) -> Evaluation:
    """Return the error of a model on labelled frames."""
    return evaluate_predictions(frames.force_n, model.predict_n(frames), frames.force_range_n)


def evaluate_constant_mean(train: LabelledFrames, frames: LabelledFrames) -> Evaluation:
    """Return the error of predicting, for every frame, the mean force of the training frames."""
    prediction = np.broadcast_to(train.force_n.astype(float).mean(axis=0), frames.force_n.shape)
    return evaluate_predictions(frames.force_n, prediction, frames.force_range_n)
