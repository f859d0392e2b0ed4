"""What a run takes from its data sets: labels, training, validation and test frames, and contacts that both show.

One seed gives one split, for a domain alone or for two.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from gelgap.assets.names import quoted
from gelgap.data.frames.dataset import LabelledFrames
from gelgap.data.random_stream import random_stream

WAYS = ("random", "point", "given")
Shares = Sequence[float]
PAPER_SHARES = (0.6, 0.2, 0.2)
PARTS = ("train", "validation", "test")
_TRAIN, _VALIDATION, _TEST = range(3)
_POINT = ("x_mm", "y_mm")
_POSE = (*_POINT, "depth_mm", "shear_x_mm", "shear_y_mm")
# Commanded poses that agree to a micrometre are one: it is far below what a rig can tell.
_RESOLUTION_MM = 1e-3


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


def draw_parts_in_strata(strata: np.ndarray, seed: int, shares: Shares) -> np.ndarray:
    """Return the part (m,) of frames or groups of which `strata` (m,) says what each belongs to.

    Every stratum is shuffled and laid out evenly over [0, 1), each from another start, and the shares cut there: each
    part has its share of every stratum, to one frame or group, and of all together.
    """
    random = random_stream(seed, "", "split")
    names, members = np.unique(strata, return_inverse=True)
    order = random.permutation(len(strata))
    place = np.empty(len(strata))
    for turn, stratum in enumerate(random.permutation(len(names))):
        own = order[members[order] == stratum]
        place[own] = (np.arange(len(own)) + (turn + 0.5) / len(names)) / len(own)
    return np.searchsorted(np.cumsum(shares)[:-1], place, side="right")


def split_frames(
    frames: LabelledFrames,
    by: str | None = None,
    seed: int = 0,
    shares: Shares = PAPER_SHARES,
    stratify_by: str | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the indices of the training, validation and test frames: disjoint, complete, each sorted.

    `given` takes what the data set states (column `split`), whatever seed and shares. `random` is the paper's; since
    neighbouring poses look alike, it lets a network see near-duplicates of its test frames. `point` keeps each contact
    point in one part; the name of a column, such as `clip` or `object`, keeps all frames of equal value in one part. By
    default a split is given where the data set states one, and else random. With `stratify_by`, a column too, each part
    gets its share of every value of that column.

    Raises
    ------
    ValueError
        If the data set lacks what is asked for, or a part with a positive share would be empty, or a group would be
        split by the strata.
    """
    (parts,) = _parts([frames], by, seed, [shares], stratify_by)
    train, validation, test = (np.flatnonzero(parts == part) for part in range(len(PARTS)))
    return train, validation, test


def split_domains(
    source: LabelledFrames,
    target: LabelledFrames,
    by: str | None = None,
    seed: int = 0,
    shares: Shares = PAPER_SHARES,
    held_out: float = 0.1,
    stratify_by: str | None = None,
    is_labelled: np.ndarray | None = None,
) -> DomainSplit:
    """Split a source into training and held-out frames, and a target into training, validation and test frames.

    Each domain is divided as `split_frames` divides it. By `point` or a column, the split is shared: a group that both
    domains have is in the same part of both, and the source's held-out groups are at least the target's test groups, so
    that no group of a test frame was trained on; so are the test frames of a domain that is source and target. Groups
    that only one of the domains has are divided by themselves.

    Parameters
    ----------
    source, target
        The domains.
    by, seed, shares, stratify_by
        As for `split_frames`; the shares are the target's.
    held_out
        Share of the source that is held out. A source that states its split holds out its test part, or nothing if this
        share is 0.
    is_labelled
        Which frames (m,) of the target have labels; by default all. A target without any is trained on as a whole.
        Where some have and the split is at random, the training part takes its share from the frames without labels
        first, and the others are test frames: there is no validation part.

    Raises
    ------
    ValueError
        As `split_frames`, or if no frame with labels is in the target's test part.
    """
    if by not in (None, "random", "given") or source.digest == target.digest:
        held_out = max(held_out, shares[_TEST])
    source_shares = 1 - held_out, 0.0, held_out
    labelled = np.arange(len(target)) if is_labelled is None else np.flatnonzero(is_labelled)
    is_random = by == "random" or (by is None and "split" not in target.columns)
    of_target = np.full(len(target), _TRAIN)
    if len(labelled) == 0:
        (of_source,) = _parts([source], by, seed, [source_shares], stratify_by)
    elif len(labelled) == len(target) or not is_random:
        of_source, of_target = _parts([source, target], by, seed, [source_shares, shares], stratify_by)
        if not (of_target[labelled] == _TEST).any():
            raise ValueError(
                f"data set {target.name}: none of its {len(labelled)} frames with labels is in the test part; take "
                "another seed, or split at random"
            )
    else:
        unlabelled = len(target) - len(labelled)
        needed = max(0, int(shares[_TRAIN] * len(target)) - unlabelled) / len(labelled)
        both, own_shares = [source, target.take(labelled)], (needed, 0.0, 1 - needed)
        of_source, of_target[labelled] = _parts(both, by, seed, [source_shares, own_shares], stratify_by)
    is_held_out = (of_source == _TEST) & (held_out > 0)
    return DomainSplit(
        source_train=np.flatnonzero(~is_held_out),
        source_held_out=np.flatnonzero(is_held_out),
        target_train=np.flatnonzero(of_target == _TRAIN),
        target_validation=np.flatnonzero(of_target == _VALIDATION),
        target_test=np.flatnonzero(of_target == _TEST),
    )


