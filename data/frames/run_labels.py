"""The labels of a run: which ones two data sets share, in which ranges, and contact classes made from force."""

from collections.abc import Mapping, Sequence

import numpy as np

from gelgap.data.frames.dataset import DerivedFrames, LabelledFrames
from gelgap.data.frames.labels import (
    PAPER_RANGES,
    QUANTITIES,
    Labels,
    Range,
    check_names,
    covering,
    hull,
    usual_labels,
)


def labelled_for_run(
    source: LabelledFrames, target: LabelledFrames, names: Sequence[str] | None
) -> tuple[LabelledFrames, LabelledFrames, Sequence[str]]:
    """Return the source's frames with all labels of a run, the target with NaN for those it lacks, and their names.

    Without names these are the axes of the force that both domains have, or without any all labels that both have.
    Where they share none, they are the source's, and the target is unlabelled.

    Raises
    ------
    ValueError
        If a name is wrong, or no frame of the source has all these labels.
    """
    if names is None:
        names = usual_labels(set(source.known_labels) & set(target.known_labels) or source.known_labels)
    if names:
        check_names(names)
    is_labelled = ~np.isnan(source.values_of(names)).any(axis=1) & (len(names) > 0)
    if not is_labelled.any():
        wanted = " and ".join(names) or "a label"
        raise ValueError(f"source {source.name}: none of its {len(source)} frames has {wanted} to learn from")
    labelled = source if is_labelled.all() else source.take(np.flatnonzero(is_labelled))
    absent = {name: np.full(len(target), np.nan) for name in names if name not in target.columns}
    return labelled, DerivedFrames(target, target.columns | absent, b"") if absent else target, names


def labels_of_run(
    source: LabelledFrames, target: LabelledFrames, names: Sequence[str], ranges: Mapping[str, Range] | None
) -> tuple[Labels, tuple[str, ...]]:
    """Return the labels of a run with one range each for both domains, and sentences on what is unusual about them.

    A range is the given one, or else spans what the two data sets declare (the paper's for forces that neither
    declares); one without that label declares nothing. Where the source does not declare it, it is widened to cover
    the source's training labels. The target's labels never move it; that some lie beyond it is only said.

    Parameters
    ----------
    source, target
        The source's training frames, and frames of the target.
    names
        Of the labels.
    ranges
        Given ranges by label, in its unit.

    Raises
    ------
    ValueError
        If a name or range is wrong, a range is given for another label, or a domain lacks a label.
    """
    check_names(names)
    for frames in (source, target):
        frames.values_of(names)
    ranges = dict(ranges or {})
    if stray := [name for name in ranges if name not in names]:
        raise ValueError(f"a range is given for {', '.join(stray)}, but the labels are {', '.join(names)}")
    found, notes = {}, []
    for name in names:
        having = [frames for frames in (source, target) if name in frames.known_labels]
        declared = hull(frames.declared_range(name) for frames in having) or PAPER_RANGES.get(name)
        found[name] = ranges.get(name) or declared
        if name not in ranges and (declared is None or not source.declares_ranges):
            found[name] = covering(source.columns[name], declared)
            if declared is not None and found[name] != declared:
                (symbol, unit), (low, high) = QUANTITIES[name], found[name]
                notes.append(
                    f"the range of {symbol}, {declared[0]:g} to {declared[1]:g} {unit}, is widened to "
                    f"{low:g} to {high:g} by source {source.name}"
                )
    labels = Labels.of(found)
    for frames in (source, target):
        if count := int(outside(frames, labels).sum()):
            notes.append(
                f"{count} of {len(frames)} frames of {frames.name} have a label beyond the range ({labels}), which no "
                "prediction reaches: give a wider one"
            )
    return labels, tuple(notes)


def force_classes(train: LabelledFrames, count: int) -> LabelledFrames:
    """Return training frames with `count` contact classes of equal size, by Fz, or by the first label without it.

    They are numbered from the lowest value. Frames of equal value are of one class, so fewer classes may be filled.

    Raises
    ------
    ValueError
        If there are fewer than two classes or more classes than frames.
    """
    if not 2 <= count <= len(train):
        raise ValueError(f"classes from force = {count}: must lie in [2, {len(train)}], the training frames")
    names = train.labels.names
    values = train.label_values[:, names.index("fz_n") if "fz_n" in names else 0]
    inner = np.quantile(values, np.arange(1, count) / count)
    classes = np.searchsorted(inner, values, side="right")
    change = repr((train.labels, count)).encode() + train.label_values.tobytes() + classes.tobytes()
    return DerivedFrames(train, train.columns | {"contact_class": classes}, change, n_classes=count)


def outside(frames: LabelledFrames, labels: Labels) -> np.ndarray:
    """Return which frames (n,) have a label outside its range; none that lacks it."""
    values = frames.values_of(labels.names)
    return np.any((values < labels.low) | (values > labels.high), axis=1)


def within_range(frames: LabelledFrames) -> LabelledFrames:
    """Return the frames that have all labels, and these within their ranges."""
    return frames.take(np.flatnonzero(frames.is_labelled & ~outside(frames, frames.labels)))
