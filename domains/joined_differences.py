"""Several domains as one data set in memory, each picture relative to the reference of its own domain."""

from collections.abc import Sequence

import numpy as np

from gelgap.domains.dataset import ArrayFrames, LabelledFrames
from gelgap.domains.hidden_markers import without_markers
from gelgap.domains.picture_codec import resized

_GREY = 128


class JoinedDifferences(ArrayFrames):
    """Frames of several domains in memory, each picture as its difference from its own domain's reference, on grey.

    A network that takes differences sees what it would see in each domain by itself; only differences beyond half the
    range of 8 bits are cut. Frames with a force outside the declared range are `left_out`.

    Raises
    ------
    ValueError
        If there are no frames within the range, or domains declare different ranges or numbers of contact classes.
    """

    def __init__(self, name: str, domains: Sequence[LabelledFrames], size_px: tuple[int, int]):
        low, high = np.asarray(domains[0].force_range_n, float).T
        for domain in domains[1:]:
            same = np.array_equal(domain.force_range_n, domains[0].force_range_n)
            if not same or domain.n_classes != domains[0].n_classes:
                raise ValueError(
                    f"{domain.name} declares forces {np.asarray(domain.force_range_n).tolist()} N and "
                    f"{domain.n_classes} classes, {domains[0].name} others; they must be the same to be joined"
                )
        inside = [((low <= domain.force_n) & (domain.force_n <= high)).all(axis=1) for domain in domains]
        self._parts = [
            domain.take(np.flatnonzero(kept)) for domain, kept in zip(domains, inside, strict=True)
        ]
        self.left_out = int(sum((~kept).sum() for kept in inside))
        if not sum(map(len, self._parts)):
            raise ValueError(f"{name}: no frame has a force within the declared range")
        self._size_px = size_px
        super().__init__(
            name,
            np.concatenate(
                [_differences(part.images(size_px), part.reference, size_px) for part in self._parts]
            ),
            np.full((size_px[1], size_px[0], 3), _GREY, np.uint8),
            np.concatenate([part.force_n for part in self._parts]),
            np.concatenate([part.contact_class for part in self._parts]),
            force_range_n=domains[0].force_range_n,
            n_classes=domains[0].n_classes,
        )

    def images_without_markers(self, size_px: int | tuple[int, int] | None = None) -> np.ndarray:
        """Return the differences of pictures from references that both have their markers inpainted."""
        return np.concatenate(
            [
                _differences(
                    part.images_without_markers(self._size_px), without_markers(part.reference), self._size_px
                )
                for part in self._parts
            ]
        )


def _differences(images: np.ndarray, reference: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
    difference = images.astype(np.int16) - resized(reference, size_px) + _GREY
    return difference.clip(0, 255).astype(np.uint8)
