"""Several data sets as one."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from gelgap.assets.checksums import sha256
from gelgap.data.frames.dataset import LabelledFrames
from gelgap.data.frames.labels import Range, hull, known_labels


def join_domains(domains: Sequence[LabelledFrames]) -> LabelledFrames:
    """Return the frames of several data sets, one after the other, as one; a single one is returned as it is.

    It has the columns that all of them have, and each frame keeps its own reference. Groups of the same name in two
    data sets are one group.

    Raises
    ------
    ValueError
        If there is none, or they share no label.
    """
    if not domains:
        raise ValueError("no data set was named; name one or several folders")
    return domains[0] if len(domains) == 1 else JoinedFrames(domains)


class JoinedFrames(LabelledFrames):
    """The frames of several data sets in order; its name is theirs with + between them, of many the first's."""

    def __init__(self, domains: Sequence[LabelledFrames]):
        self.members = tuple(domains)
        names = [frames.name for frames in domains]
        # Names of folders have at most 255 letters.
        self.name = "+".join(names if len(names) <= 3 else [names[0], f"{len(names) - 1}-more"])
        shared = [name for name in domains[0].columns if all(name in frames.columns for frames in domains)]
        if not known_labels(shared):
            raise ValueError(f"data sets {', '.join(names)} share no label")
        self.columns = {name: np.concatenate([frames.columns[name] for frames in domains]) for name in shared}
        self.columns["reference_id"] = _counted_on(
            [frames.reference_id for frames in domains], [len(frames.rest_pictures) for frames in domains]
        )
        # What was left out keeps its number: a split at random counts it.
        self.columns["frame_id"] = _counted_on(
            [f.columns["frame_id"] if f.unconverged else np.arange(len(f)) for f in domains],
            [len(frames) + frames.unconverged for frames in domains],
        )
        low, high = np.stack([np.asarray(frames.force_range_n, float) for frames in domains]).T
        self.force_range_n = np.stack([low.min(axis=1), high.max(axis=1)], axis=1)
        self.declares_ranges = all(frames.declares_ranges for frames in domains)
        self.n_classes = max(frames.n_classes for frames in domains)
        self.unconverged = sum(frames.unconverged for frames in domains)
        self.rest_pictures = [read for frames in domains for read in frames.rest_pictures]
        each = [own.owners or [own] * len(own.rest_pictures) for own in domains]
        self.owners = [owner for owners in each for owner in owners]
        self.cameras = [camera for frames in domains for camera in frames.cameras]
        self.notes = tuple(f"{frames.name}: {note}" for frames in domains for note in frames.notes)

    def declared_range(self, name: str) -> Range | None:
        return hull(frames.declared_range(name) for frames in self.members)

    @cached_property
    def digest(self) -> str:
        found = [(frames.name, frames.digest, len(frames)) for frames in self.members]
        return sha256(repr(found).encode())

    def picture(self, index: int) -> np.ndarray:
        index = range(len(self))[index]
        for frames in self.members:
            if index < len(frames):
                break
            index -= len(frames)
        return frames.picture(index)

    def load(self, size_px: tuple[int, int], markers: bool) -> np.ndarray:
        return np.concatenate([frames.load(size_px, markers) for frames in self.members])


def _counted_on(numbers: Sequence[np.ndarray], counts: Sequence[int]) -> np.ndarray:
    """Return numbers of several data sets, each from where those before it end."""
    starts = np.cumsum([0, *counts[:-1]])
    return np.concatenate([start + own for start, own in zip(starts, numbers, strict=True)])
