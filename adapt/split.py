"""Two domains divided for a run: frames that are learnt from, and those that judge; what of them is unusual is said."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gelgap.adapt.data import check_turning, has_other_aspect
from gelgap.adapt.inputs import FEW_TO_FIT, FITTED, INPUTS, rest_markers
from gelgap.adapt.profile import Profile
from gelgap.data import LabelledFrames, split_domains, with_labels
from gelgap.data.frames.dataset import labelled_frames
from gelgap.data.frames.first_touch import TRAJECTORY, trajectory_of
from gelgap.data.frames.run_labels import force_classes, labelled_for_run, labels_of_run
from gelgap.data.frames.splits import DomainSplit
from gelgap.data.frames.stored import GeneratedDomain

FRAMES_SHOWN = 400
LEAST_SPAN = 0.5
"""Of the view's width and height that the input markers shows without a note."""


@dataclass(frozen=True)
class SplitFrames:
    """Two domains, divided: the network learns from the training frames and is judged on the others.

    The source's frames and the target's validation and test frames have all labels. A target without labels has
    training frames alone.
    """

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

    @property
    def shown(self) -> dict[str, LabelledFrames]:
        """Frames of `target` and `source` on which a model is looked at.

        They are the target's test frames, or without labels its training frames; and the source's held-out frames, or,
        if none are held out, the first 400 of its training frames.
        """
        trained_on = self.source_train.take(np.arange(len(self.source_train))[:FRAMES_SHOWN])
        return {
            "target": self.target_test if len(self.target_test) else self.target_train,
            "source": self.source_held_out if len(self.source_held_out) else trained_on,
        }


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

    Source frames without labels are left out. Target frames without labels are trained on, as `split_domains` says, and
    never tested on; the notes have their number.

    Parameters
    ----------
    labels
        What is predicted; by default what `labelled_for_run` finds.
    ranges
        Ranges of labels, by which both domains are normalised; by default `labels_of_run` finds them.
    classes_from_force
        Number of contact classes of equal size to give the source's training frames, by Fz or the first label.

    Raises
    ------
    ValueError
        If a part would be empty, a data set lacks what the profile splits by, the source lacks a label, a range is
        wrong, fewer than two target frames can be trained on, the target is a source too and its test frames would be
        trained on, or what is shown of trajectories is not possible (`check_trajectories`) or only partly labelled.
    """
    labelled, target, names = labelled_for_run(source, target, labels)
    is_labelled = ~np.isnan(target.values_of(names)).any(axis=1)
    split = split_domains(
        labelled,
        target,
        profile.split_by,
        seed,
        profile.target_split,
        profile.source_holdout,
        profile.stratify_by,
        is_labelled,
    )
    check_trajectories((labelled, target), split, profile, names)
    if profile.needs_trajectories:
        _check_wholly_labelled(source, names)
        _check_wholly_labelled(target, names)
    # Drawn anew for each, the parts of both differ.
    differ = profile.split_by in ("random", "given") and (len(source.members) > 1 or not is_labelled.all())
    if differ and target.digest in [member.digest for member in source.members]:
        raise ValueError(f"target {target.name} is a source too: split_by must be point or a column")
    source_train = labelled.take(split.source_train)
    target_train = target.take(split.target_train)
    if len(target_train) < 2:
        raise ValueError(
            f"target {target.name}: {len(target_train)} of {len(target)} pictures would be trained on; adaptation "
            "needs 2 or more"
        )
    common, of_ranges = labels_of_run(source_train, target, names, ranges)
    source_train = with_labels(source_train, common)
    if classes_from_force is not None:
        source_train = force_classes(source_train, classes_from_force)
    target_test = labelled_frames(with_labels(target.take(split.target_test), common))
    notes = _drawn_at_random(target, profile) if is_labelled.any() else []
    if len(labelled) < len(source):
        left_out = len(source) - len(labelled)
        notes.append(f"{left_out} of {len(source)} frames of {source.name} lack {', '.join(names)}: left out")
    if not is_labelled.all():
        notes.append(
            f"{is_labelled.sum()} of {len(target)} frames of {target.name} have {', '.join(names)}: "
            f"{len(target_train)} are trained on without them, {len(target_test)} are tested on"
        )
    return SplitFrames(
        source_train=source_train,
        source_held_out=with_labels(labelled.take(split.source_held_out), common),
        target_train=with_labels(target_train, common),
        target_validation=labelled_frames(with_labels(target.take(split.target_validation), common)),
        target_test=target_test,
        notes=(*notes, *of_ranges),
    )


def _drawn_at_random(target: LabelledFrames, profile: Profile) -> list[str]:
    """Say what of the target's frames a random split does not follow: a stated split, or clips of frames alike."""
    if profile.split_by != "random" or isinstance(target, GeneratedDomain):  # which is split at random itself
        return []
    ways = {"split": ("states a split", "given"), "clip": ("has clips, whose frames look alike", "clip")}
    return [
        f"{target.name} {what}, which split_by=random ignores; split_by={way} does not, where both domains have a "
        f"column {column}"
        for column, (what, way) in ways.items()
        if column in target.columns
    ]


