"""How wide a mesh's cells are along an axis: as contact and indenter's surface need them, growing away from them.

A sphere's contact has `MeshSize.across` cells across its radius. From one cell to the next the sphere's normal turns by
at most 1/across, so that cells on another body are no wider than where its own normal turns by some of these.
"""

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from gelgap.sim.indenter import Floats, Indenter
from gelgap.sim.problem import QUALITIES, ContactProblem

# By how many times 1/across the normal of the indenter's surface may turn from one cell to the next.
_TURN_PER_CELL = 2.0
# Where cells are even they are counted on this many points.
_SAMPLES = 4000
# About how many places at most say where the surface is curved.
_CURVED_PLACES = 60
# Cells in the middle of a contact, where nothing changes much, in those of a contact as wide as the gel is thick: the
# first, or the second times how many of these thicknesses it is wide, up to the third. Scene 498, a box of 6.5 × 8.4 mm
# on 1.8 mm of gel, takes 0.6 of the time so; its force changes by 0.1 %, that of another one (327) by 0.3.
_MIDDLE_CELLS, _MIDDLE_CELLS_PER_WIDTH, _MOST_MIDDLE_CELLS = 1.5, 0.75, 3.0
# A surface is flat if its radius of curvature is this many times the contact's width.
_FLAT_RADII = 20.0
_INWARDS = 0.5
# Beside a ring cells grow by this share of what they do elsewhere: it holds the gel within. A torus that sticks has
# 0.9 and 1.5 % too much at `draft` with that, 2.5 and 1.9 without (0.3 and 0.6 deep, beside felupe).
_BESIDE_RING = 0.5
# The contact's inside is looked at in this many places.
_CONTACT_PLACES = 33
# The smallest radius of curvature that a mesh serves, in cells of a sphere's contact of the same radius: that of rings,
# which follow a round body's edge, and of lines, between which a box of 5 × 7 mm did not converge at 0.2 (edge 0.1 mm).
_SHARPEST_RING_CELLS, _SHARPEST_CELLS = 0.18, 0.35
# Under a round body rings of cells follow an edge whose radius is taken over this many of them. Over a whole cell all
# edges of less than 0.6 cells looked alike, and a cylinder was pressed 2 to 4 % too lightly (edge 0.1 mm); a box
# of 5 × 7 mm with lines as fine took 1.7 times as long, and its force was 1.5 % too large.
EDGE_STEP_CELLS = 0.35
_FINEST_TRIED = 12
# A contact that is nowhere wider than this share of a cell falls through the mesh; one of fewer places of a height
# map, between them.
_THINNEST_CELLS, _THINNEST_PLACES = 0.5, 2.0


@dataclass(frozen=True)
class Sizes:
    """Cells are `size_mm` (n,) wide between `first_mm` and `last_mm` (n,).

    They grow by `below` and `above` (n,) per mm before the first and beyond the last place.
    """

    first_mm: Floats
    last_mm: Floats
    size_mm: Floats
    below: Floats
    above: Floats
    largest_mm: float

    def at(self, places_mm: Floats) -> Floats:
        """Return the width (k,) of cells at places (k,)."""
        place = places_mm[:, None]
        grown = np.maximum(self.below * (self.first_mm - place), self.above * (place - self.last_mm))
        return np.minimum((self.size_mm + np.maximum(grown, 0.0)).min(axis=1), self.largest_mm)

    def passed(self, start_mm: float, end_mm: float) -> tuple[Floats, Floats]:
        """Return places (k,) from start to end, and how many cells there are up to each, which need not be whole."""
        place = np.linspace(start_mm, end_mm, _SAMPLES)
        density = 1 / self.at(place)
        return place, np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(place))])

    def positions_mm(self, start_mm: float, end_mm: float) -> Floats:
        """Return positions from start to end, each further from the last one by the width of a cell there."""
        place, passed = self.passed(start_mm, end_mm)
        cells = max(1, math.ceil(passed[-1] - 1e-9))
        return np.interp(np.linspace(0.0, passed[-1], cells + 1), passed, place)


def sizes_along(
    problem: ContactProblem, axis: int, largest_mm: float, swept_mm: tuple[float, float]
) -> Sizes:
    """Return the sizes of cells along x or y (axis 0, 1), around what the indenter touches between two places.

    Where its surface is curved the cells are fine, and at the ends of the contact; from there to the middle of a flat
    face they widen to half as much again as those of a contact as wide as the gel is thick.
    """
    parts = zip(*(_sizes_under(problem, *stand, axis, swept_mm) for stand in problem.stands), strict=True)
    sizes = Sizes(*map(np.concatenate, parts), largest_mm)
    if problem.indenter.convex:
        return sizes
    # Cells along a body of many features are as fine as their number allows, which is less across a long one.
    low, high = problem.cut_mm[axis] + swept_mm
    most = problem.most_cells_along * math.sqrt(min(1.0, (high - low) / (2 * max(problem.half_cut_mm))))
    largest_mm = max(problem.cell_mm, (high - low) / most)
    finest_mm = np.geomspace(sizes.size_mm.min(), largest_mm, _FINEST_TRIED)
    for least_mm in finest_mm:
        sizes = replace(sizes, size_mm=np.maximum(sizes.size_mm, least_mm))
        if len(sizes.positions_mm(low, high)) <= most + 1:
            break
    return sizes


