"""The size of an unknown sphere: which one explains pictures of its presses best, and which ones are worse."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from gelgap.render.press_profiles import PressProfiles

Membranes = Callable[[set[float], float | None], Mapping[float, PressProfiles]]
# Radii that may be tried, in radii of the marked imprint: a mark is between a third and three times the sphere.
RADII_IN_MARKS = 2.0 ** np.arange(-5 / 3, 5 / 3 + 0.01, 1 / 3)
_BETWEEN = 2.0 ** (1 / 6)
_SMALLEST_DIAMETER_MM, _LARGEST_DIAMETER_MM = 0.5, 50.0


@dataclass(frozen=True)
class SphereSize:
    """Diameters that were tried, what each leaves unexplained, the best, and the interval that it lies in.

    The interval's ends are the nearest sizes tried that are worse: their mean square over presses exceeds the best's by
    two standard errors of the difference, or they are the last ones tried.
    """

    tried_mm: np.ndarray  # (sizes,)
    rms_code_values: np.ndarray  # (sizes,)
    diameter_mm: float
    interval_mm: tuple[float, float]


def fit_sphere_size(
    mark_radius_mm: float, membranes: Membranes, press_errors: Callable[[PressProfiles], np.ndarray]
) -> SphereSize:
    """Try spheres from the size of a mark on, downhill, each with the membrane of one solve, scaled.

    Parameters
    ----------
    mark_radius_mm
        How large the imprints are, roughly.
    membranes
        Solves the membrane around spheres, as `calibrate_light` is given it.
    press_errors
        Returns (presses,) the mean square error of each press in code values² for one sphere's membrane.

    Raises
    ------
    ValueError
        If the best size lies at an end of those tried: the pictures do not hold it.
    """
    sizes = 2 * mark_radius_mm * RADII_IN_MARKS
    sizes = sizes[(sizes >= _SMALLEST_DIAMETER_MM) & (sizes <= _LARGEST_DIAMETER_MM)].tolist()
    if len(sizes) < 3:
        raise ValueError(
            f"the marks are {2 * mark_radius_mm:.2f} mm wide, which no sphere of {_SMALLEST_DIAMETER_MM:g} to "
            f"{_LARGEST_DIAMETER_MM:g} mm leaves; check radius_px and the camera's field of view"
        )
    middle = len(sizes) // 2
    solved = membranes({sizes[middle]}, None)[sizes[middle]]
    errors: dict[float, np.ndarray] = {}

    def error(diameter_mm: float) -> float:
        if diameter_mm not in errors:
            errors[diameter_mm] = press_errors(solved.scaled(diameter_mm / sizes[middle]))
        return float(errors[diameter_mm].mean())

    at = middle
    while 0 < at < len(sizes) - 1:
        lowest = min((at, at - 1, at + 1), key=lambda k: error(sizes[k]))
        if lowest == at:
            break
        at = lowest
    else:
        raise ValueError(
            f"the pictures do not hold the sphere's size: of {sizes[0]:.2f} to {sizes[-1]:.2f} mm the end "
            f"{sizes[at]:.2f} mm explains them best; give sphere_diameter_mm"
        )
    best = min((sizes[at] / _BETWEEN, sizes[at], sizes[at] * _BETWEEN), key=error)
    tried = np.array(sorted(errors))
    like = np.flatnonzero([_not_worse(errors[d], errors[best]) for d in tried])
    interval = tried[max(like.min() - 1, 0)], tried[min(like.max() + 1, len(tried) - 1)]
    rms = np.sqrt([errors[d].mean() for d in tried])
    return SphereSize(tried, rms, best, tuple(map(float, interval)))


def _not_worse(errors: np.ndarray, best: np.ndarray) -> bool:
    worse = errors - best
    return bool(worse.mean() <= 2 * worse.std() / np.sqrt(len(worse)))
