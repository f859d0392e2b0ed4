"""From where the light of each colour comes, as presses show it: a dent is brighter on the side that faces the LED."""

from collections.abc import Sequence

import numpy as np

from gelgap.render.imaging import srgb_decode


def light_azimuths(
    reference: np.ndarray, pictures: Sequence[np.ndarray], centers_px: np.ndarray, radii_px: np.ndarray
) -> np.ndarray:
    """Return (3,): by channel the azimuth in radians, from +x towards +y, that presses are lit from.

    `centers_px` (n, 2) and `radii_px` (n,) say which part of each picture, uint8 (h, w, 3), is looked at.
    """
    untouched = np.maximum(srgb_decode(reference / 255), 1e-3)
    rows, columns = np.indices(reference.shape[:2])
    moments = np.zeros((3, 2))
    for picture, (x, y), radius in zip(pictures, centers_px, radii_px, strict=True):
        inside = np.hypot(columns - x, rows - y) < radius
        change = srgb_decode(picture[inside] / 255) / untouched[inside] - 1
        moments += change.T @ np.column_stack([columns[inside] - x, rows[inside] - y])
    return np.arctan2(moments[:, 1], moments[:, 0])
