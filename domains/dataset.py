"""The data set: labelled frames of one domain, and some frames of another."""

import hashlib
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from gelgap.domains.hidden_markers import without_markers
from gelgap.domains.labels import (
    FORCE_COLUMNS,
    PAPER_FORCE_RANGE_N,
    Labels,
    Range,
    covering,
    known_labels,
    usual_labels,
)
from gelgap.domains.picture_codec import resized

if TYPE_CHECKING:
    from torch import device as Device

    from gelgap.domains.paired_frames import PairedFrames, Pairing

CONTACT_CLASSES = 361
"""How many contact classes the paper's grid has: without contact, and 5 depths × 6 radii × 12 directions."""


@dataclass(frozen=True)
class Frame:
    """One labelled picture: `image` (h, w, 3) uint8 RGB, the contact's class and point (−1: none), and its labels.

    `labels` are by name, each in its unit; `force_n` (3,) N is None where an axis of the force is absent.
    """

    image: np.ndarray
    force_n: np.ndarray | None
    contact_class: int
    point_id: int
    labels: dict[str, float]


class LabelledFrames(ABC):
    """The frames of one domain: labels as `columns` (n,), pictures on demand; `take` gives some of them.

    Attributes
    ----------
    name
        The domain's.
    columns
        What is known of each frame, arrays (n,) by name; at least one of them is a label (`QUANTITIES`). `reference_id`
        says which of several reference pictures is a frame's own.
    force_range_n
        The range of each axis of the force, (3, 2) N.
    declares_ranges
        Whether the data set states these ranges; otherwise they were found in its frames.
    n_classes
        How many contact classes the labels may take.
    notes
        Sentences on what is unusual about the data set.
    unconverged
        How many frames were left out because the simulation did not converge.
    """

    name: str
    columns: dict[str, np.ndarray]
    force_range_n: np.ndarray = np.array(PAPER_FORCE_RANGE_N)
    declares_ranges: bool = True
    n_classes: int = CONTACT_CLASSES
    notes: tuple[str, ...] = ()
    unconverged: int = 0

    @property
    @abstractmethod
    def reference(self) -> np.ndarray:
        """The picture without contact, (h, w, 3) uint8; the first one where frames have references of their own."""

    @property
    @abstractmethod
    def digest(self) -> str:
        """A hash that changes when the pictures change."""

    @abstractmethod
    def picture(self, index: int) -> np.ndarray:
        """Return one picture as stored, (h, w, 3) uint8 RGB."""

    @abstractmethod
    def images(self, size_px: int | tuple[int, int] | None = None) -> np.ndarray:
        """Return all pictures (n, h, w, 3) uint8, reduced to `size_px` (see `image_size_px`)."""

    def images_without_markers(self, size_px: int | tuple[int, int] | None = None) -> np.ndarray:
        """Return what `images` does, of pictures whose markers are found and inpainted at the stored size."""
        size = self.image_size_px(size_px)
        pictures = (without_markers(self.picture(index)) for index in range(len(self)))
        return np.stack([resized(picture, size) for picture in pictures])

    def take(self, indices: np.ndarray) -> "LabelledFrames":
        """Return the frames with these indices, in this order."""
        return FrameSubset(self, indices)

    @property
    def members(self) -> "tuple[LabelledFrames, ...]":
        """The data sets that it is joined from; itself where it is one."""
        return (self,)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def __getitem__(self, index: int) -> Frame:
        index = range(len(self))[index]
        known = known_labels(self.columns)
        return Frame(
            image=self.picture(index),
            force_n=self.force_n[index] if set(FORCE_COLUMNS) <= set(known) else None,
            contact_class=int(self.contact_class[index]),
            point_id=int(self.point_id[index]),
            labels={name: float(self.columns[name][index]) for name in known},
        )

    @cached_property
    def force_n(self) -> np.ndarray:
        """Forces (n, 3) in N; a ValueError where an axis is absent."""
        return self.values_of(FORCE_COLUMNS)

    @cached_property
    def labels(self) -> Labels:
        """The labels with their ranges: the axes of the force that there are, or without any all other labels."""
        return Labels.of({name: self.label_range(name) for name in usual_labels(self.columns)})

    @cached_property
    def label_values(self) -> np.ndarray:
        """The labels (n, k), each in its unit."""
        return self.values_of(self.labels.names)

    def values_of(self, names: tuple[str, ...]) -> np.ndarray:
        """Return the values (n, k) of any labels; a ValueError where one is absent."""
        missing = [name for name in names if name not in self.columns]
        if missing:
            has = ", ".join(known_labels(self.columns)) or "none"
            raise ValueError(f"data set {self.name} has no label {', '.join(missing)}; its labels: {has}")
        return np.stack([self.columns[name] for name in names], axis=1)

    def label_range(self, name: str) -> Range:
        """Return the range of a label by itself: of a force `force_range_n`, of others what covers the frames'."""
        if name not in FORCE_COLUMNS:
            return covering(self.columns[name], None)
        low, high = np.asarray(self.force_range_n, float)[FORCE_COLUMNS.index(name)].tolist()
        return low, high

    def declared_range(self, name: str) -> Range | None:
        """Return the range that the data set states for a label; None if it states none."""
        return self.label_range(name) if self.declares_ranges and name in FORCE_COLUMNS else None

    @property
    def contact_class(self) -> np.ndarray:
        """Contact class (n,), 0 without contact, −1 where the data set does not say."""
        return self._integers("contact_class")

    @property
    def point_id(self) -> np.ndarray:
        """Contact point (n,), −1 where the data set does not say."""
        return self._integers("point_id")

    def _integers(self, column: str) -> np.ndarray:
        return self.columns.get(column, np.full(len(self), -1))

    @property
    def has_classes(self) -> bool:
        """Whether every frame has a contact class."""
        return bool((self.contact_class >= 0).all())

    def check_labels(self) -> None:
        """Check that every label is a number in its range, and every contact class is one or −1.

        Raises
        ------
        ValueError
            If one does not; the message names the first such frame.
        """
        low, high = self.labels.low, self.labels.high
        values = self.label_values
        outside = ~((values >= low) & (values <= high))
        if outside.any():
            frame, label = np.argwhere(outside)[0]
            value, (symbol, unit) = values[frame, label], self.labels.quantities[label]
            bounds = f"[{low[label]:g}, {high[label]:g}] {unit}"
            what = "a force" if set(self.labels.names) <= set(FORCE_COLUMNS) else "a label"
            wrong, advice = "that is not a number", "take such frames out"
            if np.isfinite(value):
                wrong, advice = (
                    "outside the declared range",
                    "labels are never clipped: give a wider one (--range)",
                )
            raise ValueError(
                f"domain {self.name}: {outside.any(axis=1).sum()} of {len(self)} frames have {what} {wrong}; "
                f"first: frame {frame}, {symbol} = {value:.4g} {unit}, allowed {bounds}; {advice}"
            )
        classes = self.contact_class
        if len(self) and not (classes.min() >= -1 and classes.max() < self.n_classes):
            raise ValueError(
                f"domain {self.name}: contact_class spans {classes.min()}…{classes.max()}, "
                f"allowed 0…{self.n_classes - 1} (−1: unknown)"
            )

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the pictures as stored."""
        return self.reference.shape[1], self.reference.shape[0]

    def image_size_px(self, size_px: int | tuple[int, int] | None) -> tuple[int, int]:
        """Return (width, height): a number is the longer side, with the pictures' own aspect; None is as stored."""
        if size_px is None:
            return self.size_px
        if not isinstance(size_px, int):
            width, height = size_px
            return int(width), int(height)
        longest = max(self.size_px)
        width, height = (max(1, round(side * size_px / longest)) for side in self.size_px)
        return width, height

    def reference_at(self, size_px: int | tuple[int, int] | None = None) -> np.ndarray:
        """Return the reference picture as `images` returns pictures."""
        return resized(self.reference, self.image_size_px(size_px))

    @property
    def reference_id(self) -> np.ndarray:
        """Which of `references_at` is a frame's own (n,)."""
        return self.columns.get("reference_id", np.zeros(len(self), np.int64))

    @property
    def reference_count(self) -> int:
        """How many reference pictures there are."""
        return 1

    def references_at(self, size_px: int | tuple[int, int] | None = None, markers: bool = True) -> np.ndarray:
        """Return all reference pictures (r, h, w, 3) uint8 as `images` returns pictures; r is 1 unless frames differ.

        Without `markers`, their dots are inpainted.
        """
        reference = self.reference if markers else without_markers(self.reference)
        return resized(reference, self.image_size_px(size_px))[None]

    def torch(
        self,
        size_px: int | tuple[int, int] | None = 64,
        pairing: "Pairing" = "channels",
        device: "Device | str" = "cpu",
        markers: bool = True,
    ) -> "PairedFrames":
        """Return a `torch.utils.data.Dataset` of normalised float pictures paired with the reference.

        Without `markers`, pictures and reference have their dots inpainted.
        """
        from gelgap.domains.paired_frames import PairedFrames

        return PairedFrames(
            self.images(size_px) if markers else self.images_without_markers(size_px),
            self.references_at(size_px, markers),
            self.label_values,
            self.contact_class,
            pairing,
            device,
            reference_id=self.reference_id,
        )