def _parts(
    domains: Sequence[LabelledFrames],
    by: str | None,
    seed: int,
    shares: Sequence[Shares],
    stratify_by: str | None,
) -> list[np.ndarray]:
    """Return the part (n,) of each domain's frames, with shares per domain."""
    for own in shares:
        if len(own) != 3 or min(own) < 0 or abs(sum(own) - 1) > 1e-9:
            raise ValueError(f"shares = {tuple(own)}: must be three numbers in [0, 1] that add up to 1")
    if by == "point":
        return _parts_by_group(domains, contact_points(*domains), "contact points", seed, shares, stratify_by)
    if by not in (None, *WAYS):
        groups = _groups(domains, by, "split_by", f"known: {', '.join(WAYS)}, or a column")
        return _parts_by_group(domains, groups, f"groups ({by})", seed, shares, stratify_by)
    found = []
    for frames, own in zip(domains, shares, strict=True):
        if by == "given" or (by is None and "split" in frames.columns):
            found.append(_stated_parts(frames, stratify_by))
        elif stratify_by is None:
            # Frames that did not converge are drawn too: a seed gives the same part whichever are left out.
            drawn = draw_parts(len(frames) + frames.unconverged, seed, own)
            found.append(drawn[frames.columns["frame_id"]] if frames.unconverged else drawn)
            _check_filled(frames, found[-1], own, f"{len(frames)} frames")
        else:
            each = [np.arange(len(frames))]
            found += _parts_by_group([frames], each, "frames", seed, [own], stratify_by)
    return found


def _parts_by_group(
    domains: Sequence[LabelledFrames],
    groups: Sequence[np.ndarray],
    called: str,
    seed: int,
    shares: Sequence[Shares],
    stratify_by: str | None,
) -> list[np.ndarray]:
    """As `_parts`, of frames with numbers of groups (n,); those that both domains have are drawn by themselves."""
    count = int(np.concatenate(groups).max()) + 1
    known_to = np.stack([np.isin(np.arange(count), own) for own in groups])
    shared = known_to.all(axis=0)
    strata = None if stratify_by is None else _strata_of(domains, groups, stratify_by)
    found = []
    for frames, own_groups, known, own_shares in zip(domains, groups, known_to, shares, strict=True):
        parts = np.empty(count, dtype=np.int64)
        for same in (shared, known & ~shared):
            if strata is None:
                parts[same] = draw_parts(int(same.sum()), seed, own_shares)
            else:
                parts[same] = draw_parts_in_strata(strata[same], seed, own_shares)
        found.append(parts[own_groups])
        _check_filled(frames, found[-1], own_shares, f"{len(np.unique(own_groups))} {called}")
    return found


def _groups(domains: Sequence[LabelledFrames], column: str, what: str, known: str) -> tuple[np.ndarray, ...]:
    """Return the number (n,) of each frame's group, from 0; equal values of a column are one group, across domains."""
    for frames in domains:
        if column not in frames.columns:
            has = [name for name, values in frames.columns.items() if values.dtype.kind in "iuOU"]
            raise ValueError(
                f"{what} = {quoted(column)}: data set {frames.name} has no such column; {known}, such as "
                f"{', '.join(has)}"
            )
    return _numbered([frames.columns[column].astype(str) for frames in domains])


