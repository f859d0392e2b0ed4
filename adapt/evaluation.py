"""Errors of predictions, MAE and R² of each label, and what they are compared with: simple rules, and oracles.

Rules of a few numbers, without a network, are what any method should beat. Fitted on the source's training frames, they
see differences to the reference of at most 64 px along the longer side.

Oracles know contacts that both domains share. The pose oracle predicts a target frame's force by the source's force at
the same commanded pose: what a perfect alignment of contact classes gives. The geometry oracle predicts it by the
source gel's force at the target's actual contact: what a network gives that sees the target's shape as the source's.
Neither is a lower bound: shrinkage or luck can beat them.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from pydantic import BeforeValidator

from gelgap.adapt.methods.registry import find_method
from gelgap.adapt.model import ForceModel, input_map, with_statistics_of
from gelgap.adapt.split import SplitFrames
from gelgap.data import LabelledFrames, paired_contacts, with_labels
from gelgap.data.frames.dataset import labelled_frames
from gelgap.data.frames.labels import FORCE_COLUMNS, QUANTITIES
from gelgap.data.frames.stored import GeneratedDomain

CONSTANT, QUADRATIC, RIDGE = "constant mean", "quadratic in mean difference", "ridge on area and depth"
BASELINES = (CONSTANT, QUADRATIC, RIDGE)
_SIZE_PX = 64
# Of a picture in [0, 1]: what differs more is the dent, and its deepest part is where most differs.
_DENT, _DEEPEST = 0.03, 99.0
_PENALTY = 1e-3


NumberOrNull = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]
"""A number that is null in JSON if it is NaN."""


@dataclass(frozen=True)
class Evaluation:
    """Error of n predictions.

    mae (in each label's unit), mae_percent (of the full range) and r2 hold one number for each of `labels`; a label
    whose true value is constant has r2 = nan.
    """

    n: int
    mae: tuple[float, ...]
    mae_percent: tuple[float, ...]
    r2: tuple[NumberOrNull, ...]
    labels: tuple[str, ...] = FORCE_COLUMNS

    def __post_init__(self) -> None:
        if unknown := [name for name in self.labels if name not in QUANTITIES]:
            raise ValueError(f"label {unknown[0]!r} is unknown")
        if {len(self.mae), len(self.mae_percent), len(self.r2)} != {len(self.labels)}:
            names = ", ".join(self.labels)
            raise ValueError(f"it has other than {len(self.labels)} numbers for the labels {names}")

    @property
    def unit(self) -> str | None:
        """The unit that all labels share; None where they have several."""
        return shared_unit(self.labels)

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


def shared_unit(labels: Iterable[str]) -> str | None:
    """Return the unit that all labels share; None where they have several."""
    units = {QUANTITIES[name].unit for name in labels}
    return units.pop() if len(units) == 1 else None


def evaluate_predictions(
    true: np.ndarray, predicted: np.ndarray, ranges: ArrayLike, labels: tuple[str, ...] = FORCE_COLUMNS
) -> Evaluation:
    """Return the error of predicted labels (n, k), each in its unit; ranges (k, 2) are theirs.

    Frames of which a true label is NaN do not count.

    Raises
    ------
    ValueError
        If there are no frames with labels or a prediction is not finite.
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
    is_labelled = ~np.isnan(true).any(axis=1)
    if not is_labelled.any():
        raise ValueError(f"none of the {len(true)} frames has all labels: {', '.join(labels)}")
    true = true[is_labelled]
    predicted = predicted[is_labelled]
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
    return evaluate_frames(frames, model.predict_frames(frames))


def as_judged_on_source(model: ForceModel, source_train: LabelledFrames) -> ForceModel:
    """Return an adapted model as it is judged on the source: under its statistics, where each domain has its own.

    source_train holds the source's training frames.
    """
    if model.profile.judges_by_own_statistics and find_method(model.method).uses_target:
        return with_statistics_of(model, source_train)
    return replace(model, input_map=input_map(source_train, model.profile, model.device))


def evaluate_frames(frames: LabelledFrames, predicted: np.ndarray) -> Evaluation:
    """Return the error of predictions (n, k) of the labels of frames."""
    return evaluate_predictions(frames.label_values, predicted, frames.labels.ranges, frames.labels.names)


def evaluate_constant_mean(train: LabelledFrames, frames: LabelledFrames) -> Evaluation:
    """Return the error of predicting, for every frame, the mean labels of the training frames."""
    mean = labelled_frames(train).label_values.astype(float).mean(axis=0)
    return evaluate_frames(frames, np.broadcast_to(mean, frames.label_values.shape))


def errors_text(errors: Mapping[str, Evaluation]) -> str:
    """Return a table of evaluations of the same labels, a line for each by its name: MAE, their mean, and R²."""
    table = {}
    for name, error in errors.items():
        known = [QUANTITIES[label] for label in error.labels]
        row = {f"MAE {q.symbol}/{q.unit}": f"{mae:.4f}" for q, mae in zip(known, error.mae, strict=True)}
        row |= {} if error.mean_mae is None else {"mean": f"{error.mean_mae:.4f}"}
        table[name] = row | {f"R² {q.symbol}": r2_text(r2) for q, r2 in zip(known, error.r2, strict=True)}
    return pd.DataFrame.from_dict(table, "index").to_string()


def r2_text(r2: float) -> str:
    """Return R² with two digits; a dash for that of a label that does not vary."""
    return "–" if math.isnan(r2) else f"{r2:.2f}"


def worse_than_constant(errors: Evaluation) -> str:
    """Return a sentence on the labels that a constant, the mean of these frames, predicts better; empty if none."""
    names = [QUANTITIES[name].symbol for name, r2 in zip(errors.labels, errors.r2, strict=True) if r2 < 0]
    return f"{', '.join(names)}: worse than a constant, these frames' mean (R² below 0)" if names else ""


def evaluate_baselines(frames: SplitFrames) -> dict[str, Evaluation]:
    """Return the errors of all baselines on the target's test frames, by name.

    The constant is the source's mean. The quadratic is one in the mean absolute difference of a picture. The ridge is
    quadratic, too, in the share of pixels that belong to the dent, and in the difference where it is deepest.
    """
    from sklearn.linear_model import Ridge
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import PolynomialFeatures, StandardScaler

    train, test = frames.source_train, frames.target_test
    size_px = min(_SIZE_PX, max(train.size_px), max(test.size_px))
    known, wanted = _numbers(train, size_px), _numbers(test, size_px)
    errors = {CONSTANT: evaluate_constant_mean(train, test)}
    for name, columns in ((QUADRATIC, slice(0, 1)), (RIDGE, slice(1, 3))):
        ridge = make_pipeline(PolynomialFeatures(2), StandardScaler(), Ridge(_PENALTY * len(train)))
        ridge.fit(known[:, columns], train.label_values)
        # Of a single label it predicts (m,).
        predicted = ridge.predict(wanted[:, columns]).reshape(test.label_values.shape)
        errors[name] = evaluate_frames(test, predicted)
    return errors


def _numbers(frames: LabelledFrames, size_px: int) -> np.ndarray:
    """Return mean absolute difference, share of the dent's pixels and largest difference of each picture (n, 3)."""
    references = frames.references_at(size_px).astype(np.float32)
    images = frames.images(size_px)
    rows = []
    for image, reference in zip(images, frames.reference_id, strict=True):
        difference = np.abs(image - references[reference]).mean(axis=2) / 255
        rows.append((difference.mean(), (difference > _DENT).mean(), np.percentile(difference, _DEEPEST)))
    return np.array(rows)


@dataclass(frozen=True)
class Presses:
    """The frames of a domain with what was commanded, and how far the rig yields.

    command_mm (n, 3) is the indenter's commanded displacement from touching the gel; mount_n_per_mm the stiffness of
    the rig (None: rigid).
    """

    frames: LabelledFrames
    command_mm: np.ndarray
    mount_n_per_mm: float | None

    @classmethod
    def of(cls, domain: GeneratedDomain, frames: LabelledFrames | None = None) -> "Presses":
        """Read a generated domain's labels, or those of some of its frames."""
        names = ("shear_x_mm", "shear_y_mm", "commanded_z_mm")
        frames = domain if frames is None else frames
        return cls(
            frames=frames,
            command_mm=np.stack([frames.columns[name] for name in names], axis=1),
            mount_n_per_mm=domain.facts.mount_stiffness_n_per_mm,
        )

    @property
    def actual_mm(self) -> np.ndarray:
        """Where the indenter is (n, 3): the commanded displacement less what the rig yields."""
        yielded = 0.0 if self.mount_n_per_mm is None else self.frames.force_n / self.mount_n_per_mm
        return self.command_mm - yielded

    @property
    def trajectories(self) -> np.ndarray:
        """Contact point and direction (n, 3): the unit vector of the commanded travel, rounded; 0, 0 without travel."""
        travel_mm = self.command_mm[:, :2]
        length_mm = np.hypot(*travel_mm.T)[:, None]
        direction = np.round(travel_mm / np.where(length_mm > 0, length_mm, 1), 6) + 0.0
        return np.column_stack([self.frames.point_id, direction])


def pose_oracle(source: LabelledFrames, target: LabelledFrames) -> Evaluation:
    """Return the error of the source's force at the target's commanded pose, over shared contacts.

    Raises
    ------
    ValueError
        If the domains share no contact.
    """
    in_source, in_target = _pairs(source, target)
    return evaluate_predictions(target.force_n[in_target], source.force_n[in_source], target.force_range_n)


def geometry_oracle(source: Presses, target: Presses) -> Evaluation:
    """Return the error of the source gel's force at the target's actual contact, over shared contacts.

    With a rigid rig the actual contact is the commanded one, and this is the pose oracle. With a compliant one the
    indenter of a stiffer gel goes less deep; the source's force there is interpolated between its own contacts at the
    same point and in the same direction. The source keeps its friction.

    Raises
    ------
    ValueError
        If the domains share no contact.
    """
    _, in_target = _pairs(source.frames, target.frames)
    actual_mm, wanted = target.actual_mm[in_target], target.trajectories[in_target]
    is_touching = target.command_mm[in_target, 2] < 0  # elsewhere the force is 0
    guess_n = np.zeros((len(in_target), 3))
    for trajectory in np.unique(wanted[is_touching], axis=0):
        members = is_touching & (wanted == trajectory).all(axis=1)
        same_way = (source.trajectories == trajectory).all(axis=1)
        guess_n[members] = _force_along(source, same_way, trajectory[1:], actual_mm[members])
    truth = target.frames.force_n[in_target]
    return evaluate_predictions(truth, guess_n, target.frames.force_range_n)


def oracles_on(source: LabelledFrames, target: LabelledFrames, test: LabelledFrames) -> dict[str, Evaluation]:
    """Return both oracles by name, on the target's frames `test`; none but of generated domains that share contacts."""
    if not (isinstance(source, GeneratedDomain) and isinstance(target, GeneratedDomain)):
        return {}
    if test.labels.names != FORCE_COLUMNS or not len(paired_contacts(source, test)[0]):
        return {}
    return {
        "pose oracle": pose_oracle(source, test),
        "geometry oracle": geometry_oracle(Presses.of(source), Presses.of(target, test)),
    }


def _pairs(source: LabelledFrames, target: LabelledFrames) -> tuple[np.ndarray, np.ndarray]:
    pairs = paired_contacts(source, target)
    if not len(pairs[0]):
        raise ValueError("source and target share no contact; generate paired contacts")
    return pairs


def _force_along(
    source: Presses, chosen: np.ndarray, direction: np.ndarray, actual_mm: np.ndarray
) -> np.ndarray:
    """Return the source's force (m, 3) at displacements (m, 3), from its contacts `chosen` (n,) in one direction (2,).

    A thin-plate spline over depth and travel passes through all of them, and through zero where the gel is not touched.
    """
    from scipy.interpolate import RBFInterpolator

    def place(displacement_mm: np.ndarray) -> np.ndarray:
        return np.stack([displacement_mm[:, 2], displacement_mm[:, :2] @ direction], axis=1)

    known = np.concatenate([place(source.actual_mm[chosen]), np.zeros((1, 2))])
    force_n = np.concatenate([source.frames.force_n[chosen], np.zeros((1, 3))])
    if np.linalg.matrix_rank(known) < 2:
        order = np.argsort(-known[:, 0])
        depths_mm = -known[order, 0]
        sorted_n = force_n[order]
        return np.stack([np.interp(-actual_mm[:, 2], depths_mm, axis) for axis in sorted_n.T], axis=1)
    return RBFInterpolator(known, force_n)(place(actual_mm))
