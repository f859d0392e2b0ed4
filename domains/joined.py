"""Several data sets as one: sources that are trained on together."""

import hashlib
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from gelgap.domains.dataset import LabelledFrames
from gelgap.domains.labels import Range, hull, known_labels
from gelgap.domains.opening import open_domain

# Names of folders have at most 255 letters.
_MOST_NAMES = 3


def open_domains(folders: Path | str | Sequence[Path | str]) -> LabelledFrames:
    """Open a data set as `open_domain` does, or several, joined."""
    if isinstance(folders, Path | str):
        return open_domain(folders)
    return join_domains([open_domain(folder) for folder in folders])


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
        self._members = tuple(domains)
        names = [frames.name for frames in domains]
        self.name = "+".join(names if len(names) <= _MOST_NAMES else [names[0], f"{len(names) - 1}-more"])
        shared = [name for name in domains[0].columns if all(name in frames.columns for frames in domains)]
        if not known_labels(shared):
            raise ValueError(f"data sets {', '.join(names)} share no label")
        self.columns = {name: np.concatenate([frames.columns[name] for frames in domains]) for name in shared}
        self.columns["reference_id"] = _counted_on(
            [frames.reference_id for frames in domains], [frames.reference_count for frames in domains]
        )
        # What was left out keeps its number: a split at random counts it.
        self.columns["frame_id"] = _counted_on(
            [f.columns["frame_id"] if f.unconverged else np.arange(len(f)) for f in domains],
            [len(frames) + frames.unconverged for frames in domains],
        )
        ranges = np.stack([np.asarray(frames.force_range_n, float) for frames in domains])
        self.force_range_n = np.stack([ranges[..., 0].min(axis=0), ranges[..., 1].max(axis=0)], axis=1)
        self.declares_ranges = all(frames.declares_ranges for frames in domains)
        self.n_classes = max(frames.n_classes for frames in domains)
        self.unconverged = sum(frames.unconverged for frames in domains)
        self.notes = tuple(f"{frames.name}: {note}" for frames in domains for note in frames.notes)

    @property
    def members(self) -> tuple[LabelledFrames, ...]:
        return self._members

    @property
    def reference(self) -> np.ndarray:
        return self._members[0].reference

    @property
    def reference_count(self) -> int:
        return sum(frames.reference_count for frames in self._members)

    def references_at(self, size_px: int | tuple[int, int] | None = None, markers: bool = True) -> np.ndarray:
        size = self.image_size_px(size_px)
        return np.concatenate([frames.references_at(size, markers) for frames in self._members])

    def declared_range(self, name: str) -> Range | None:
        return hull(frames.declared_range(name) for frames in self._members)

    @cached_property
    def digest(self) -> str:
        found = [(frames.name, frames.digest, len(frames)) for frames in self._members]
        return hashlib.sha256(repr(found).encode()).hexdigest()

    def picture(self, index: int) -> np.ndarray:
        ends = np.cumsum([len(frames) for frames in self._members])
        number = int(np.searchsorted(ends, index, side="right"))
        return self._members[number].picture(index - int(ends[number]) + len(self._members[number]))

    def images(self, size_px: int | tuple[int, int] | None = None) -> np.ndarray:
        size = self.image_size_px(size_px)
        return np.concatenate([frames.images(size) for frames in self._members])

    def images_without_markers(self, size_px: int | tuple[int, int] | None = None) -> np.ndarray:
        size = self.image_size_px(size_px)
        return np.concatenate([frames.images_without_markers(size) for frames in self._members])


def _counted_on(numbers: Sequence[np.ndarray], counts: Sequence[int]) -> np.ndarray:
    """Return numbers of several data sets, each from where those before it end."""
    starts = np.cumsum([0, *counts[:-1]])
    return np.concatenate([start + own for start, own in zip(starts, numbers, strict=True)])
