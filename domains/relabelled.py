"""Frames with other labels or contact classes than their data set has by itself."""

import hashlib
from functools import cached_property

import numpy as np

from gelgap.domains.dataset import DerivedFrames, LabelledFrames
from gelgap.domains.labels import Labels


def with_labels(frames: LabelledFrames, labels: Labels) -> LabelledFrames:
    """Return the same frames with these labels in these ranges; the frames themselves where nothing changes.

    Raises
    ------
    ValueError
        If the data set lacks a label; the message names those that it has.
    """
    return frames if labels == frames.labels else Relabelled(frames, labels=labels)


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
    return Relabelled(train, contact_class=np.searchsorted(inner, values, side="right"), n_classes=count)


class Relabelled(DerivedFrames):
    """The frames of `whole` with other `labels`, or with other contact classes (n,) of which there are `n_classes`."""

    def __init__(
        self,
        whole: LabelledFrames,
        labels: Labels | None = None,
        contact_class: np.ndarray | None = None,
        n_classes: int | None = None,
    ):
        super().__init__(whole)
        self.unconverged = whole.unconverged
        self.n_classes = n_classes or self.n_classes
        self.columns = (
            whole.columns if contact_class is None else whole.columns | {"contact_class": contact_class}
        )
        self.labels = labels or self.labels
        self._changed = repr((self.labels, n_classes)).encode()
        self._changed += self.label_values.tobytes() + (
            b"" if contact_class is None else contact_class.tobytes()
        )

    @cached_property
    def digest(self) -> str:
        return hashlib.sha256(self.whole.digest.encode() + self._changed).hexdigest()

    def picture(self, index: int) -> np.ndarray:
        return self.whole.picture(index)

    def images(self, size_px: int | tuple[int, int] | None = None) -> np.ndarray:
        return self.whole.images(size_px)

    def images_without_markers(self, size_px: int | tuple[int, int] | None = None) -> np.ndarray:
        return self.whole.images_without_markers(size_px)
