"""Dividing frames into training, validation and test frames: one seed, one split, alone or shared by two domains."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from gelgap.domains.dataset import LabelledFrames
from gelgap.domains.random_streams import random_stream

SplitBy = Literal["random", "point", "given"]
PAPER_SHARES = (0.6, 0.2, 0.2)
PARTS = ("train", "validation", "test")
_TRAIN, _VALIDATION, _TEST = range(3)
# A contact is where it was commanded to be; a micrometre is far below what a rig can tell.
_PER_MM = 1e3
_POINT = ("x_mm", "y_mm")
_POSE = (*_POINT, "depth_mm", "shear_x_mm", "shear_y_mm")


class DomainSplit(NamedTuple):
    """Indices of the source's and the target's frames, each sorted; in one domain the parts are disjoint."""

    source_train: np.ndarray
    source_held_out: np.ndarray
    target_train: np.ndarray
    target_validation: np.ndarray
    target_test: np.ndarray


def draw_parts(count: int, seed: int, shares: Sequence[float] = PAPER_SHARES) -> np.ndarray:
    """Return the part (count,) of each of `count` frames or points, an index into `PARTS`.

    The order in which they are drawn depends on count and seed alone, so that other shares move only the cuts.
    """
    order = random_stream(seed, "", "split").permutation(count)
    ends = np.rint(np.cumsum(shares) * count)
    parts = np.empty(count, dtype=np.int64)
    parts[order] = np.searchsorted(ends, np.arange(count), side="right")
    return parts


def split_frames(
    frames: LabelledFrames,
    by: SplitBy | None = None,
    seed: int = 0,
    shares: Sequence[float] = PAPER_SHARES,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the indices of the training, validation and test frames: disjoint, complete, each sorted.

    `given` takes what the data set states (column `split`), whatever seed and shares. `random` is the paper's; since
    neighbouring poses look alike, it lets a network see near-duplicates of its test frames. `point` keeps each contact
    point in one part. By default a split is given where the data set states one, and else random.

    Raises
    ------
    ValueError
        If the data set lacks what is asked for, or a part with a positive share would be empty.
    """
    _check_shares(shares)
    by = by or _default(frames)
    if by == "point":
        (points,) = contact_points(frames)
        parts = draw_parts(_count([points]), seed, shares)[points]
        _check_filled(frames, parts, shares, f"{_count([points])} contact points")
    else:
        parts = _parts(frames, by, seed, shares)
    return tuple(np.flatnonzero(parts == part) for part in (_TRAIN, _VALIDATION, _TEST))


def split_domains(
    source: LabelledFrames,
    target: LabelledFrames,
    by: SplitBy | None = None,
    seed: int = 0,
    shares: Sequence[float] = PAPER_SHARES,
    held_out: float = 0.1,
) -> DomainSplit:
    """Split a source into training and held-out frames, and a target into training, validation and test frames.

    Each domain is divided as `split_frames` divides it. By `point`, the split is shared: a contact point that both
    domains have is in the same part of both, and the source's held-out points are at least the target's test points, so
    that no point of a test frame was trained on. Points that only one of the domains has are divided by themselves.

    Parameters
    ----------
    by, seed, shares
        As for `split_frames`; the shares are the target's.
    held_out
        Share of the source that is held out; the split that a source itself states holds out its test part, or nothing
        for a share of 0.

    Raises
    ------
    ValueError
        As `split_frames`.
    """
    _check_shares(shares)
    if by == "point":
        held_out = max(held_out, shares[_TEST])
    source_shares = (1 - held_out, 0.0, held_out)
    if by == "point":
        source_parts, target_parts = _shared_parts(source, target, seed, source_shares, shares)
    else:
        source_parts = _parts(source, by or _default(source), seed, source_shares)
        target_parts = _parts(target, by or _default(target), seed, shares)
    trained_on = (source_parts != _TEST) | (held_out == 0)
    return DomainSplit(
        np.flatnonzero(trained_on),
        np.flatnonzero(~trained_on),
        *(np.flatnonzero(target_parts == part) for part in (_TRAIN, _VALIDATION, _TEST)),
    )


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
    lacking = {frames.name: [name for name in _POSE if name not in frames.columns] for frames in (one, other)}
    if not any(lacking.values()):
        poses = [_rounded(frames, _POSE) for frames in (one, other)]
    elif all(frames.has_classes and (frames.point_id >= 0).all() for frames in (one, other)):
        poses = [np.stack([frames.point_id, frames.contact_class], axis=1) for frames in (one, other)]
    else:
        name, missing = next((name, missing) for name, missing in lacking.items() if missing)
        raise ValueError(f"data set {name} lacks {', '.join(missing)}: its contacts cannot be paired")
    first, second = _numbered(poses)
    place = np.full(_count((first, second)), -1)
    place[second] = np.arange(len(second))
    paired = np.flatnonzero(place[first] >= 0)
    return paired, place[first[paired]]


