"""The frames of source and target, divided for training and judging, in one split and with the same labels."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gelgap.adapt.methods.base import Method
from gelgap.adapt.profile import Profile
from gelgap.domains import LabelledFrames, force_classes, labels_of_run, split_domains, with_labels

_SAME_ASPECT = 0.02
"""Aspects that differ by no more than this share are taken for the same."""


@dataclass(frozen=True)
class SplitFrames:
    """Two domains, divided: the network learns from the training frames and is judged on the others."""

    source_train: LabelledFrames
    source_held_out: LabelledFrames
    target_train: LabelledFrames
    target_validation: LabelledFrames
    target_test: LabelledFrames
    notes: tuple[str, ...] = ()

    @property
    def parts(self) -> dict[str, LabelledFrames]:
        """All five by name."""
        return {name: frames for name, frames in vars(self).items() if name != "notes"}


def split_for_training(
    source: LabelledFrames,
    target: LabelledFrames,
    profile: Profile,
    seed: int,
    *,
    labels: Sequence[str] | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    classes_from_force: int | None = None,
) -> SplitFrames:
    """Divide two domains as the profile says; no source frame is held out where it holds none out.

    Parameters
    ----------
    labels
        What is predicted; by default the axes of the force that both domains have.
    ranges
        Ranges of labels, by which both domains are normalised; by default `labels_of_run` finds them.
    classes_from_force
        Number of contact classes of equal size to give the source's training frames, by Fz or the first label.

    Raises
    ------
    ValueError
        If a part would be empty, a data set lacks what the profile splits by or a label, or a range is wrong.
    """
    split = split_domains(
        source,
        target,
        profile.split_by,
        seed,
        profile.target_split,
        profile.source_holdout,
        profile.stratify_by,
    )
    frames = SplitFrames(
        source_train=source.take(split.source_train),
        source_held_out=source.take(split.source_held_out),
        target_train=target.take(split.target_train),
        target_validation=target.take(split.target_validation),
        target_test=target.take(split.target_test),
    )
    common, notes = labels_of_run(frames.source_train, target, labels, ranges)
    frames = SplitFrames(
        **{name: with_labels(part, common) for name, part in frames.parts.items()}, notes=notes
    )
    if classes_from_force is None:
        return frames
    return replace(frames, source_train=force_classes(frames.source_train, classes_from_force))


def size_notes(source: LabelledFrames, target: LabelledFrames, profile: Profile) -> tuple[str, ...]:
    """Return a sentence for each source whose pictures have another aspect, so that training squeezes one.

    Raises
    ------
    ValueError
        If the pictures of one have fewer pixels than training shows.
    """
    for frames in (source, target):
        frames.references_at(profile.image_size_px)
    (width, height), (w1, h1) = profile.image_size_px, target.size_px
    found = []
    for frames in source.members:
        w0, h0 = frames.size_px
        if abs(w0 * h1 / (h0 * w1) - 1) > _SAME_ASPECT:
            found.append(
                f"pictures of {frames.name} are {w0}×{h0} px and those of {target.name} {w1}×{h1} px: at "
                f"{width}×{height} px one is squeezed more than the other; crop them to one aspect"
            )
    return tuple(found)


def check_classes(name: str, method: Method | type[Method], source: LabelledFrames) -> None:
    """Raise a ValueError if a method needs contact classes, and frames of the source have none, or all the same."""
    if method.uses_classifier and not source.has_classes:
        raise ValueError(
            f"method {name} needs contact classes, and source {source.name} has frames without one: choose "
            "another method, classes from force (--classes from-force 12), or a source whose frames all have a class, "
            "as `gelgap generate` writes them on the paper's path"
        )
    if method.uses_classifier and len(np.unique(source.contact_class)) < 2:
        raise ValueError(
            f"method {name} needs source frames of at least 2 contact classes, and the {len(source)} of "
            f"{source.name} are of one: take more frames, or choose another method"
        )
