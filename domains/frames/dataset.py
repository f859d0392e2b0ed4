"""Labelled frames of one domain: in memory, some of them, with other labels, or several data sets as one."""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from gelgap.assets.checksums import sha256
from gelgap.domains.formats.pictures import encode_png, resized, without_markers
from gelgap.domains.frames.labels import (
    FORCE_COLUMNS,
    PAPER_FORCE_RANGE_N,
    PAPER_RANGES,
    QUANTITIES,
    Labels,
    Range,
    check_names,
    covering,
    hull,
    known_labels,
    usual_labels,
)

if TYPE_CHECKING:
    from torch import device as Device

    from gelgap.domains.frames.paired_frames import PairedFrames, Pairing

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
    """

    name: str
    columns: dict[str, np.ndarray]
    rest_pictures: Sequence[Callable[[], np.ndarray]]
    force_range_n: np.ndarray = np.array(PAPER_FORCE_RANGE_N)
    declares_ranges: bool = True
    n_classes: int = CONTACT_CLASSES
    notes: tuple[str, ...] = ()
    unconverged: int = 0

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
        from gelgap.domains.frames.paired_frames import PairedFrames

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
        **columns: np.ndarray,
    ):
        self.name, self.n_classes = name, n_classes
        self.force_range_n = np.asarray(force_range_n, float)
        self._images = images
        self.rest_pictures = [partial(np.asarray, reference)]
        numbers = {"contact_class": contact_class, "point_id": point_id}
        columns |= {label: values for label, values in numbers.items() if values is not None}
        if images.ndim != 4 or images.shape[3] != 3 or images.dtype != np.uint8:
            raise ValueError(
                f"domain {name}: images must be uint8 (n, h, w, 3), not {images.dtype} {images.shape}"
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
        found = hashlib.sha256(self.name.encode())
        for array in (self._images, self.reference, self.label_values, self.contact_class, self.point_id):
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
        self.name, self.notes, self.rest_pictures = whole.name, whole.notes, whole.rest_pictures
        self._reduced_references = whole._reduced_references
        self.force_range_n, self.declares_ranges = whole.force_range_n, whole.declares_ranges
        self.n_classes, self.labels = n_classes or whole.n_classes, labels or whole.labels
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


def labelled_frames(frames: LabelledFrames) -> LabelledFrames:
    """Return the frames that have all labels; the frames themselves where all have."""
    return frames if frames.is_labelled.all() else frames.take(np.flatnonzero(frames.is_labelled))


def force_classes(train: LabelledFrames, count: int) -> LabelledFrames:
    """Return training frames with `count` contact classes of equal size, by Fz, or by the first label without it.

    They are numbered from the lowest value. Frames of equal value are of one class, so fewer classes may be filled.

    Raises
    ------
    ValueError
        If there are fewer than two classes or more classes than frames.
    """
    if not 2 <= count <= len(train):
        raise ValueError(
            f"classes from force = {count}: must lie in [2, {len(train)}], the number of training frames"
        )
    names = train.labels.names
    values = train.label_values[:, names.index("fz_n") if "fz_n" in names else 0]
    inner = np.quantile(values, np.arange(1, count) / count)
    classes = np.searchsorted(inner, values, side="right")
    change = repr((train.labels, count)).encode() + train.label_values.tobytes() + classes.tobytes()
    return DerivedFrames(train, train.columns | {"contact_class": classes}, change, n_classes=count)


def labels_of_run(
    source: LabelledFrames,
    target: LabelledFrames,
    names: Sequence[str] | None = None,
    ranges: Mapping[str, Range] | None = None,
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
        By default the axes of the force that both domains have, or without any all labels that both have.
    ranges
        Given ranges by label, in its unit.

    Raises
    ------
    ValueError
        If a name or range is wrong, a range is given for another label, or a domain lacks a label.
    """
    if names is None:
        names = usual_labels(set(source.known_labels) & set(target.known_labels))
        if not names:
            has = (f"{f.name} has {', '.join(f.known_labels) or 'none'}" for f in (source, target))
            raise ValueError(f"source and target share no label: {'; '.join(has)}")
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
            [frames.reference_id for frames in domains],
            [len(frames.rest_pictures) for frames in domains],
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


def outside(frames: LabelledFrames, labels: Labels) -> np.ndarray:
    """Return which frames (n,) have a label outside its range; none that lacks it."""
    values = frames.values_of(labels.names)
    return np.any((values < labels.low) | (values > labels.high), axis=1)


def within_range(frames: LabelledFrames) -> LabelledFrames:
    """Return the frames that have all labels, and these within their ranges."""
    return frames.take(np.flatnonzero(frames.is_labelled & ~outside(frames, frames.labels)))
