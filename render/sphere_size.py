"""The size of an unknown sphere: which radius explains pictures of its presses best, and which others nearly so."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from gelgap.render.press_profiles import PressProfiles

Membranes = Callable[[set[float], float | None], Mapping[float, PressProfiles]]
# Radii that are tried, in radii of the marked imprint: a mark is between a third and three times the sphere.
TRIED_RADII = 2.0 ** np.arange(-4 / 3, 4 / 3 + 0.01, 1 / 3)
_BETWEEN = 2.0 ** (1 / 6)
_SMALLEST_DIAMETER_MM, _LARGEST_DIAMETER_MM = 0.5, 50.0


@dataclass(frozen=True)
class SphereSize:
    """Diameters that were tried, what each leaves unexplained, and the best with those that are not worse.

    Not worse means: the mean square over presses is within two standard errors of the best's, pressed by press.
    """

    tried_mm: np.ndarray  # (sizes,)
    rms_code_values: np.ndarray  # (sizes,)
    diameter_mm: float
    interval_mm: tuple[float, float]


def fit_sphere_size(
    mark_radius_mm: float, membranes: Membranes, press_errors: Callable[[PressProfiles], np.ndarray]
) -> SphereSize:
    """Try spheres around the size of a mark, each with the membrane of one solve, scaled.

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
    diameters = 2 * mark_radius_mm * TRIED_RADII
    diameters = diameters[(diameters >= _SMALLEST_DIAMETER_MM) & (diameters <= _LARGEST_DIAMETER_MM)]
    if len(diameters) < 3:
        raise ValueError(
            f"the marks are {2 * mark_radius_mm:.2f} mm wide, which no sphere of {_SMALLEST_DIAMETER_MM:g} to "
            f"{_LARGEST_DIAMETER_MM:g} mm leaves; check radius_px and the camera's field of view"
        )
    solved_mm = float(diameters[len(diameters) // 2])
    solved = membranes({solved_mm}, None)[solved_mm]
    errors = {d: press_errors(solved.scaled(d / solved_mm)) for d in map(float, diameters)}
    best = min(errors, key=lambda d: errors[d].mean())
    if best in (diameters[0], diameters[-1]):
        raise ValueError(
            f"the pictures do not hold the sphere's size: of {diameters[0]:.2f} to {diameters[-1]:.2f} mm the end "
            f"{best:.2f} mm explains them best; give sphere_diameter_mm"
        )
    for d in (best / _BETWEEN, best * _BETWEEN):
        errors[d] = press_errors(solved.scaled(d / solved_mm))
    tried = np.array(sorted(errors))
    best = min(errors, key=lambda d: errors[d].mean())
    like = [d for d in tried if _not_worse(errors[d], errors[best])]
    rms = np.sqrt([errors[d].mean() for d in tried])
    return SphereSize(tried, rms, best, (min(like), max(like)))


def _not_worse(errors: np.ndarray, best: np.ndarray) -> bool:
    worse = errors - best
    return bool(worse.mean() <= 2 * worse.std() / np.sqrt(len(worse)))
