"""Errors that perfect alignment would give, computed from contacts that both domains share.

The pose oracle predicts a target frame's force by the source's force at the same commanded pose: what a perfect
alignment of contact classes gives. The geometry oracle predicts it by the source gel's force at the target's actual
contact: what a network gives that sees the target's shape as the source's. Neither is a lower bound: shrinkage or luck
can beat them.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gelgap.adapt.evaluation import Evaluation, evaluate_predictions
from gelgap.domains import LabelledFrames, paired_contacts

if TYPE_CHECKING:
    from gelgap.domains import GeneratedDomain


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
    def of(cls, domain: "GeneratedDomain") -> "Presses":
        """Read a generated domain's labels."""
        names = ("shear_x_mm", "shear_y_mm", "commanded_z_mm")
        return cls(
            frames=domain,
            command_mm=np.stack([domain.columns[name] for name in names], axis=1),
            mount_n_per_mm=domain.recipe.elastomer.mount_stiffness_n_per_mm,
        )

    @property
    def actual_mm(self) -> np.ndarray:
        """Where the indenter is (n, 3): the commanded displacement less what the rig yields."""
        yielded = 0.0 if self.mount_n_per_mm is None else self.frames.force_n / self.mount_n_per_mm
        return self.command_mm - yielded

    def direction(self, index: int) -> tuple[float, float]:
        """Return the unit vector of a contact's commanded travel, rounded; (0, 0) without travel."""
        x, y = self.command_mm[index, :2]
        length = float(np.hypot(x, y)) or 1.0
        return round(float(x) / length, 6) + 0.0, round(float(y) / length, 6) + 0.0


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
    actual_mm = target.actual_mm[in_target]
    guess_n = np.zeros((len(in_target), 3))
    for (point, direction), members in _by_point_and_direction(target, in_target).items():
        at_point = np.flatnonzero(source.frames.point_id == point)
        own = np.array([i for i in at_point if source.direction(i) == direction])
        guess_n[members] = _force_along(source, own, direction, actual_mm[members])
    truth = target.frames.force_n[in_target]
    return evaluate_predictions(truth, guess_n, target.frames.force_range_n)


def _pairs(source: LabelledFrames, target: LabelledFrames) -> tuple[np.ndarray, np.ndarray]:
    pairs = paired_contacts(source, target)
    if not len(pairs[0]):
        raise ValueError("source and target share no contact; generate paired contacts")
    return pairs


def _by_point_and_direction(
    presses: Presses, indices: np.ndarray
) -> dict[tuple[int, tuple[float, float]], list[int]]:
    """Return the positions in `indices` of the contacts, by point and direction.

    Frames without contact are left out: their force is 0.
    """
    found: dict[tuple[int, tuple[float, float]], list[int]] = {}
    for position, i in enumerate(indices):
        if presses.command_mm[i, 2] < 0:
            key = int(presses.frames.point_id[i]), presses.direction(i)
            found.setdefault(key, []).append(position)
    return found


def _force_along(
    source: Presses, own: np.ndarray, direction: tuple[float, float], actual_mm: np.ndarray
) -> np.ndarray:
    """Return the source's force (m, 3) at displacements (m, 3), from its contacts `own` in one direction.

    A thin-plate spline over depth and travel passes through all of them, and through zero where the gel is not touched.
    """
    from scipy.interpolate import RBFInterpolator

    def place(displacement_mm: np.ndarray) -> np.ndarray:
        return np.stack([displacement_mm[:, 2], displacement_mm[:, :2] @ direction], axis=1)

    known = np.concatenate([place(source.actual_mm[own]), np.zeros((1, 2))])
    force_n = np.concatenate([source.frames.force_n[own], np.zeros((1, 3))])
    if np.linalg.matrix_rank(known) < 2:
        order = np.argsort(-known[:, 0])
        depths_mm, sorted_n = -known[order, 0], force_n[order]
        return np.stack([np.interp(-actual_mm[:, 2], depths_mm, axis) for axis in sorted_n.T], axis=1)
    return RBFInterpolator(known, force_n)(place(actual_mm))


def gap_closed(source_only_n: float, adapted_n: float, supervised_n: float) -> float:
    """Return the share of the gap from source-only to supervised error that a method closes; not capped.

    NaN where supervised training is no better than source-only.
    """
    gap = source_only_n - supervised_n
    return (source_only_n - adapted_n) / gap if gap > 0 else float("nan")