class DerivedFrames(LabelledFrames):
    """Frames of another data set, `whole`, in part or changed; references and declared ranges are its."""

    def __init__(self, whole: LabelledFrames):
        self.whole = whole
        self.name, self.force_range_n, self.n_classes = whole.name, whole.force_range_n, whole.n_classes
        self.declares_ranges, self.labels, self.notes = whole.declares_ranges, whole.labels, whole.notes

    @property
    def reference(self) -> np.ndarray:
        return self.whole.reference

    @property
    def reference_count(self) -> int:
        return self.whole.reference_count

    def references_at(self, size_px: int | tuple[int, int] | None = None, markers: bool = True) -> np.ndarray:
        return self.whole.references_at(size_px, markers)

    def declared_range(self, name: str) -> Range | None:
        return self.whole.declared_range(name)


class FrameSubset(DerivedFrames):
    """Some frames of a data set, `whole`, in the order of `indices` (n,)."""

    def __init__(self, whole: LabelledFrames, indices: np.ndarray):
        super().__init__(whole)
        self.indices = np.arange(len(whole))[indices]
        self.columns = {name: values[self.indices] for name, values in whole.columns.items()}
        self._images: dict[tuple[int, int], np.ndarray] = {}
        self._without_markers: dict[tuple[int, int], np.ndarray] = {}

    @cached_property
    def digest(self) -> str:
        return hashlib.sha256(self.whole.digest.encode() + self.indices.tobytes()).hexdigest()

    def picture(self, index: int) -> np.ndarray:
        return self.whole.picture(int(self.indices[index]))

    def images(self, size_px: int | tuple[int, int] | None = None) -> np.ndarray:
        size = self.image_size_px(size_px)
        if size not in self._images:
            self._images[size] = self.whole.images(size)[self.indices]
        return self._images[size]

    def images_without_markers(self, size_px: int | tuple[int, int] | None = None) -> np.ndarray:
        size = self.image_size_px(size_px)
        if size not in self._without_markers:
            self._without_markers[size] = self.whole.images_without_markers(size)[self.indices]
        return self._without_markers[size]
