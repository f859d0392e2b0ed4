"""The frames of source and target, divided for training and judging, in one split."""

from dataclasses import dataclass

import numpy as np

from gelgap.adapt.methods.base import Method
from gelgap.adapt.profile import Profile
from gelgap.domains import LabelledFrames, split_domains


@dataclass(frozen=True)
class SplitFrames:
    """Two domains, divided: the network learns from the training frames and is judged on the others."""

    source_train: LabelledFrames
    source_held_out: LabelledFrames
    target_train: LabelledFrames
    target_validation: LabelledFrames
    target_test: LabelledFrames


def split_for_training(
    source: LabelledFrames, target: LabelledFrames, profile: Profile, seed: int
) -> SplitFrames:
    """Divide two domains as the profile says; no source frame is held out where it holds none out.

    Raises
    ------
    ValueError
        If a part would be empty, or a data set lacks what the profile splits by.
    """
    split = split_domains(
        source, target, profile.split_by, seed, profile.target_split, profile.source_holdout
    )
    return SplitFrames(
        source_train=source.take(split.source_train),
        source_held_out=source.take(split.source_held_out),
        target_train=target.take(split.target_train),
        target_validation=target.take(split.target_validation),
        target_test=target.take(split.target_test),
    )


def check_same_size(source: LabelledFrames, target: LabelledFrames) -> None:
    """Raise a ValueError if the stored pictures of the two domains differ in size."""
    if source.size_px != target.size_px:
        raise ValueError(
            f"source {source.name} has {source.size_px[0]}×{source.size_px[1]} px pictures, target {target.name} "
            f"has {target.size_px[0]}×{target.size_px[1]} px; both domains must have one picture size"
        )


def check_classes(name: str, method: Method | type[Method], source: LabelledFrames) -> None:
    """Raise a ValueError if a method needs contact classes, and frames of the source have none, or all the same."""
    if method.uses_classifier and not source.has_classes:
        raise ValueError(
            f"method {name} needs contact classes, and source {source.name} has frames without one: choose another "
            "method, or a source whose frames all have a class, as `gelgap generate` writes them on the paper's path"
        )
    if method.uses_classifier and len(np.unique(source.contact_class)) < 2:
        raise ValueError(
            f"method {name} needs source frames of at least 2 contact classes, and the {len(source)} of "
            f"{source.name} are of one: take more frames, or choose another method"
        )
