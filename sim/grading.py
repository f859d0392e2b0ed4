"""How wide a mesh's cells are along an axis: as contact and indenter's surface need them, growing away from them.

A sphere's contact has `MeshSize.across` cells across its radius. From one cell to the next the sphere's normal turns by
at most 1/across, so that cells on another body are no wider than where its own normal turns by some of these.
"""

import math
from dataclasses import dataclass, replace
from itertools import product
from types import SimpleNamespace

import numpy as np

from gelgap.sim.indenter import Floats, Indenter
from gelgap.sim.problem import MESHES, QUALITIES, ContactProblem

# Chosen beside the references; the file says what each does.
_CELLS = SimpleNamespace(**MESHES["cells"])
EDGE_STEP_CELLS: float = _CELLS.edge_step_cells


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
        place = np.linspace(start_mm, end_mm, _CELLS.samples)
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
    stands = [
        _sizes_under(problem, body, depth_mm, axis, largest_mm, swept_mm) for body, depth_mm in problem.stands
    ]
    sizes = Sizes(
        first_mm=np.concatenate([stand.first_mm for stand in stands]),
        last_mm=np.concatenate([stand.last_mm for stand in stands]),
        size_mm=np.concatenate([stand.size_mm for stand in stands]),
        below=np.concatenate([stand.below for stand in stands]),
        above=np.concatenate([stand.above for stand in stands]),
        largest_mm=largest_mm,
    )
    if problem.indenter.convex:
        return sizes
    # Cells along a body of many features are as fine as their number allows, which is less across a long one.
    low, high = problem.cut_mm[axis] + swept_mm
    most = problem.most_cells_along * math.sqrt(min(1.0, (high - low) / (2 * max(problem.half_cut_mm))))
    largest_mm = max(problem.cell_mm, (high - low) / most)
    finest_mm = np.geomspace(sizes.size_mm.min(), largest_mm, _CELLS.finest_tried)
    for least_mm in finest_mm:
        sizes = replace(sizes, size_mm=np.maximum(sizes.size_mm, least_mm))
        if len(sizes.positions_mm(low, high)) <= most + 1:
            break
    return sizes


def _sizes_under(
    problem: ContactProblem,
    body: Indenter,
    depth_mm: float,
    axis: int,
    largest_mm: float,
    swept_mm: tuple[float, float],
) -> Sizes:
    """Return the sizes of cells under the indenter as it is turned once on its way."""
    cell_mm, size = problem.cell_along_mm(axis), problem.mesh_size
    low, high = problem.cut_by(body, depth_mm)[axis]
    growth = math.log(size.ring_growth) * (_CELLS.beside_ring if problem.is_ring else 1.0)
    step_mm = cell_mm * (EDGE_STEP_CELLS if problem.is_round else 1.0)
    places, radius = _curvature_on_gel(problem, body, depth_mm, axis, step_mm)
    turned = _CELLS.turn_per_cell * radius / size.across
    curved = np.flatnonzero(turned < cell_mm)
    curved = curved[:: max(1, len(curved) // _CELLS.curved_places)]
    middle = np.linspace(low, high, _CELLS.contact_places)
    if not body.convex and len(places):
        # Between its parts, which it touches with none, there is nothing to be fine for.
        middle = np.concatenate([[low], places[:: 1 + len(places) // _CELLS.curved_places], [high]])
    cells = _CELLS.middle_cells_per_width * problem.contact_width
    cells = np.clip(cells, _CELLS.middle_cells, _CELLS.most_middle_cells)
    widest_mm = max(cell_mm, cells * problem.widest_cell_mm)
    widened = np.minimum(cell_mm + growth * np.minimum(middle - low, high - middle), widest_mm)
    # Only under a flat face all of the contact is there from the first touch on.
    within = np.full_like(middle, cell_mm)
    if len(places):
        order = np.argsort(places)
        is_flat = np.interp(middle, places[order], radius[order]) > _CELLS.flat_radii * (high - low)
        within[is_flat] = widened[is_flat]
    # A less deep contact of a pointed body ends further in, and is to be as many cells wide.
    further = np.abs(middle)[:, None] - np.abs(places[curved])
    pointed = np.where(further > 0, turned[curved] + further / size.across, np.inf)
    margin = np.where((middle == low) | (middle == high), cell_mm, 0.0)
    within = np.where(margin > 0, within, np.minimum(within, pointed.min(axis=1, initial=np.inf)))
    place = np.concatenate([places[curved], middle])
    margin = np.concatenate([0 * places[curved], margin])
    # Towards the middle of the contact, where it carries load, cells grow half as fast as away from it.
    beyond = place > (low + high) / 2
    return Sizes(
        first_mm=place - margin + swept_mm[0],
        last_mm=place + margin + swept_mm[1],
        size_mm=np.concatenate([turned[curved], within]),
        below=growth * np.where(beyond, _CELLS.inwards, 1.0),
        above=growth * np.where(beyond, 1.0, _CELLS.inwards),
        largest_mm=largest_mm,
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
        _CELLS.thinnest_cells * problem.cell_mm,
        _CELLS.thinnest_places * getattr(problem.indenter, "spacing_mm", 0),
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
    return problem.cell_mm * (_CELLS.sharpest_ring_cells if problem.is_round else _CELLS.sharpest_cells)


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
