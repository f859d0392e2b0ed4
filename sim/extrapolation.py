"""Aitken's extrapolation of an iteration whose steps shrink in a geometric series."""

import math

import numpy as np
from numpy.typing import NDArray

# A series is taken for one if two steps are as parallel as this cosine, and the second not shorter than such a share.
_PARALLEL = 0.9
_SMALLEST_RATIO = 0.3
# Steps of a larger ratio go on for so long that their end is out of sight.
_LARGEST_RATIO = 0.95


class GeometricSeries:
    """The steps of an iteration since it was last extrapolated."""

    def __init__(self) -> None:
        self._steps: list[NDArray[np.float64]] = []

    def remainder(self, step: NDArray[np.float64], dofs: NDArray[np.int64], furthest: float) -> float:
        """Add a step (n,); return by how many times itself the iteration will still go on, 0 if that is not clear.

        Only `dofs` are looked at; none is to go on by more than `furthest`. The first of three steps does not count:
        it answers the last extrapolation.
        """
        self._steps.append(np.array(step))
        if len(self._steps) < 3:
            return 0.0
        last, step = self._steps[-2][dofs], self._steps[-1][dofs]
        product = float(last @ step)
        ratio = product / max(float(last @ last), 1e-300)
        if ratio < _SMALLEST_RATIO or product < _PARALLEL * float(
            np.linalg.norm(last) * np.linalg.norm(step)
        ):
            return 0.0
        self._steps.clear()
        times = ratio / (1 - ratio) if ratio < _LARGEST_RATIO else math.inf
        return min(times, furthest / float(np.abs(step).max()))
