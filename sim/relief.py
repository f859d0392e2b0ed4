"""Relief that is finer than the mesh serves: the gel is solved under the body that bridges it, and fills it by theory.

A sinusoid on a half-space (Westergaard 1939; Johnson 1985, §13.2) is flattened at a mean pressure p* = π E* a/λ, which
is E*/√2 times the root of its mean square slope. Below that the membrane leaves it where it is higher than a share
s = p/p* of its whole height, by a gap known in closed form. In the mean it sinks in by a s (1 − ln s): contacts yield
by that in the solve, which makes a force that was 15 % too large 1 %, in the same time.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from types import SimpleNamespace

import numpy as np

from gelgap.sim.estimate import LARGEST_ESTIMATE, Diagnostics
from gelgap.sim.grading import is_served
from gelgap.sim.indenter import Floats
from gelgap.sim.membrane import GRID_SPACING_MM
from gelgap.sim.problem import MESHES, ContactProblem
from gelgap.sim.surface import Surface

# Loads s, and by what share of the mean depth the gel sinks in there, s (1 − ln s): between them, and below the least,
# where that would be endlessly steep, it is a straight line.
_LEAST_LOAD = 0.01
_LOADS = np.geomspace(_LEAST_LOAD, 1.0, 60)
_SUNK = _LOADS * (1 - np.log(_LOADS))
# Chosen beside the references; the file says what each does.
_RELIEF = SimpleNamespace(**MESHES["relief"])


def bridged(problem: ContactProblem) -> ContactProblem:
    """Return a problem that the mesh serves, of the body without recesses narrower than two cells; else itself.

    So are bodies solved that the mesh does not serve, and those whose recesses are deep beside the press.
    """
    body = problem.indenter
    if not isinstance(body, Surface):
        return problem
    opened = _opened(body, _RELIEF.bridged_cells * problem.cell_mm)
    over, under = body.heights_mm, opened.heights_mm
    reached = under < problem.depth_mm
    deep_mm = float((over[reached] - under[reached]).mean())
    if deep_mm < _RELIEF.least_share * problem.depth_mm and is_served(problem):
        return problem
    without = replace(problem, indenter=opened, relief=body)
    return without if is_served(without) else problem


def unbridged(problem: ContactProblem) -> ContactProblem:
    """Return the problem of the body as it is, if the mesh serves that as well; else itself."""
    if problem.relief is None:
        return problem
    own = replace(problem, indenter=problem.relief, relief=None)
    return own if is_served(own) else problem


def _opened(body: Surface, width_mm: float) -> Surface:
    """Fill recesses narrower than a width along x or y: the grey opening by a square, edges of the body stay."""
    from scipy.ndimage import grey_opening

    side = 2 * int(np.ceil(width_mm / body.spacing_mm / 2)) + 1
    # Around the body there is nothing.
    heights = np.pad(body.heights_mm, side, constant_values=np.inf)
    opened = grey_opening(heights, size=(side, side))[side:-side, side:-side]
    return body.with_heights(np.where(np.isfinite(body.heights_mm), opened, np.inf))


@dataclass(frozen=True, eq=False)
class Recesses:
    """Depth (rows, columns) of recesses; around each place the largest, the mean, p*, and whether a grid shows them."""

    depth_mm: Floats
    deepest_mm: Floats
    mean_mm: Floats
    flattening_mpa: Floats
    shown: Floats
    spacing_mm: float

    def _at(self, from_origin_mm: Floats, bridging: Surface, *values: Floats) -> tuple[Floats, ...]:
        from scipy.ndimage import map_coordinates

        own = from_origin_mm @ bridging.axes
        middle = (np.array(self.depth_mm.shape)[:, None] - 1) / 2
        places = own[:, [1, 0]].T / self.spacing_mm + middle
        return tuple(map_coordinates(some, places, order=1, mode="nearest") for some in values)

    def resistance(
        self, from_origin_mm: Floats, bridging: Surface, beyond_mm: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return how a gel is pushed back whose mean surface is `beyond_mm` (n,) beyond what bridges recesses.

        That is how much of it (n,), mm, the recesses give room for, at which pressure (n,), MPa, and how much more per
        further MPa (n,). Points (n, 3) are mm from the origin of `bridging`, turned as it is.
        """
        mean_mm, flattening_mpa = self._at(from_origin_mm, bridging, self.mean_mm, self.flattening_mpa)
        sunk_mm = np.clip(beyond_mm, 0.0, mean_mm)
        load = np.interp(sunk_mm / np.maximum(mean_mm, 1e-12), [0.0, *_SUNK], [0.0, *_LOADS])
        slope = np.where(
            load > _LEAST_LOAD, -np.log(np.maximum(load, _LEAST_LOAD)), 1 - math.log(_LEAST_LOAD)
        )
        return sunk_mm, load * flattening_mpa, slope * mean_mm / np.maximum(flattening_mpa, 1e-12)

    def fill(self, from_origin_mm: Floats, bridging: Surface, pressure_mpa: Floats) -> Floats:
        """Return how far (n, 3) the gel is pressed in at points (n, 3) of what bridges recesses, by the pressure (n,).

        Points are mm from the origin of `bridging`, turned as it is.
        """
        fields = self.depth_mm, self.deepest_mm, self.mean_mm, self.flattening_mpa, self.shown
        depth, deepest, mean, flattening, shown = self._at(from_origin_mm, bridging, *fields)
        load = np.clip(pressure_mpa / np.maximum(flattening, 1e-12), 1e-9, 1.0)
        waves = np.where(depth > 0, deepest * filled_share(depth / np.maximum(deepest, 1e-12), load), 0.0)
        level = mean * load * (1 - np.log(load))
        return (shown * waves + (1 - shown) * level)[:, None] * bridging.axes[:, 2]


