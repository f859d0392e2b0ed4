"""Aitken's extrapolation of an iteration whose steps shrink in a geometric series."""

import math

import numpy as np
from numpy.typing import NDArray

# Two steps belong to a series if the cosine of the angle between them is at least the first of these numbers, and the
# second step is at least the second number times as long as the first.
_PARALLEL_COSINE = 0.9
_SMALLEST_RATIO = 0.3
# Above this ratio of two steps the series' end is too uncertain: it is extrapolated as far as is allowed.
_LARGEST_RATIO = 0.95
# This many extrapolations need a series of one pair of steps; each further one needs two pairs more.
_QUICK_EXTRAPOLATIONS = 2


class GeometricSeries:
    """The steps of an iteration since it was last extrapolated."""

    def __init__(self) -> None:
        self._last: NDArray[np.float64] | None = None
        self._pairs = -1
        self._extrapolations = 0

    def remainder(self, step: NDArray[np.float64], dofs: NDArray[np.int64], furthest: float) -> float:
        """Add a step (n,); return the sum of the steps still to come as a multiple of it, 0 while that is not clear.

        Only `dofs` are considered, and none of them is moved further than `furthest`. The first step after an
        extrapolation is a response to the jump and belongs to no series. Where extrapolations make an iteration go in
        circles, it needs time to settle by itself, so later extrapolations wait for longer series.
        """
        last, self._last = self._last, np.array(step)
        if last is None:
            return 0.0
        last, step = last[dofs], step[dofs]
        product = float(last @ step)
        ratio = product / max(float(last @ last), 1e-300)
        parallel = product >= _PARALLEL_COSINE * float(np.linalg.norm(last) * np.linalg.norm(step))
        self._pairs = self._pairs + 1 if parallel and ratio >= _SMALLEST_RATIO else 0
        if self._pairs < max(1, 2 * (self._extrapolations - _QUICK_EXTRAPOLATIONS)):
            return 0.0
        self._last, self._pairs = None, -1
        self._extrapolations += 1
        times = ratio / (1 - ratio) if ratio < _LARGEST_RATIO else math.inf
        return min(times, furthest / float(np.abs(step).max()))
