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
    range of 8 bits are cut. Pictures are reduced to `size_px`.

    Raises
    ------
    ValueError
        If domains declare different ranges or numbers of contact classes.
    """

    def __init__(self, name: str, domains: Sequence[LabelledFrames], size_px: tuple[int, int]):
        first = domains[0]
        for domain in domains[1:]:
            same = np.array_equal(domain.force_range_n, first.force_range_n)
            if not same or domain.n_classes != first.n_classes:
                raise ValueError(
                    f"{domain.name} declares forces {np.asarray(domain.force_range_n).tolist()} N and "
                    f"{domain.n_classes} classes, {first.name} others; they must be the same to be joined"
                )
        self._domains = tuple(domains)
        super().__init__(
            name,
            np.concatenate([_differences(d.images(size_px), d.reference, size_px) for d in domains]),
            np.full((size_px[1], size_px[0], 3), _GREY, np.uint8),
            np.concatenate([domain.force_n for domain in domains]),
            np.concatenate([domain.contact_class for domain in domains]),
            force_range_n=first.force_range_n,
            n_classes=first.n_classes,
        )

    def images_without_markers(self, size_px: int | tuple[int, int] | None = None) -> np.ndarray:
        """Return the differences of pictures from references that both have their markers inpainted."""
        size = self.size_px
        return np.concatenate(
            [
                _differences(d.images_without_markers(size), without_markers(d.reference), size)
                for d in self._domains
            ]
        )


def _differences(images: np.ndarray, reference: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
    difference = images.astype(np.int16) - resized(reference, size_px) + _GREY
    return difference.clip(0, 255).astype(np.uint8)