def _sizes_under(
    problem: ContactProblem, body: Indenter, depth_mm: float, axis: int, swept_mm: tuple[float, float]
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return the places, sizes and growths of `Sizes` under the indenter as it is turned once on its way."""
    cell_mm, size = problem.cell_along_mm(axis), problem.mesh_size
    low, high = problem.cut_by(body, depth_mm)[axis]
    growth = math.log(size.ring_growth) * (_BESIDE_RING if problem.is_ring else 1.0)
    step_mm = cell_mm * (EDGE_STEP_CELLS if problem.is_round else 1.0)
    places, radius = _curvature_on_gel(problem, body, depth_mm, axis, step_mm)
    turned = _TURN_PER_CELL * radius / size.across
    curved = np.flatnonzero(turned < cell_mm)
    curved = curved[:: max(1, len(curved) // _CURVED_PLACES)]
    middle = np.linspace(low, high, _CONTACT_PLACES)
    if not body.convex and len(places):
        # Between its parts, which it touches with none, there is nothing to be fine for.
        middle = np.concatenate([[low], places[:: 1 + len(places) // _CURVED_PLACES], [high]])
    cells = np.clip(_MIDDLE_CELLS_PER_WIDTH * problem.contact_width, _MIDDLE_CELLS, _MOST_MIDDLE_CELLS)
    widest_mm = max(cell_mm, cells * problem.widest_cell_mm)
    widened = np.minimum(cell_mm + growth * np.minimum(middle - low, high - middle), widest_mm)
    # Only under a flat face all of the contact is there from the first touch on.
    within = np.full_like(middle, cell_mm)
    if len(places):
        order = np.argsort(places)
        is_flat = np.interp(middle, places[order], radius[order]) > _FLAT_RADII * (high - low)
        within[is_flat] = widened[is_flat]
    # A less deep contact of a pointed body ends further in, and is to be as many cells wide.
    further = np.abs(middle)[:, None] - np.abs(places[curved])
    pointed = np.where(further > 0, turned[curved] + further / size.across, np.inf)
    margin = np.where((middle == low) | (middle == high), cell_mm, 0.0)
    within = np.where(margin > 0, within, np.minimum(within, pointed.min(axis=1, initial=np.inf)))
    place, margin = np.concatenate([places[curved], middle]), np.concatenate([0 * places[curved], margin])
    # Towards the middle of the contact, where it carries load, cells grow half as fast as away from it.
    beyond = place > (low + high) / 2
    return (
        place - margin + swept_mm[0],
        place + margin + swept_mm[1],
        np.concatenate([turned[curved], within]),
        growth * np.where(beyond, _INWARDS, 1.0),
        growth * np.where(beyond, 1.0, _INWARDS),
    )


def _curvature_on_gel(
    problem: ContactProblem, body: Indenter, depth_mm: float, axis: int, step_mm: float
) -> tuple[Floats, Floats]:
    """Return a body's curvature along an axis, without what reaches beyond a pad that is narrower."""
    low, high = problem.cut_by(body, depth_mm)[axis]
    places, radius = body.curvature(depth_mm, axis, step_mm)
    on_gel = (places > low - step_mm) & (places < high + step_mm)
    return places[on_gel], radius[on_gel]


def check_sharpness(problem: ContactProblem) -> None:
    """Raise ValueError if the indenter, where it is pressed, is thinner or sharper than the mesh serves."""
    width_mm = 2 * problem.meshed_radius_mm
    thinnest_mm = max(
        _THINNEST_CELLS * problem.cell_mm, _THINNEST_PLACES * getattr(problem.indenter, "spacing_mm", 0)
    )
    if width_mm < thinnest_mm:
        raise ValueError(
            f"indenter ({problem.indenter.label}): is {width_mm:.2g} mm wide at most where it cuts the gel at a depth "
            f"of {problem.depth_mm:g} mm; quality {problem.quality.name} serves {thinnest_mm:.2g} mm and more here"
        )
    if is_served(problem):
        return
    names = list(QUALITIES)
    finer = names[names.index(problem.quality.name) + 1 :]
    serving = [name for name in finer if is_served(replace(problem, quality=QUALITIES[name]))]
    # Rounded up, so that it is served.
    served_mm = math.ceil(1e3 * _sharpest_mm(problem)) / 1e3
    remedy = f"quality {serving[0]} serves it" if serving else "give a larger edge_radius_mm"
    raise ValueError(
        f"indenter ({problem.indenter.label}): has an edge sharper than the mesh at quality {problem.quality.name} "
        f"serves; the smallest radius that it serves here is {served_mm:g} mm: {remedy}"
    )


def _sharpest_mm(problem: ContactProblem) -> float:
    return problem.cell_mm * (_SHARPEST_RING_CELLS if problem.is_round else _SHARPEST_CELLS)


def is_served(problem: ContactProblem) -> bool:
    """Return whether the mesh serves the sharpest edge of what is pressed."""
    sharpest_mm = _sharpest_mm(problem)
    # Over such a step an edge of this radius turns by one radian, and any sharper one by more.
    return edge_radius_mm(problem, sharpest_mm) >= 0.98 * sharpest_mm


def edge_radius_mm(problem: ContactProblem, step_mm: float) -> float:
    """Return the smallest radius of curvature, over a step, of what the indenter presses; infinite for a sphere."""
    return min(
        _curvature_on_gel(problem, body, depth_mm, axis, step_mm)[1].min(initial=np.inf)
        for (body, depth_mm), axis in product(problem.stands, (0, 1))
    )
