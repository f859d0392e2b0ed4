"""Which frames, of one domain or of two, show the same contact or the same contact point."""

from collections.abc import Sequence

import numpy as np

from gelgap.domains.dataset import LabelledFrames

_POINT = ("x_mm", "y_mm")
_POSE = (*_POINT, "depth_mm", "shear_x_mm", "shear_y_mm")
# Commanded poses that agree to a micrometre are one: it is far below what a rig can tell.
_RESOLUTION_MM = 1e-3


def contact_points(*domains: LabelledFrames) -> tuple[np.ndarray, ...]:
    """Return the number (n,) of each frame's contact point, from 0; equal numbers are one point, across the domains.

    A point is its commanded position, to 1 µm, where all domains state it, and else its `point_id`.

    Raises
    ------
    ValueError
        If a domain states neither.
    """
    if all(name in frames.columns for frames in domains for name in _POINT):
        return _numbered([_rounded(frames, _POINT) for frames in domains])
    for frames in domains:
        if (frames.point_id < 0).any():
            raise ValueError(
                f"data set {frames.name} does not say its contact points; split by random or given"
            )
    return _numbered([frames.point_id[:, None] for frames in domains])


def paired_contacts(one: LabelledFrames, other: LabelledFrames) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of frames that show the same commanded contact in both data sets, in the first one's order.

    A contact is the commanded pose: point, depth and shear, to 1 µm; where a data set does not state them, the contact
    point's number and the contact class.

    Raises
    ------
    ValueError
        If a data set states neither.
    """
    domains = (one, other)
    if all(name in frames.columns for frames in domains for name in _POSE):
        first, second = _numbered([_rounded(frames, _POSE) for frames in domains])
    elif all(frames.has_classes and (frames.point_id >= 0).all() for frames in domains):
        labels = [np.stack([frames.point_id, frames.contact_class], axis=1) for frames in domains]
        first, second = _numbered(labels)
    else:
        for frames in domains:
            missing = [name for name in _POSE if name not in frames.columns]
            if missing:
                raise ValueError(
                    f"data set {frames.name} lacks {', '.join(missing)}: its contacts cannot be paired"
                )
    place = np.full(np.concatenate([first, second]).max(initial=-1) + 1, -1)
    place[second] = np.arange(len(second))
    paired = np.flatnonzero(place[first] >= 0)
    return paired, place[first[paired]]


def _rounded(frames: LabelledFrames, columns: Sequence[str]) -> np.ndarray:
    values_mm = np.stack([frames.columns[name] for name in columns], axis=1)
    return np.rint(values_mm / _RESOLUTION_MM).astype(np.int64)


def _numbered(keys: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Return a number for each row, from 0 in sorted order; rows that are equal, in any of the arrays, share it."""
    numbers = np.unique(np.concatenate(keys), axis=0, return_inverse=True)[1].reshape(-1)
    return tuple(np.split(numbers, np.cumsum([len(rows) for rows in keys])[:-1]))