def size_notes(source: LabelledFrames, target: LabelledFrames, profile: Profile) -> tuple[str, ...]:
    """Return a sentence for each source whose pictures have another aspect, so that training squeezes one.

    And one on maps that may not fit, and, for markers, for each domain of whose view less than half is shown.

    Raises
    ------
    ValueError
        If the pictures of one have fewer pixels than training shows, or no markers where these are shown.
    """
    for frames in (source, target):
        frames.references_at(profile.image_size_px)
        if profile.input == "markers":
            list(rest_markers(frames, profile.image_size_px, profile.marker_span_mm))
    (width, height), (w1, h1) = profile.image_size_px, target.size_px
    sizes = [(frames.name, *frames.size_px) for frames in source.members]
    notes = [
        f"pictures of {name} are {w0}×{h0} px and those of {target.name} {w1}×{h1} px: at {width}×{height} px one is "
        "squeezed more than the other; crop them to one aspect"
        for name, w0, h0 in sizes
        if has_other_aspect((w0, h0), (w1, h1))
    ]
    few = [
        domain for domain in (*source.members, target) if profile.input in FITTED and len(domain) < FEW_TO_FIT
    ]
    notes += [
        f"input {profile.input}: a map by {len(domain)} pictures of {domain.name} hardly fits"
        for domain in few
    ]
    if profile.input == "calibrated" and profile.colour_mixing:
        notes.append("input calibrated: colour_mixing turns slopes as if they were colours; set it to 0")
    if profile.input == "markers":
        notes += [note for frames in (*source.members, target) for note in _span_notes(frames, profile)]
    return tuple(notes)


def _span_notes(frames: LabelledFrames, profile: Profile) -> Iterator[str]:
    if (camera := frames.cameras[0]) is None:
        return
    span_mm = profile.marker_span_mm
    view_mm = camera.footprint_mm(frames.size_px)
    if min(np.divide(span_mm, view_mm)) < LEAST_SPAN:
        yield (
            f"input markers shows {span_mm[0]:g}×{span_mm[1]:g} mm of {frames.name} (marker_span_mm), whose pictures "
            f"show {view_mm[0]:.1f}×{view_mm[1]:.1f} mm: what moves beyond is not seen"
        )


def check_trajectories(
    domains: Sequence[LabelledFrames], split: DomainSplit, profile: Profile, names: Sequence[str]
) -> None:
    """Check that trajectories are known, one is as long as what is shown of it, and none is divided by the split.

    Raises
    ------
    ValueError
        If one of this is not so, or labels of these names cannot be read from dents that are turned; the message names
        data set and trajectory.
    """
    if not profile.needs_trajectories:
        return
    from_touch = INPUTS[profile.input].from_touch
    if from_touch:
        check_turning(names)
    for frames, parts in zip(domains, (split[:2], split[2:]), strict=True):
        trajectory = trajectory_of(frames)
        longest = int(np.bincount(trajectory).max())
        if longest < profile.sequence_length:
            raise ValueError(
                f"sequence_length = {profile.sequence_length}: the longest trajectory of {frames.name} has {longest} "
                f"frames; it must be 1 to {longest}"
            )
        if from_touch and longest == 1:
            raise ValueError(
                f"input {profile.input}: each trajectory of {frames.name} has one frame; it needs those from first "
                "touch on"
            )
        seen = np.concatenate([np.unique(trajectory[rows]) for rows in parts])
        if len(divided := np.flatnonzero(np.bincount(seen) > 1)):
            number = frames.columns[TRAJECTORY][trajectory == divided[0]][0]
            raise ValueError(
                f"split_by = {profile.split_by!r} divides trajectory {number} of {frames.name}; a sequence needs it "
                f"whole: set split_by to point or {TRAJECTORY}"
            )


def _check_wholly_labelled(frames: LabelledFrames, names: Sequence[str]) -> None:
    """Check that frames of a trajectory have these labels all or none: those without would be missing before others."""
    lacks = np.isnan(frames.values_of(names)).any(axis=1)
    trajectory = trajectory_of(frames)
    if len(np.intersect1d(trajectory[lacks], trajectory[~lacks])):
        raise ValueError(f"{frames.name} has trajectories labelled in part: label all frames of one, or none")
