"""Aitken's extrapolation of an iteration whose steps shrink in a geometric series."""

import math

import numpy as np
from numpy.typing import NDArray

# A series is taken for one if two steps are as parallel as this cosine, and the second not shorter than such a share.
_PARALLEL = 0.9
_SMALLEST_RATIO = 0.3
# Steps of a larger ratio go on for so long that their end is out of sight.
_LARGEST_RATIO = 0.95
# So many extrapolations come at once, each further one takes a series longer by two.
_PATIENCE = 2


class GeometricSeries:
    """The steps of an iteration since it was last extrapolated."""

    def __init__(self) -> None:
        self._last: NDArray[np.float64] | None = None
        self._pairs = -1
        self._extrapolations = 0

    def remainder(self, step: NDArray[np.float64], dofs: NDArray[np.int64], furthest: float) -> float:
        """Add a step (n,); return by how many times itself the iteration will still go on, 0 if that is not clear.

        Only `dofs` are looked at; none is to go on by more than `furthest`. The first of three steps does not count:
        it answers the last extrapolation. An iteration that goes in circles from one extrapolation to the next needs
        time to settle by itself, so each one but the first few asks for a longer series than the last did.
        """
        last, self._last = self._last, np.array(step)
        if last is None:
            return 0.0
        last, step = last[dofs], step[dofs]
        product = float(last @ step)
        ratio = product / max(float(last @ last), 1e-300)
        parallel = product >= _PARALLEL * float(np.linalg.norm(last) * np.linalg.norm(step))
        self._pairs = self._pairs + 1 if parallel and ratio >= _SMALLEST_RATIO else 0
        if self._pairs < max(1, 2 * (self._extrapolations - _PATIENCE)):
            return 0.0
        self._last, self._pairs = None, -1
        self._extrapolations += 1
        times = ratio / (1 - ratio) if ratio < _LARGEST_RATIO else math.inf
        return min(times, furthest / float(np.abs(step).max()))
