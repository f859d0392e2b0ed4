"""What alignment alone can be expected to reach, from contacts that both domains share.

The pose oracle predicts a target frame's force by the source's force at the same commanded pose: what a perfect
alignment of contact classes gives. The geometry oracle predicts it by the source gel's force at the target's actual
contact: what a network gives that sees the target's shape as the source's. Neither is a lower bound: shrinkage or luck
can beat them.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from gelgap.adapt.evaluation import Evaluation, evaluate_predictions

if TYPE_CHECKING:
    from gelgap.domains import GeneratedDomain


class Contacts(Protocol):
    """Anything with force_n (n, 3) in N, point_id (n,) and contact_class (n,): `Frames`, or a reader of a data set."""

    force_n: np.ndarray
    point_id: np.ndarray
    contact_class: np.ndarray
    force_range_n: np.ndarray


@dataclass(frozen=True)
class Presses:
    """Contacts with what was commanded: `command_mm` (n, 3) is the indenter's commanded displacement from touching the
    gel, `mount_n_per_mm` the stiffness of the rig (none: rigid)."""

    force_n: np.ndarray
    point_id: np.ndarray
    contact_class: np.ndarray
    force_range_n: np.ndarray
    command_mm: np.ndarray
    mount_n_per_mm: float | None

    @classmethod
    def of(cls, domain: "GeneratedDomain") -> "Presses":
        """Read a generated domain's labels."""
        names = ("shear_x_mm", "shear_y_mm", "commanded_z_mm")
        return cls(
            force_n=domain.force_n,
            point_id=domain.point_id,
            contact_class=domain.contact_class,
            force_range_n=domain.force_range_n,
            command_mm=np.stack([domain.columns[name] for name in names], axis=1),
            mount_n_per_mm=domain.recipe.elastomer.mount_stiffness_n_per_mm,
        )

    @property
    def actual_mm(self) -> np.ndarray:
        """Where the indenter is (n, 3): the commanded displacement less what the rig yields."""
        yielded = 0.0 if self.mount_n_per_mm is None else self.force_n / self.mount_n_per_mm
        return self.command_mm - yielded


def paired_indices(source: Contacts, target: Contacts) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices (k,) in source and target of the contacts (point and class) that both have.

    Raises
    ------
    ValueError
        If the domains share no contact.
    """

    def keys(contacts: Contacts) -> list[tuple[int, int]]:
        return list(zip(contacts.point_id.tolist(), contacts.contact_class.tolist(), strict=True))

    place = {key: i for i, key in enumerate(keys(source)) if min(key) >= 0}
    pairs = [(place[key], j) for j, key in enumerate(keys(target)) if key in place]
    if not pairs:
        raise ValueError("source and target share no contact (point and class); generate paired contacts")
    in_source, in_target = np.array(pairs).T
    return in_source, in_target


def pose_oracle(source: Contacts, target: Contacts) -> Evaluation:
    """Return the error of the source's force at the target's commanded pose."""
    in_source, in_target = paired_indices(source, target)
    return evaluate_predictions(target.force_n[in_target], source.force_n[in_source], target.force_range_n)


def geometry_oracle(source: Presses, target: Presses) -> Evaluation:
    """Return the error of the source gel's force at the target's actual contact, over the contacts that both have.

    With a rigid rig the actual contact is the commanded one, and this is the pose oracle. With a compliant one the
    indenter of a stiffer gel goes less deep; the source's force there is interpolated between its own contacts at the
    same point and in the same direction. The source keeps its friction.
    """
    _, in_target = paired_indices(source, target)
    actual = target.actual_mm
    guess = np.zeros((len(in_target), 3))
    for way, members in _ways(target, in_target).items():
        own = [i for i in np.flatnonzero(source.point_id == way[0]) if _direction(source, i) == way[1]]
        guess[members] = _force_along(source, np.array(own), way[1], actual[in_target[members]])
    return evaluate_predictions(target.force_n[in_target], guess, target.force_range_n)


Way = tuple[int, tuple[float, float]]


def _ways(presses: Presses, indices: np.ndarray) -> dict[Way, list[int]]:
    """Return, by point and direction, the positions in `indices` of the contacts; those without contact are left out:
    their force is 0."""
    found: dict[Way, list[int]] = {}
    for position, i in enumerate(indices):
        if presses.command_mm[i, 2] < 0:
            found.setdefault((int(presses.point_id[i]), _direction(presses, i)), []).append(position)
    return found


def _direction(presses: Presses, index: int) -> tuple[float, float]:
    """Return the unit vector of the commanded shear, rounded; (0, 0) without shear."""
    x, y = presses.command_mm[index, :2]
    length = float(np.hypot(x, y)) or 1.0
    return round(float(x) / length, 6) + 0.0, round(float(y) / length, 6) + 0.0


def _force_along(
    source: Presses, own: np.ndarray, direction: tuple[float, float], actual_mm: np.ndarray
) -> np.ndarray:
    """Return the source's force (m, 3) at displacements (m, 3), from its contacts `own` in one direction.

    A thin-plate spline over depth and way passes through every one of them; the gel that is not touched adds a zero.
    """
    from scipy.interpolate import RBFInterpolator

    def place(displacement_mm: np.ndarray) -> np.ndarray:
        return np.stack([displacement_mm[:, 2], displacement_mm[:, :2] @ direction], axis=1)

    known = np.concatenate([place(source.actual_mm[own]), np.zeros((1, 2))])
    force = np.concatenate([source.force_n[own], np.zeros((1, 3))])
    if np.linalg.matrix_rank(known) < 2:
        return np.stack([np.interp(-actual_mm[:, 2], *_by_depth(known, axis)) for axis in force.T], axis=1)
    return RBFInterpolator(known, force)(place(actual_mm))


def _by_depth(known: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(-known[:, 0])
    return -known[order, 0], values[order]


def gap_closed(source_only_n: float, adapted_n: float, supervised_n: float) -> float:
    """Return the share of the gap from source-only to supervised error that a method closes; not capped.

    NaN where supervised training is no better than source-only.
    """
    gap = source_only_n - supervised_n
    return (source_only_n - adapted_n) / gap if gap > 0 else float("nan")