def _default(frames: LabelledFrames) -> SplitBy:
    return "given" if "split" in frames.columns else "random"


def _parts(frames: LabelledFrames, by: str, seed: int, shares: Sequence[float]) -> np.ndarray:
    if by == "random":
        parts = draw_parts(len(frames), seed, shares)
        _check_filled(frames, parts, shares, f"{len(frames)} frames")
        return parts
    if by != "given":
        raise ValueError(f"split {by!r} is unknown; known: random, point, given")
    stated = frames.columns.get("split")
    if stated is None or not set(stated) <= set(PARTS):
        raise ValueError(
            f"data set {frames.name} gives no split into {', '.join(PARTS)}; split by random or point"
        )
    for part in ("train", "test"):
        if part not in stated:
            raise ValueError(
                f"data set {frames.name} states a split without {part} frames; split by random or point"
            )
    return np.array([PARTS.index(part) for part in stated], dtype=np.int64)


def _shared_parts(
    source: LabelledFrames,
    target: LabelledFrames,
    seed: int,
    source_shares: Sequence[float],
    target_shares: Sequence[float],
) -> list[np.ndarray]:
    """Return the part of each frame of both domains; the points of both, and of either alone, are drawn apart."""
    points = contact_points(source, target)
    in_source, in_target = (np.isin(np.arange(_count(points)), own) for own in points)
    frame_parts = []
    for frames, own, shares in zip((source, target), points, (source_shares, target_shares), strict=True):
        parts = np.empty(_count(points), dtype=np.int64)
        for group in (in_source & in_target, in_source & ~in_target, in_target & ~in_source):
            parts[group] = draw_parts(int(group.sum()), seed, shares)
        frame_parts.append(parts[own])
        _check_filled(frames, parts[own], shares, f"{len(np.unique(own))} contact points")
    return frame_parts


def _check_shares(shares: Sequence[float]) -> None:
    if len(shares) != 3 or min(shares) < 0 or abs(sum(shares) - 1) > 1e-9:
        raise ValueError(f"shares = {tuple(shares)}: must be three numbers in [0, 1] that add up to 1")


def _check_filled(frames: LabelledFrames, parts: np.ndarray, shares: Sequence[float], drawn: str) -> None:
    for part, (name, share) in enumerate(zip(PARTS, shares, strict=True)):
        if share > 0 and not (parts == part).any():
            raise ValueError(f"data set {frames.name}: {drawn} are too few for a {name} share of {share:g}")


def _rounded(frames: LabelledFrames, columns: Sequence[str]) -> np.ndarray:
    return np.rint(np.stack([frames.columns[name] for name in columns], axis=1) * _PER_MM).astype(np.int64)


def _numbered(keys: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Return a number for each row, from 0 in sorted order; rows that are equal, in any of the arrays, share it."""
    numbers = np.unique(np.concatenate(keys), axis=0, return_inverse=True)[1].reshape(-1)
    return tuple(np.split(numbers, np.cumsum([len(rows) for rows in keys])[:-1]))


def _count(numbers: Sequence[np.ndarray]) -> int:
    return max(own.max(initial=-1) for own in numbers) + 1