def _strata_of(domains: Sequence[LabelledFrames], groups: Sequence[np.ndarray], column: str) -> np.ndarray:
    """Return the stratum of each group; a ValueError if a group has frames of several."""
    strata = np.concatenate(_groups(domains, column, "stratify_by", "take a column"))
    of_group = pd.Series(strata).groupby(np.concatenate(groups))
    if (is_mixed := of_group.nunique() > 1).any():
        named = " and ".join(frames.name for frames in domains)
        found = zip(domains, groups, strict=True)
        values = {str(value) for f, own in found for value in f.columns[column][own == is_mixed.idxmax()]}
        raise ValueError(
            f"data set {named}: a group that stays whole has more than one {column} ({', '.join(sorted(values))}): "
            "stratify by a column that is the same for all frames of a group, and give groups of two data sets "
            "different names"
        )
    return of_group.first().to_numpy()


def _stated_parts(frames: LabelledFrames, stratify_by: str | None) -> np.ndarray:
    if stratify_by is not None:
        raise ValueError(f"data set {frames.name} states its split: it cannot be stratified by {stratify_by}")
    if not {"train", "test"} <= set(frames.columns.get("split", ())) <= set(PARTS):
        raise ValueError(
            f"data set {frames.name} states no split into {', '.join(PARTS)}, with frames for training and tests; "
            "split by random, point or a column"
        )
    return np.array([PARTS.index(part) for part in frames.columns["split"]], dtype=np.int64)


def _check_filled(frames: LabelledFrames, parts: np.ndarray, shares: Shares, drawn: str) -> None:
    for part, (name, share) in enumerate(zip(PARTS, shares, strict=True)):
        if share > 0 and not (parts == part).any():
            raise ValueError(f"data set {frames.name}: {drawn} are too few for a {name} share of {share:g}")


def stated_split(frames: LabelledFrames) -> np.ndarray:
    """Return the part (n,) of each frame; without a stated split all are for training."""
    return frames.columns.get("split", np.full(len(frames), PARTS[0], dtype=object))


def indices_by_part(frames: LabelledFrames) -> dict[str, np.ndarray]:
    """Return the indices of the frames of each part that has any."""
    split = stated_split(frames)
    return {part: np.flatnonzero(split == part) for part in PARTS if (split == part).any()}


def contact_points(*domains: LabelledFrames) -> tuple[np.ndarray, ...]:
    """Return the number (n,) of each frame's contact point, from 0; equal numbers are one point, across the domains.

    A point is its commanded position, to 1 µm, where all domains state it, and else its `point_id`.

    Raises
    ------
    ValueError
        If a domain states neither.
    """
    return _numbered_contacts(domains, _POINT, ("point_id",), "split by random or given")


def paired_contacts(one: LabelledFrames, other: LabelledFrames) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of frames that show the same commanded contact in both data sets, in the first one's order.

    A contact is the commanded pose: point, depth and shear, to 1 µm; where a data set does not state them, the contact
    point's number and the contact class.

    Raises
    ------
    ValueError
        If a data set states neither.
    """
    numbers = ("point_id", "contact_class")
    first, second = _numbered_contacts((one, other), _POSE, numbers, "they cannot be paired")
    place = np.full(np.concatenate([first, second]).max(initial=-1) + 1, -1)
    place[second] = np.arange(len(second))
    paired = np.flatnonzero(place[first] >= 0)
    return paired, place[first[paired]]


def _numbered_contacts(
    domains: Sequence[LabelledFrames], places: Sequence[str], numbers: Sequence[str], otherwise: str
) -> tuple[np.ndarray, ...]:
    """Return the number (n,) of each frame's contact: by columns in mm where all state them, else by their numbers."""
    if all(name in frames.columns for frames in domains for name in places):
        steps = [frames.values_of(places) / _RESOLUTION_MM for frames in domains]
        return _numbered([np.rint(own).astype(np.int64) for own in steps])
    stated = [np.stack([getattr(frames, name) for name in numbers], axis=1) for frames in domains]
    for frames, own in zip(domains, stated, strict=True):
        if (own < 0).any():
            raise ValueError(
                f"data set {frames.name} does not say its contacts by {', '.join(places)}, nor by "
                f"{' and '.join(numbers)}: {otherwise}"
            )
    return _numbered(stated)


def _numbered(keys: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Return a number for each row, from 0 in sorted order; rows that are equal, in any of the arrays, share it."""
    numbers = np.unique(np.concatenate(keys), axis=0, return_inverse=True)[1].reshape(-1)
    return tuple(np.split(numbers, np.cumsum([len(rows) for rows in keys])[:-1]))