@lru_cache(maxsize=4)
def recesses_of(problem: ContactProblem) -> Recesses | None:
    """Return the recesses that a problem's indenter bridges, None if it is pressed as it is."""
    from scipy.ndimage import binary_closing, distance_transform_cdt, maximum_filter, uniform_filter

    body, bridging = problem.relief, problem.indenter
    if not (isinstance(body, Surface) and isinstance(bridging, Surface)):
        return None
    over, under = body.heights_mm, bridging.heights_mm
    depth = np.where(np.isfinite(over), over, 0.0) - np.where(np.isfinite(over), under, 0.0)
    deep = depth > _RELIEF.smooth_share * depth.max()
    rim = 2 * math.ceil(_RELIEF.rim_cells * problem.cell_mm / body.spacing_mm / 2) + 1
    # Over a square as wide as the widest recess.
    side = max(2 * int(distance_transform_cdt(deep).max()) + 1, rim)
    # Where recesses are, with the crests between them; beside them, as on a punch's rim, the gel meets what is smooth.
    rough = binary_closing(np.pad(deep, side), np.ones((side, side)))[side:-side, side:-side].astype(float)

    def mean_around(values: Floats) -> Floats:
        # Twice, since the mean over a square that is not quite a wave's length still has waves.
        total, weight = (uniform_filter(uniform_filter(part, side), side) for part in (rough * values, rough))
        return total / np.maximum(weight, 1e-9)

    # From place to place: over two of them short waves would look a third less steep.
    along_y, along_x = (np.diff(depth / body.spacing_mm, axis=axis, append=0.0) for axis in (0, 1))
    stiffness_mpa = 2 * problem.moduli.shear_mpa / (1 - problem.moduli.poisson_ratio)
    flattening_mpa = stiffness_mpa * np.sqrt(np.maximum(mean_around(along_y**2 + along_x**2), 0.0) / 2)
    mean_mm = mean_around(depth)
    # A sinusoid's length is π E* a / p*; a grid shows no waves shorter than two spacings.
    length_mm = math.pi * stiffness_mpa * mean_mm / np.maximum(flattening_mpa, 1e-12)
    shown = np.clip(length_mm / GRID_SPACING_MM - 2, 0.0, 1.0)
    by_cell_mm = np.maximum(uniform_filter(rough * mean_mm, rim), 0.0)
    return Recesses(depth, maximum_filter(depth, side), by_cell_mm, flattening_mpa, shown, body.spacing_mm)


def filled_share(height: Floats, load: Floats) -> Floats:
    """Return how high the gel stands in a sinusoid at a share of its height above its lowest, as a share of the height.

    `load` is s, the mean pressure over the one that flattens it. All (n,).
    """
    load = np.clip(load, 1e-9, 1.0)
    off = height > load
    beyond = np.sqrt(np.maximum(height * (height - load), 0.0))
    gap = beyond - load * np.arccosh(np.sqrt(np.where(off, height / load, 1.0)))
    return height - np.where(off, gap, 0.0)


def with_fill(
    found: Diagnostics, filled_mm: Floats, force_n: float, depth_mm: float, quality: str
) -> Diagnostics:
    """Return diagnostics whose force (> 0) may be off as the theory of how gel (n, 3) fills recesses is.

    In the mean the gel is pressed less deep by the fill.
    """
    share = _RELIEF.theory_off * float(np.linalg.norm(filled_mm.mean(axis=0))) / depth_mm
    fz_error_n = math.hypot(found.fz_error_n, share * force_n)
    return replace(
        found, fz_error_n=fz_error_n, coarse=found.coarse or fz_error_n > LARGEST_ESTIMATE[quality] * force_n
    )
