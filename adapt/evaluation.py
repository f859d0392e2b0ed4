"""Errors of predictions: MAE and R² of each label, in its unit and as a share of its range."""

from dataclasses import dataclass

import numpy as np

from gelgap.adapt.model import ForceModel
from gelgap.domains import FORCE_COLUMNS, QUANTITIES, LabelledFrames, with_labels


@dataclass(frozen=True)
class Evaluation:
    """Error of n predictions.

    mae (in each label's unit), mae_percent (of the full range) and r2 hold one number for each of `labels`; a label
    whose true value is constant has r2 = nan.
    """

    n: int
    mae: tuple[float, ...]
    mae_percent: tuple[float, ...]
    r2: tuple[float, ...]
    labels: tuple[str, ...] = FORCE_COLUMNS

    @property
    def unit(self) -> str | None:
        """The unit that all labels share; None where they have several."""
        units = {QUANTITIES[name].unit for name in self.labels}
        return units.pop() if len(units) == 1 else None

    @property
    def mean_mae(self) -> float | None:
        """Mean over the labels, in their unit; None where they have several."""
        return None if self.unit is None else float(np.mean(self.mae))

    @property
    def mae_n(self) -> tuple[float, ...]:
        """MAE of each axis of the force, N; a ValueError where other labels were predicted."""
        if self.unit != "N":
            raise ValueError(f"the labels {', '.join(self.labels)} are not all forces: take `mae`")
        return self.mae

    @property
    def mean_mae_n(self) -> float:
        """Mean over the axes (the paper's error), N."""
        return float(np.mean(self.mae_n))

    @property
    def mean_mae_percent(self) -> float:
        """Mean over the labels, % of the full range."""
        return float(np.mean(self.mae_percent))


def evaluate_predictions(
    true: np.ndarray, predicted: np.ndarray, ranges: np.ndarray, labels: tuple[str, ...] = FORCE_COLUMNS
) -> Evaluation:
    """Return the error of predicted labels (n, k), each in its unit; ranges (k, 2) are theirs.

    Raises
    ------
    ValueError
        If there are no frames or a prediction is not finite.
    """
    true, predicted = np.asarray(true, float), np.asarray(predicted, float)
    if true.shape != predicted.shape or true.shape[1:] != (len(labels),) or len(true) == 0:
        raise ValueError(
            f"labels are {true.shape} and predictions {predicted.shape}; both must be (n, {len(labels)}) with n ≥ 1"
        )
    if not np.isfinite(predicted).all():
        raise ValueError(
            f"{(~np.isfinite(predicted)).any(axis=1).sum()} of {len(true)} predictions are not finite"
        )
    mae = np.abs(predicted - true).mean(axis=0)
    width = np.diff(np.asarray(ranges, float), axis=1)[:, 0]
    total = ((true - true.mean(axis=0)) ** 2).sum(axis=0)
    residual = ((predicted - true) ** 2).sum(axis=0)
    r2 = np.where(total > 0, 1 - residual / np.where(total > 0, total, 1), np.nan)
    return Evaluation(
        len(true), tuple(mae.tolist()), tuple((100 * mae / width).tolist()), tuple(r2.tolist()), labels
    )


def evaluate(model: ForceModel, frames: LabelledFrames) -> Evaluation:
    """Return the error of a model on labelled frames, on the labels that it predicts."""
    if frames.labels.names != model.labels.names:
        frames = with_labels(frames, model.labels)
    return evaluate_frames(frames, model.predict(frames))


def evaluate_frames(frames: LabelledFrames, predicted: np.ndarray) -> Evaluation:
    """Return the error of predictions (n, k) of the labels of frames."""
    return evaluate_predictions(frames.label_values, predicted, frames.labels.ranges, frames.labels.names)


def evaluate_constant_mean(train: LabelledFrames, frames: LabelledFrames) -> Evaluation:
    """Return the error of predicting, for every frame, the mean labels of the training frames."""
    values = frames.label_values
    return evaluate_frames(
        frames, np.broadcast_to(train.label_values.astype(float).mean(axis=0), values.shape)
    )
