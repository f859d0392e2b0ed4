"""Relief that is finer than the mesh serves: the gel is solved under the body that bridges it, and fills it by theory.

A sinusoid on a half-space (Westergaard 1939; Johnson 1985, §13.2) is flattened at a mean pressure p* = π E* a/λ, which
is E*/√2 times the root of its mean square slope. Below that the membrane leaves it where it is higher than a share
s = p/p* of its whole height, by a gap known in closed form. It serves bodies that were refused; the others keep theirs.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from gelgap.sim.estimate import LARGEST_ESTIMATE, Diagnostics
from gelgap.sim.grading import is_served
from gelgap.sim.indenter import Floats, Indenter
from gelgap.sim.problem import ContactProblem
from gelgap.sim.scene import Elastomer
from gelgap.sim.surface import Surface

# What is narrower than this many cells, vertices do not show.
_BRIDGED_CELLS = 2.0


def bridged(problem: ContactProblem) -> ContactProblem:
    """Return a problem that the mesh serves, of the body without recesses narrower than two cells; else itself."""
    body = problem.indenter
    if not isinstance(body, Surface) or is_served(problem):
        return problem
    without = replace(problem, indenter=_opened(body, _BRIDGED_CELLS * problem.cell_mm))
    return without if is_served(without) else problem


def _opened(body: Surface, width_mm: float) -> Surface:
    """Fill recesses narrower than a width along x or y: the grey opening by a square, edges of the body stay."""
    from scipy.ndimage import grey_dilation, grey_erosion

    side = 2 * int(np.ceil(width_mm / body.spacing_mm / 2)) + 1
    # Around the body there is nothing.
    heights = np.pad(body.heights_mm, side, constant_values=np.inf)
    opened = grey_dilation(grey_erosion(heights, size=(side, side)), size=(side, side))
    return body.with_heights(opened[side:-side, side:-side])


@dataclass(frozen=True)
class _Recesses:
    """Depth (rows, columns) of a body's recesses, and the largest depth and mean square slope around."""

    depth_mm: Floats
    deepest_mm: Floats
    square_slope: Floats
    spacing_mm: float


@lru_cache(maxsize=4)
def _recesses(body: Surface, bridging: Surface) -> _Recesses:
    from scipy.ndimage import maximum_filter, uniform_filter

    over, under = body.heights_mm, bridging.heights_mm
    solid = np.isfinite(over) & np.isfinite(under)
    depth = np.where(solid, np.where(solid, over, 0.0) - np.where(solid, under, 0.0), 0.0)
    # Over a square as wide as the recesses that are bridged, which is at least twice as wide as any is from its middle.
    side = 2 * _widest_places(depth) + 1
    along_y, along_x = np.gradient(depth, body.spacing_mm)
    slope = uniform_filter(along_x**2 + along_y**2, side, mode="nearest")
    return _Recesses(depth, maximum_filter(depth, side), slope, body.spacing_mm)


def _widest_places(depth: Floats) -> int:
    """Return how many places the widest recess is from its rim to its middle."""
    from scipy.ndimage import distance_transform_cdt

    return max(1, int(distance_transform_cdt(depth > 0.02 * depth.max()).max()))


def filled_share(height: Floats, load: Floats) -> Floats:
    """Return how high the gel stands in a sinusoid at a share of its height above its lowest, as a share of the height.

    `load` is s, the mean pressure over the one that flattens it. All (n,).
    """
    load = np.clip(load, 1e-9, 1.0)
    off = height > load
    beyond = np.sqrt(np.maximum(height * (height - load), 0.0))
    gap = beyond - load * np.arccosh(np.sqrt(np.where(off, height / load, 1.0)))
    return height - np.where(off, gap, 0.0)


def fill(
    body: Surface,
    bridging: Surface,
    gel: Elastomer,
    from_origin_mm: Floats,
    pressure_mpa: Floats,
) -> Floats:
    """Return how far (n, 3) the gel is pressed into a body's recesses at points (n, 3) of what bridges them.

    Points are mm from the origin of `bridging`, turned as it is, and pressures (n,) those on it.
    """
    from scipy.ndimage import map_coordinates

    found = _recesses(body, bridging)
    turn = bridging.axes
    own = from_origin_mm @ turn
    middle = (np.array(found.depth_mm.shape)[:, None] - 1) / 2
    places = own[:, [1, 0]].T / found.spacing_mm + middle
    depth, deepest, square = (
        map_coordinates(values, places, order=1, mode="nearest")
        for values in (found.depth_mm, found.deepest_mm, found.square_slope)
    )
    flattening_mpa = gel.young_modulus_mpa / (1 - gel.poisson_ratio**2) * np.sqrt(np.maximum(square, 0.0) / 2)
    load = pressure_mpa / np.maximum(flattening_mpa, 1e-12)
    filled = deepest * filled_share(depth / np.maximum(deepest, 1e-12), load)
    return np.where(depth > 0, filled, 0.0)[:, None] * turn[:, 2]


def is_bridged(body: Indenter, solved: Indenter) -> bool:
    """Return whether a body was solved as one that bridges its recesses."""
    return isinstance(body, Surface) and isinstance(solved, Surface) and body.heights != solved.heights


def with_fill(
    found: Diagnostics, filled_mm: Floats, force_n: float, depth_mm: float, quality: str
) -> Diagnostics:
    """Return diagnostics whose force may be off by what the gel that fills recesses (n, 3) does not push back.

    A force (> 0) at a depth is that of a body without them; in the mean the gel is pressed less deep by the fill.
    """
    share = float(np.linalg.norm(filled_mm.mean(axis=0))) / depth_mm
    fz_error_n = math.hypot(found.fz_error_n, share * force_n)
    return replace(
        found, fz_error_n=fz_error_n, coarse=found.coarse or fz_error_n > LARGEST_ESTIMATE[quality] * force_n
    )
