"""What a press does to a real picture where it does not touch: a change of level, and a shifted flat field."""

from dataclasses import dataclass

import numpy as np

from gelgap.render.imaging import srgb_decode
from gelgap.render.scattered import monomials

FEWEST_FOR_GAIN = 12
_STEP_PX = 4
_GAIN_BEYOND, _LOADED_BEYOND = 3.0, 2.5  # contact radii


@dataclass(frozen=True)
class FarField:
    """The picture of the untouched gel while something presses: reference × loaded × (1 + gain at its place)."""

    reference: np.ndarray  # (h, w, 3) linear
    loaded: np.ndarray | None  # (h, w, 3) ratio
    gain: np.ndarray  # (6, 3)

    def base(self, rows: np.ndarray, columns: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Return (n, 3) linear light of pixels; `place` (2,) is the press's, in units of the scale."""
        linear = self.reference[rows, columns]
        if self.loaded is not None:
            linear = linear * self.loaded[rows, columns]
        return linear * (1 + monomials(place[0], place[1], 2) @ self.gain)


def plain_field(reference: np.ndarray) -> FarField:
    """Return the field in which a press changes nothing."""
    return FarField(srgb_decode(reference / 255), None, np.zeros((6, 3)))


def far_field(
    reference: np.ndarray,
    pictures: list[np.ndarray],
    centers_px: np.ndarray,
    radii_px: np.ndarray,
    places: np.ndarray,
) -> FarField:
    """Return the field of presses (n, 2) at `places`, from the parts of their pictures that no press reaches."""
    untouched = srgb_decode(reference / 255)
    coarse = np.s_[::_STEP_PX, ::_STEP_PX]
    code = reference[coarse]
    good = ((code > 20) & (code < 245)).all(axis=2)
    rows, columns = np.indices(reference.shape[:2])
    distances = [np.hypot(columns - x, rows - y) / r for (x, y), r in zip(centers_px, radii_px, strict=True)]
    ratios = [srgb_decode(picture / 255) / np.maximum(untouched, 1e-4) for picture in pictures]
    levels = []
    for ratio, distance in zip(ratios, distances, strict=True):
        far = good & (distance[coarse] > _GAIN_BEYOND)
        levels.append(np.median(ratio[coarse][far], axis=0) - 1 if far.any() else np.zeros(3))
    gain = _gain(np.array(levels), places) if len(pictures) >= FEWEST_FOR_GAIN else np.zeros((6, 3))
    stack = np.empty((len(pictures), *reference.shape), np.float32)
    for layer, ratio, distance, place in zip(stack, ratios, distances, places, strict=True):
        layer[:] = ratio / (1 + monomials(place[0], place[1], 2) @ gain)
        layer[distance < _LOADED_BEYOND] = np.nan
    return FarField(untouched, np.clip(_median(stack), 0.5, 2.0), gain)


def _median(stack: np.ndarray) -> np.ndarray:
    """Return the median over presses, 1 where none is far enough."""
    stack.sort(axis=0)  # NaN last
    count = np.isfinite(stack).sum(axis=0)
    lower, upper = np.maximum((count - 1) // 2, 0), count // 2
    upper = np.minimum(upper, len(stack) - 1)
    middle = (
        np.take_along_axis(stack, lower[None], axis=0)[0] + np.take_along_axis(stack, upper[None], axis=0)[0]
    ) / 2
    return np.where(count > 0, middle, 1.0).astype(float)


def _gain(levels: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return (6, 3): a quadratic of the place through the levels (n, 3), deaf to outliers."""
    terms = monomials(places[:, 0], places[:, 1], 2)
    penalty = np.diag([0, 1, 1, 1, 1, 1.0]) * 0.02 * len(levels)
    fit = np.zeros_like(levels)
    gain = np.zeros((6, 3))
    for _ in range(3):
        for channel in range(3):
            weight = 1 / np.sqrt(1 + ((levels[:, channel] - fit[:, channel]) / 0.02) ** 2)
            weighted = (terms * weight[:, None]).T
            gain[:, channel] = np.linalg.solve(weighted @ terms + penalty, weighted @ levels[:, channel])
        fit = terms @ gain
    return gain
