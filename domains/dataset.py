"""The data set: labelled frames of one domain, in memory, on disk, or some frames of another."""

import hashlib
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from gelgap.domains.hidden_markers import without_markers
from gelgap.domains.picture_codec import resized

if TYPE_CHECKING:
    from torch import device as Device

    from gelgap.domains.paired_frames import PairedFrames, Pairing

PAPER_FORCE_RANGE_N = ((-0.75, 0.75), (-0.75, 0.75), (-3.0, 0.0))
"""The paper's fixed ranges of Fx, Fy, Fz in N, by which forces are normalised."""

CONTACT_CLASSES = 361
"""How many contact classes the paper's grid has: without contact, and 5 depths × 6 radii × 12 directions."""

FORCE_COLUMNS = ("fx_n", "fy_n", "fz_n")


@dataclass(frozen=True)
class Frame:
    """One labelled picture: `image` (h, w, 3) uint8 RGB, `force_n` (3,), the contact's class and point (−1: none)."""

    image: np.ndarray
    force_n: np.ndarray
    contact_class: int
    point_id: int


class LabelledFrames(ABC):
    """The frames of one domain: labels as `columns` (n,), pictures on demand; `take` gives some of them.

    Attributes
    ----------
    name
        The domain's.
    columns
        What is known of each frame, arrays (n,) by name; always `fx_n`, `fy_n` and `fz_n`.
    force_range_n
        Which forces the data set declares, (3, 2) N.
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
    n_classes: int = CONTACT_CLASSES
    notes: tuple[str, ...] = ()
    unconverged: int = 0

    @property
    @abstractmethod
    def reference(self) -> np.ndarray:
        """The picture without contact, (h, w, 3) uint8."""

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

    def __len__(self) -> int:
        return len(self.columns["fz_n"])

    def __getitem__(self, index: int) -> Frame:
        index = range(len(self))[index]
        return Frame(
            image=self.picture(index),
            force_n=self.force_n[index],
            contact_class=int(self.contact_class[index]),
            point_id=int(self.point_id[index]),
        )

    @cached_property
    def force_n(self) -> np.ndarray:
        """Forces (n, 3) in N."""
        return np.stack([self.columns[name] for name in FORCE_COLUMNS], axis=1)

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
        """Check that every force lies in the declared range and every label is a contact class or −1.

        Raises
        ------
        ValueError
            If one does not; the message names the first such frame.
        """
        low, high = np.asarray(self.force_range_n, float).T
        outside = ~((self.force_n >= low) & (self.force_n <= high))
        if outside.any():
            frame, axis = np.argwhere(outside)[0]
            raise ValueError(
                f"domain {self.name}: {outside.any(axis=1).sum()} of {len(self)} frames have a force outside "
                f"the declared range; first: frame {frame}, F{'xyz'[axis]} = "
                f"{self.force_n[frame, axis]:.4g} N, allowed [{low[axis]:g}, {high[axis]:g}] N; "
                f"labels are never clipped"
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

        reference = self.reference if markers else without_markers(self.reference)
        return PairedFrames(
            self.images(size_px) if markers else self.images_without_markers(size_px),
            resized(reference, self.image_size_px(size_px)),
            self.force_n,
            self.contact_class,
            pairing,
            device,
        )


class ArrayFrames(LabelledFrames):
    """Labelled frames in memory.

    Parameters
    ----------
    images, reference
        (n, h, w, 3) and (h, w, 3) uint8 RGB.
    force_n
        (n, 3) N.
    force_range_n, n_classes
        As in `LabelledFrames`.
    contact_class, point_id, **columns
        What else is known of each frame, (n,) each: `x_mm`, `y_mm`, `split`, ….

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
        force_n: np.ndarray,
        contact_class: np.ndarray | None = None,
        point_id: np.ndarray | None = None,
        *,
        force_range_n: np.ndarray = LabelledFrames.force_range_n,
        n_classes: int = CONTACT_CLASSES,
        **columns: np.ndarray,
    ):
        self.name, self.n_classes = name, n_classes
        self.force_range_n = np.asarray(force_range_n, float)
        self._images, self._reference = images, reference
        stated = {"contact_class": contact_class, "point_id": point_id}
        columns |= {label: values for label, values in stated.items() if values is not None}
        self._check(force_n, columns)
        self.columns = {label: force_n[:, axis] for axis, label in enumerate(FORCE_COLUMNS)} | columns

    def _check(self, force_n: np.ndarray, columns: dict[str, np.ndarray]) -> None:
        images, n = self._images, len(self._images)
        if images.ndim != 4 or images.shape[3] != 3 or images.dtype != np.uint8:
            raise ValueError(
                f"domain {self.name}: images must be uint8 (n, h, w, 3), not {images.dtype} {images.shape}"
            )
        if self._reference.shape != images.shape[1:]:
            raise ValueError(
                f"domain {self.name}: the reference picture is {self._reference.shape}, the images are "
                f"{images.shape[1:]}; they must have one size"
            )
        for label, values in {"force_n": force_n, **columns}.items():
            expected = (n, 3) if label == "force_n" else (n,)
            if values.shape != expected:
                raise ValueError(
                    f"domain {self.name}: {label} has shape {values.shape}; {n} images need {expected}"
                )
        if self.force_range_n.shape != (3, 2) or not (np.diff(self.force_range_n) > 0).all():
            raise ValueError(f"domain {self.name}: force_range_n must be (3, 2) with lower < upper bounds")

    @property
    def reference(self) -> np.ndarray:
        return self._reference

    @cached_property
    def digest(self) -> str:
        found = hashlib.sha256(self.name.encode())
        for array in (self._images, self._reference, self.force_n, self.contact_class, self.point_id):
            found.update(np.ascontiguousarray(array).data)
        return found.hexdigest()

    def picture(self, index: int) -> np.ndarray:
        return self._images[index]

    def images(self, size_px: int | tuple[int, int] | None = None) -> np.ndarray:
        size = self.image_size_px(size_px)
        if size == self.size_px:
            return self._images
        return np.stack([resized(image, size) for image in self._images])


class FrameSubset(LabelledFrames):
    """Some frames of a data set, `whole`, in the order of `indices` (n,)."""

    def __init__(self, whole: LabelledFrames, indices: np.ndarray):
        self.whole = whole
        self.indices = np.arange(len(whole))[indices]
        self.name, self.force_range_n, self.n_classes = whole.name, whole.force_range_n, whole.n_classes
        self.notes = whole.notes
        self.columns = {name: values[self.indices] for name, values in whole.columns.items()}
        self._images: dict[tuple[int, int], np.ndarray] = {}
        self._without_markers: dict[tuple[int, int], np.ndarray] = {}

    @property
    def reference(self) -> np.ndarray:
        return self.whole.reference

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
