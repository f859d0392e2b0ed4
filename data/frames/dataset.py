"""Labelled frames of one domain: in memory, some of them, or with other labels."""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from gelgap.assets.checksums import sha256
from gelgap.assets.pinhole import Pinhole
from gelgap.data.formats.pictures import encode_png, resized, without_markers
from gelgap.data.frames.labels import (
    FORCE_COLUMNS,
    PAPER_FORCE_RANGE_N,
    Labels,
    Range,
    covering,
    known_labels,
    usual_labels,
)

if TYPE_CHECKING:
    from torch import device as Device

    from gelgap.data.frames.paired_frames import PairedFrames, Pairing

CONTACT_CLASSES = 361
"""How many contact classes the paper's grid has: without contact, and 5 depths × 6 radii × 12 directions."""
_SHOWN_FRAMES, _SHOWN_PX = 6, 160


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

    def __repr__(self) -> str:
        labels = ", ".join(f"{name} {round(value, 4) + 0.0:g}" for name, value in self.labels.items())
        return f"Frame({self.image.shape[1]}×{self.image.shape[0]} px, {labels})"

    def _repr_png_(self) -> bytes:
        """Return the picture, which notebooks show."""
        return encode_png(self.image)


class LabelledFrames(ABC):
    """The frames of one domain: labels as `columns` (n,), pictures on demand; `take` gives some of them.

    Attributes
    ----------
    name
        The domain's.
    columns
        What is known of each frame, arrays (n,) by name. Some may be labels (`QUANTITIES`); NaN is a label that a frame
        does not have. `reference_id` says which of several reference pictures is a frame's own.
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
    rest_pictures
        Functions that read the reference pictures (h, w, 3), one or several.
    cameras
        The camera of each reference picture, which says how many mm a pixel shows; None where that is not known.
    owners
        The data set of each reference picture, where several are joined.
    """

    name: str
    columns: dict[str, np.ndarray]
    rest_pictures: Sequence[Callable[[], np.ndarray]]
    force_range_n: np.ndarray = np.array(PAPER_FORCE_RANGE_N)
    declares_ranges: bool = True
    n_classes: int = CONTACT_CLASSES
    notes: tuple[str, ...] = ()
    unconverged: int = 0
    owners: Sequence["LabelledFrames"] = ()

    @cached_property
    def cameras(self) -> Sequence[Pinhole | None]:
        """The camera of each reference picture."""
        return (None,)

    @cached_property
    def reference(self) -> np.ndarray:
        """The picture without contact, (h, w, 3) uint8; the first one where frames have references of their own."""
        return self.rest_pictures[0]()

    @property
    @abstractmethod
    def digest(self) -> str:
        """A hash that changes when the pictures change."""

    @abstractmethod
    def picture(self, index: int) -> np.ndarray:
        """Return one picture as stored, (h, w, 3) uint8 RGB."""

    @abstractmethod
    def load(self, size_px: tuple[int, int], markers: bool) -> np.ndarray:
        """Return all pictures (n, h, w, 3) uint8 of this width and height, or all with their markers filled in."""

    def images(self, size_px: int | tuple[int, int] | None = None, markers: bool = True) -> np.ndarray:
        """Return all pictures (n, h, w, 3) uint8, reduced to `size_px` (see `image_size_px`).

        Without `markers`, their markers are found and inpainted at the stored size.
        """
        return self.load(self.image_size_px(size_px), markers)

    def take(self, indices: np.ndarray) -> "LabelledFrames":
        """Return the frames with these indices, in this order."""
        rows = np.arange(len(self))[indices]
        columns = {name: values[rows] for name, values in self.columns.items()}
        return DerivedFrames(self, columns, rows.tobytes(), rows)

    @cached_property
    def members(self) -> "tuple[LabelledFrames, ...]":
        """The data sets that it is joined from; itself where it is one."""
        return (self,)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def __repr__(self) -> str:
        labels = ", ".join(known_labels(self.columns)) or "none"
        return f"{type(self).__name__}({self.name!r}, {len(self)} frames, labels {labels})"

    def _repr_png_(self) -> bytes | None:
        """Return some of the pictures side by side, which notebooks show."""
        if not len(self):
            return None
        shown = np.linspace(0, len(self) - 1, min(len(self), _SHOWN_FRAMES)).astype(int)
        height_px, own_px = self.picture(0).shape[:2]
        width_px = min(_SHOWN_PX, own_px)
        size_px = width_px, max(1, round(height_px * width_px / own_px))
        return encode_png(np.hstack([resized(self.picture(index), size_px) for index in shown]))

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

    @property
    def known_labels(self) -> tuple[str, ...]:
        """Names of the labels that at least one frame has."""
        return tuple(name for name in known_labels(self.columns) if not np.isnan(self.columns[name]).all())

    @cached_property
    def labels(self) -> Labels:
        """The labels with their ranges: the axes of the force that there are, or without any all other labels."""
        return Labels.of({name: self.label_range(name) for name in usual_labels(self.known_labels)})

    @property
    def is_labelled(self) -> np.ndarray:
        """Which frames (n,) have all labels."""
        return ~np.isnan(self.label_values).any(axis=1) & (len(self.labels) > 0)

    @cached_property
    def label_values(self) -> np.ndarray:
        """The labels (n, k), each in its unit."""
        return self.values_of(self.labels.names)

    def values_of(self, names: Sequence[str]) -> np.ndarray:
        """Return the values (n, k) of any labels; a ValueError where one is absent."""
        missing = [name for name in names if name not in self.columns]
        if missing:
            has = ", ".join(known_labels(self.columns)) or "none"
            raise ValueError(f"data set {self.name} has no label {', '.join(missing)}; its labels: {has}")
        if not names:
            return np.empty((len(self), 0))
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
        return self.columns.get("contact_class", np.full(len(self), -1))

    @property
    def point_id(self) -> np.ndarray:
        """Contact point (n,), −1 where the data set does not say."""
        return self.columns.get("point_id", np.full(len(self), -1))

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
        labels, values = self.labels, self.label_values
        if not labels:
            raise ValueError(f"domain {self.name} has no labels")
        wrong = ~((values >= labels.low) & (values <= labels.high))
        if wrong.any():
            frame, label = np.argwhere(wrong)[0]
            (symbol, unit), (low, high) = labels.quantities[label], labels.ranges[label]
            raise ValueError(
                f"domain {self.name}: {wrong.any(axis=1).sum()} of {len(self)} frames have a label outside the "
                f"declared range; first: frame {frame}, {symbol} = {values[frame, label]:.4g} {unit}, allowed "
                f"[{low:g}, {high:g}] {unit}; labels are never clipped: give a wider one (--range), or take out what "
                "is not a number"
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

    @property
    def reference_id(self) -> np.ndarray:
        """Which of `references_at` is a frame's own (n,)."""
        return self.columns.get("reference_id", np.zeros(len(self), np.int64))

    def references_at(self, size_px: int | tuple[int, int] | None = None, markers: bool = True) -> np.ndarray:
        """Return all reference pictures (r, h, w, 3) uint8 as `images` returns pictures; r is 1 unless frames differ.

        Without `markers`, their markers are inpainted.
        """
        size_px = self.image_size_px(size_px)
        if (size_px, markers) not in self._reduced_references:
            pictures = (read() if markers else without_markers(read()) for read in self.rest_pictures)
            reduced = np.stack([resized(picture, size_px) for picture in pictures])
            self._reduced_references[size_px, markers] = reduced
        return self._reduced_references[size_px, markers]

    @cached_property
    def _reduced_references(self) -> dict[tuple[tuple[int, int], bool], np.ndarray]:
        """What `references_at` has made; frames that are taken from others share theirs."""
        return {}

    def torch(
        self,
        size_px: int | tuple[int, int] | None = 64,
        pairing: "Pairing" = "channels",
        device: "Device | str" = "cpu",
        markers: bool = True,
    ) -> "PairedFrames":
        """Return a `torch.utils.data.Dataset` of normalised float pictures paired with the reference.

        Without `markers`, pictures and reference have their markers inpainted.
        """
        from gelgap.data.frames.paired_frames import PairedFrames

        return PairedFrames(
            self.images(size_px, markers),
            self.references_at(size_px, markers),
            self.label_values,
            self.contact_class,
            pairing,
            device,
            reference_id=self.reference_id,
        )


class ArrayFrames(LabelledFrames):
    """Labelled frames in memory.

    Parameters
    ----------
    images, reference
        (n, h, w, 3) and (h, w, 3) uint8 RGB.
    force_n
        (n, 3) N, or None where the labels are among the columns, or there are none.
    force_range_n, n_classes
        As in `LabelledFrames`.
    camera
        The camera that took them, where it is known.
    contact_class, point_id, **columns
        What else is known of each frame, (n,) each: `fz_n` (NaN: unlabelled), `x_mm`, `clip`, `split`, ….

    Raises
    ------
    ValueError
        If the arrays do not fit together.
    """

    def __init__(
        self,
        name: str,
        images: np.ndarray,
        reference: np.ndarray,
        force_n: np.ndarray | None,
        contact_class: np.ndarray | None = None,
        point_id: np.ndarray | None = None,
        *,
        force_range_n: np.ndarray = LabelledFrames.force_range_n,
        n_classes: int = CONTACT_CLASSES,
        camera: Pinhole | None = None,
        **columns: np.ndarray,
    ):
        self.name, self.n_classes, self.cameras = name, n_classes, (camera,)
        self.force_range_n = np.asarray(force_range_n, float)
        self._images = images = np.asarray(images)
        reference = np.asarray(reference)
        self.rest_pictures = [partial(np.asarray, reference)]
        force_n = None if force_n is None else np.asarray(force_n, float)
        further = columns | {"contact_class": contact_class, "point_id": point_id}
        columns = {label: np.asarray(values) for label, values in further.items() if values is not None}
        if images.ndim != 4 or images.shape[3] != 3 or not images.dtype == reference.dtype == np.uint8:
            raise ValueError(
                f"domain {name}: images must be uint8 (n, h, w, 3), not {images.dtype} {images.shape}, and the "
                f"reference uint8, not {reference.dtype}"
            )
        n, shape = len(images), images.shape[1:]
        expected = {"reference": shape, "force_n": (n, 3), "force_range_n": (3, 2)}
        given = {"reference": reference, "force_n": force_n, "force_range_n": self.force_range_n} | columns
        for label, values in given.items():
            if values is not None and values.shape != (needed := expected.get(label, (n,))):
                raise ValueError(f"domain {name}: {label} has shape {values.shape}; {n} images need {needed}")
        if not (np.diff(self.force_range_n) > 0).all():
            raise ValueError(f"domain {name}: force_range_n must be (3, 2) with lower < upper bounds")
        forces = {} if force_n is None else dict(zip(FORCE_COLUMNS, force_n.T, strict=True))
        self.columns = {"frame_id": np.arange(n)} | forces | columns

    @cached_property
    def digest(self) -> str:
        columns = {name: values.tolist() for name, values in self.columns.items()}
        found = hashlib.sha256(repr((self.name, self.cameras, columns)).encode())
        for array in (self._images, self.reference):
            found.update(np.ascontiguousarray(array).data)
        return found.hexdigest()

    def picture(self, index: int) -> np.ndarray:
        return self._images[index]

    def load(self, size_px: tuple[int, int], markers: bool) -> np.ndarray:
        if markers and size_px == self.size_px:
            return self._images
        shown = self._images if markers else map(without_markers, self._images)
        return np.stack([resized(picture, size_px) for picture in shown])


class DerivedFrames(LabelledFrames):
    """Frames of another data set, `whole`: those of `indices` (n,), in this order, or all with other columns or labels.

    References and declared ranges are the whole's. `change` says what differs, for the digest.
    """

    def __init__(
        self,
        whole: LabelledFrames,
        columns: dict[str, np.ndarray],
        change: bytes,
        indices: np.ndarray | None = None,
        labels: Labels | None = None,
        n_classes: int | None = None,
    ):
        self.whole, self.columns, self._change, self._indices = whole, columns, change, indices
        self.name, self.notes = whole.name, whole.notes
        self.rest_pictures, self.cameras, self.owners = whole.rest_pictures, whole.cameras, whole.owners
        self._reduced_references = whole._reduced_references
        self.force_range_n, self.declares_ranges = whole.force_range_n, whole.declares_ranges
        self.n_classes, self.labels = n_classes or whole.n_classes, whole.labels if labels is None else labels
        self.unconverged = whole.unconverged if indices is None else 0
        self._loaded: dict[tuple[tuple[int, int], bool], np.ndarray] = {}

    def declared_range(self, name: str) -> Range | None:
        return self.whole.declared_range(name)

    @cached_property
    def digest(self) -> str:
        return sha256(self.whole.digest.encode() + self._change)

    def picture(self, index: int) -> np.ndarray:
        return self.whole.picture(index if self._indices is None else int(self._indices[index]))

    def load(self, size_px: tuple[int, int], markers: bool) -> np.ndarray:
        if self._indices is None:
            return self.whole.load(size_px, markers)
        if (size_px, markers) not in self._loaded:
            self._loaded[size_px, markers] = self.whole.load(size_px, markers)[self._indices]
        return self._loaded[size_px, markers]


def with_labels(frames: LabelledFrames, labels: Labels) -> LabelledFrames:
    """Return the same frames with these labels in these ranges; the frames themselves where nothing changes.

    Raises
    ------
    ValueError
        If the data set lacks a label; the message names those that it has.
    """
    if labels == frames.labels:
        return frames
    change = repr((labels, None)).encode() + frames.values_of(labels.names).tobytes()
    return DerivedFrames(frames, frames.columns, change, labels=labels)


def pictures_alone(frames: LabelledFrames) -> LabelledFrames:
    """Return the same frames without labels, classes and poses: pictures, references and order in trajectories."""
    names = "frame_id", "reference_id", "trajectory_id", "step"
    kept = {name: frames.columns[name] for name in names if name in frames.columns}
    return DerivedFrames(frames, kept, b"pictures alone", labels=Labels((), ()))


def labelled_frames(frames: LabelledFrames) -> LabelledFrames:
    """Return the frames that have all labels; the frames themselves where all have."""
    return frames if frames.is_labelled.all() else frames.take(np.flatnonzero(frames.is_labelled))
