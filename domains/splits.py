"""Dividing frames into training, validation and test frames: one seed, one split, for a domain alone or for two."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from gelgap.domains.contacts import contact_points
from gelgap.domains.dataset import LabelledFrames
from gelgap.domains.random_streams import random_stream

SplitBy = Literal["random", "point", "given"]
Shares = Sequence[float]
PAPER_SHARES = (0.6, 0.2, 0.2)
PARTS = ("train", "validation", "test")
_TEST = PARTS.index("test")


class DomainSplit(NamedTuple):
    """Indices of the source's and the target's frames, each sorted; in one domain the parts are disjoint."""

    source_train: np.ndarray
    source_held_out: np.ndarray
    target_train: np.ndarray
    target_validation: np.ndarray
    target_test: np.ndarray


def draw_parts(count: int, seed: int, shares: Shares = PAPER_SHARES) -> np.ndarray:
    """Return the part (count,) of each of `count` frames or points, an index into `PARTS`.

    The order in which they are drawn depends on count and seed alone, so that other shares move only the cuts.
    """
    order = random_stream(seed, "", "split").permutation(count)
    ends = np.rint(np.cumsum(shares) * count)
    parts = np.empty(count, dtype=np.int64)
    parts[order] = np.searchsorted(ends, np.arange(count), side="right")
    return parts


def split_frames(
    frames: LabelledFrames, by: SplitBy | None = None, seed: int = 0, shares: Shares = PAPER_SHARES
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
    (parts,) = _parts([frames], by, seed, [shares])
    train, validation, test = (np.flatnonzero(parts == part) for part in range(len(PARTS)))
    return train, validation, test


def split_domains(
    source: LabelledFrames,
    target: LabelledFrames,
    by: SplitBy | None = None,
    seed: int = 0,
    shares: Shares = PAPER_SHARES,
    held_out: float = 0.1,
) -> DomainSplit:
    """Split a source into training and held-out frames, and a target into training, validation and test frames.

    Each domain is divided as `split_frames` divides it. By `point`, the split is shared: a contact point that both
    domains have is in the same part of both, and the source's held-out points are at least the target's test points, so
    that no point of a test frame was trained on. Points that only one of the domains has are divided by themselves.

    Parameters
    ----------
    source, target
        The domains.
    by, seed, shares
        As for `split_frames`; the shares are the target's.
    held_out
        Share of the source that is held out. A source that states its split holds out its test part, or nothing if this
        share is 0.

    Raises
    ------
    ValueError
        As `split_frames`.
    """
    if by == "point":
        held_out = max(held_out, shares[_TEST])
    of_source, of_target = _parts([source, target], by, seed, [(1 - held_out, 0.0, held_out), shares])
    is_held_out = (of_source == _TEST) & (held_out > 0)
    return DomainSplit(
        np.flatnonzero(~is_held_out),
        np.flatnonzero(is_held_out),
        *(np.flatnonzero(of_target == part) for part in range(len(PARTS))),
    )


def _parts(
    domains: Sequence[LabelledFrames], by: SplitBy | None, seed: int, shares: Sequence[Shares]
) -> list[np.ndarray]:
    """Return the part (n,) of each domain's frames, with shares per domain."""
    for own in shares:
        if len(own) != 3 or min(own) < 0 or abs(sum(own) - 1) > 1e-9:
            raise ValueError(f"shares = {tuple(own)}: must be three numbers in [0, 1] that add up to 1")
    if by == "point":
        return _parts_by_point(domains, seed, shares)
    found = []
    for frames, own in zip(domains, shares, strict=True):
        match by or ("given" if "split" in frames.columns else "random"):
            case "given":
                found.append(_stated_parts(frames))
            case "random":
                found.append(_parts_at_random(frames, seed, own))
                _check_filled(frames, found[-1], own, f"{len(frames)} frames")
            case _:
                raise ValueError(f"split {by!r} is unknown; known: random, point, given")
    return found


def _parts_at_random(frames: LabelledFrames, seed: int, shares: Shares) -> np.ndarray:
    """Draw frames that did not converge too, so that a seed gives the same part whichever frames are left out."""
    drawn = draw_parts(len(frames) + frames.unconverged, seed, shares)
    return drawn[frames.columns["frame_id"]] if frames.unconverged else drawn


def _parts_by_point(
    domains: Sequence[LabelledFrames], seed: int, shares: Sequence[Shares]
) -> list[np.ndarray]:
    """As `_parts`; the points of both domains, and those of one alone, are drawn as groups of their own."""
    points = contact_points(*domains)
    known_to = np.stack([np.isin(np.arange(np.concatenate(points).max() + 1), own) for own in points])
    groups = np.unique(known_to, axis=1, return_inverse=True)[1].reshape(-1)
    found = []
    for frames, own_points, own_shares in zip(domains, points, shares, strict=True):
        parts = np.empty(len(groups), dtype=np.int64)
        for group in np.unique(groups):
            parts[groups == group] = draw_parts(int((groups == group).sum()), seed, own_shares)
        found.append(parts[own_points])
        _check_filled(frames, found[-1], own_shares, f"{len(np.unique(own_points))} contact points")
    return found


def _stated_parts(frames: LabelledFrames) -> np.ndarray:
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


def _check_filled(frames: LabelledFrames, parts: np.ndarray, shares: Shares, drawn: str) -> None:
    for part, (name, share) in enumerate(zip(PARTS, shares, strict=True)):
        if share > 0 and not (parts == part).any():
            raise ValueError(f"data set {frames.name}: {drawn} are too few for a {name} share of {share:g}")
