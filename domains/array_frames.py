"""Labelled frames in memory."""

import hashlib
from functools import cached_property

import numpy as np

from gelgap.domains.dataset import CONTACT_CLASSES, LabelledFrames
from gelgap.domains.labels import FORCE_COLUMNS, QUANTITIES, known_labels
from gelgap.domains.picture_codec import resized


class ArrayFrames(LabelledFrames):
    """Labelled frames in memory.

    Parameters
    ----------
    images, reference
        (n, h, w, 3) and (h, w, 3) uint8 RGB.
    force_n
        (n, 3) N, or None where the labels are among the columns.
    force_range_n, n_classes
        As in `LabelledFrames`.
    contact_class, point_id, **columns
        What else is known of each frame, (n,) each: `fz_n`, `x_mm`, `clip`, `split`, ….

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
        self._images, self._reference = images, reference
        stated = {"contact_class": contact_class, "point_id": point_id}
        columns |= {label: values for label, values in stated.items() if values is not None}
        self._check(force_n, columns)
        forces = {} if force_n is None else dict(zip(FORCE_COLUMNS, force_n.T, strict=True))
        self.columns = forces | columns
        if not known_labels(self.columns):
            raise ValueError(f"domain {name} has no label; known labels: {', '.join(QUANTITIES)}")

    def _check(self, force_n: np.ndarray | None, columns: dict[str, np.ndarray]) -> None:
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
        for label, values in (({} if force_n is None else {"force_n": force_n}) | columns).items():
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
        for array in (self._images, self._reference, self.label_values, self.contact_class, self.point_id):
            found.update(np.ascontiguousarray(array).data)
        return found.hexdigest()

    def picture(self, index: int) -> np.ndarray:
        return self._images[index]

    def images(self, size_px: int | tuple[int, int] | None = None) -> np.ndarray:
        size = self.image_size_px(size_px)
        if size == self.size_px:
            return self._images
        return np.stack([resized(image, size) for image in self._images])
