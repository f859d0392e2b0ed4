"""How far apart two configurations look: CIEDE2000 between their reference pictures."""

from dataclasses import dataclass

import numpy as np

from gelgap.render.renderer import MembraneRenderer


@dataclass(frozen=True)
class ColourGap:
    """Colour difference of two pictures over their pixels, CIEDE2000 (Sharma, Wu, Dalal 2005); about 1 is just seen."""

    mean: float
    median: float
    percentile_95: float


def picture_gap(one: np.ndarray, other: np.ndarray) -> ColourGap:
    """Return the colour gap of two uint8 (h, w, 3) sRGB pictures.

    Raises
    ------
    ValueError
        If their shapes differ.
    """
    from skimage.color import deltaE_ciede2000, rgb2lab

    if one.shape != other.shape:
        raise ValueError(f"pictures have shapes {one.shape} and {other.shape}; a gap needs equal ones")
    difference = deltaE_ciede2000(rgb2lab(one), rgb2lab(other))
    median, percentile_95 = np.percentile(difference, (50, 95))
    return ColourGap(float(difference.mean()), float(median), float(percentile_95))


def reference_gap(one: MembraneRenderer, other: MembraneRenderer, markers: bool = False) -> ColourGap:
    """Return the colour gap of two renderers' pictures of the undeformed membrane, without noise."""
    return picture_gap(one.reference(markers), other.reference(markers))
