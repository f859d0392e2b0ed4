"""The labels of a run: which ones, and one range for source and target."""

from collections.abc import Mapping, Sequence

from gelgap.domains.dataset import LabelledFrames
from gelgap.domains.label_notes import outside
from gelgap.domains.labels import (
    QUANTITIES,
    Labels,
    Range,
    check_names,
    covering,
    hull,
    known_labels,
    paper_range,
    usual_labels,
)


def labels_of_run(
    source: LabelledFrames,
    target: LabelledFrames,
    names: Sequence[str] | None = None,
    ranges: Mapping[str, Range] | None = None,
) -> tuple[Labels, tuple[str, ...]]:
    """Return the labels of a run with one range each for both domains, and sentences on what is unusual about them.

    A range is the given one, or else spans what the two data sets declare (the paper's for forces that neither
    declares). Where the source does not declare it, it is widened to cover the source's training labels. The target's
    labels never move it; that some lie beyond it is only said.

    Parameters
    ----------
    source, target
        The source's training frames, and frames of the target.
    names
        By default the axes of the force that both domains have, or without any all labels that both have.
    ranges
        Given ranges by label, in its unit.

    Raises
    ------
    ValueError
        If a name or range is wrong, a range is given for another label, or a domain lacks a label.
    """
    names = _chosen(source, target, names)
    ranges = dict(ranges or {})
    if stray := [name for name in ranges if name not in names]:
        raise ValueError(f"a range is given for {', '.join(stray)}, but the labels are {', '.join(names)}")
    found, notes = {}, []
    for name in names:
        declared = hull(frames.declared_range(name) for frames in (source, target)) or paper_range(name)
        found[name] = ranges.get(name) or declared
        if name not in ranges and (declared is None or not source.declares_ranges):
            found[name] = covering(source.columns[name], declared)
            if declared is not None and found[name] != declared:
                notes.append(
                    f"{_of(name, declared)} is widened to {_bounds(found[name])} by source {source.name}"
                )
    labels = Labels.of(found)
    for frames in (source, target):
        if count := int(outside(frames, labels).sum()):
            notes.append(
                f"{count} of {len(frames)} frames of {frames.name} have a label beyond the range ({labels}), which no "
                "prediction reaches: give a wider one"
            )
    return labels, tuple(notes)


def _chosen(source: LabelledFrames, target: LabelledFrames, names: Sequence[str] | None) -> tuple[str, ...]:
    if names is None:
        both = [name for name in known_labels(source.columns) if name in target.columns]
        if not both:
            raise ValueError(f"source and target share no label: {_has(source)}; {_has(target)}")
        return usual_labels(both)
    check_names(names)
    for frames in (source, target):
        if missing := [name for name in names if name not in frames.columns]:
            raise ValueError(f"data set {frames.name} has no label {', '.join(missing)}: {_has(frames)}")
    return tuple(names)


def _has(frames: LabelledFrames) -> str:
    return f"{frames.name} has {', '.join(known_labels(frames.columns))}"


def _of(name: str, bounds: Range) -> str:
    symbol, unit = QUANTITIES[name]
    return f"the range of {symbol}, {_bounds(bounds)} {unit},"


def _bounds(bounds: Range) -> str:
    return f"{bounds[0]:g} to {bounds[1]:g}"
