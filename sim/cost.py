"""What a solve takes, before anything is solved: core seconds, from what its mesh and its load steps count.

The numbers are those of one core of a server of 2023; `gelgap benchmark stability` holds them against what scenes take.
"""

import math
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from gelgap.sim.grading import is_served
from gelgap.sim.mesh import mesh_for
from gelgap.sim.problem import QUALITIES, ContactProblem
from gelgap.sim.steady import solved_problems

# Building mesh, model and elimination plan: seconds of a mesh of 1000 vertices, and the power of their number.
_BUILD_S, _BUILD_POWER = 0.032, 1.6
# An iteration: seconds for 1000 vertices that the indenter can touch, for their cube, and for 10⁹ operations.
_TOUCHABLE_S, _DENSE_S, _GFLOP_S = 0.22, 0.6, 0.0125
# Iterations of a load step straight down, of which the first onto the gel counts as three; of one sideways; and for
# each cell that it goes.
_PRESS_ITERATIONS, _DRAG_ITERATIONS, _CELL_ITERATIONS = 5.7, 6.8, 10.0
# A forecast above this many core seconds comes with advice on what would make the solve cheaper.
DEAR_S = {"draft": 30.0, "standard": 120.0, "fine": 300.0}
# A way is given up after `_LONGEST_FORECASTS` forecasts, no fewer core seconds than these and no more than
# `_MOST_OF_LONGEST` times these, but not before `_FEWEST_FORECASTS`: nine of ten random bodies take no more.
LONGEST_S = {"draft": 20.0, "standard": 120.0, "fine": 300.0}
_LONGEST_FORECASTS, _MOST_OF_LONGEST, _FEWEST_FORECASTS = 2.5, 3.0, 1.5
# A draft of a convex body may take `_DRAFT_S`, or `_DRAFT_WAYPOINT_S` for each waypoint. Forecast over 2.1 times that,
# it gets cells wider by this power of the ratio, at most `_WIDEST`: scenes 147 and 327 take 13 and 19 s for 72 and 46.
# With fewer than `_CELLS_PER_S` cells around what is touched, times iterations, for each second, no forecast is made.
_DRAFT_S, _DRAFT_WAYPOINT_S, _WIDENED_POWER, _WIDEST, _CELLS_PER_S = 20.0, 5.0, 0.3, 2.0, 400.0
# A change is worth naming if it leaves at most this share.
_WORTHWHILE_SHARE = 0.75


class Work(NamedTuple):
    """What a solve consists of: 1000 vertices, of them touchable, 10⁹ operations of an elimination, iterations."""

    thousands: float
    touchable: float
    gflop: float
    iterations: float

    @property
    def iteration_s(self) -> float:
        """About how many seconds of a core an iteration takes."""
        return _TOUCHABLE_S * self.touchable + _DENSE_S * self.touchable**3 + _GFLOP_S * self.gflop

    @property
    def core_s(self) -> float:
        """About how many seconds of a core all of it takes."""
        return _BUILD_S * self.thousands**_BUILD_POWER + self.iterations * self.iteration_s


def expected_core_s(problem: ContactProblem) -> float:
    """Return about how many seconds of a core a problem takes."""
    return sum(expected_work(own).core_s for own in solved_problems(problem))


@lru_cache(maxsize=32)
def expected_work(problem: ContactProblem) -> Work:
    """Return what the solve of a problem will consist of, if all of its slides are solved to their ends."""
    # Fronts are compiled code, which a forecast alone loads only here.
    from gelgap.sim.fronts import elimination_groups

    groups = elimination_groups(problem)
    own = 3.0 * np.array([len(front.columns) for front in groups])
    below = 3.0 * np.array([len(front.rows) for front in groups[:-1]]) + 1
    kept, own = own[-1], own[:-1]
    gflop = float((own**3 / 3 + own**2 * below + own * below**2).sum()) / 1e9
    thousands = len(mesh_for(problem).vertices_mm) / 1000
    return Work(thousands, kept / 3000, gflop, expected_iterations(problem))


def expected_iterations(problem: ContactProblem) -> float:
    """Return about how many iterations the load steps of a problem take."""
    # The first load step onto the gel is taken in three.
    iterations = 2 * _PRESS_ITERATIONS * problem.parents.count(-1)
    for start, end in problem.segments:
        change = end - start
        steps, sideways_mm = problem.steps(change), np.hypot(*change[:2]) + problem.arc_mm(change[3:])
        if sideways_mm > 0:
            iterations += _DRAG_ITERATIONS * steps + _CELL_ITERATIONS * sideways_mm / problem.cell_mm
        else:
            # Vertices that slide over a sharp edge do so one after another.
            features = abs(change[2]) / steps / problem.indenter.feature_size_mm
            iterations += _PRESS_ITERATIONS * steps * max(1.0, features)
    return float(iterations)


def affordable(problem: ContactProblem) -> ContactProblem:
    """Return a draft with cells so wide that its forecast is what one may take, if they serve the body; else itself."""
    quality = problem.quality
    if quality.name != "draft" or not problem.indenter.convex:
        return problem
    swept_mm = np.ptp(problem.cut_mm, axis=1) + np.ptp(problem.segments[:, :, :2], axis=(0, 1))
    cells = math.prod(swept_mm[axis] / problem.cell_along_mm(axis) for axis in (0, 1))
    may_s = max(_DRAFT_S, _DRAFT_WAYPOINT_S * len(problem.waypoints_mm))
    if cells * expected_iterations(problem) < _CELLS_PER_S * may_s:
        return problem
    most = min(_WIDEST, round((expected_core_s(problem) / may_s) ** _WIDENED_POWER, 1))
    # Cells wider by less would change many solves that are hardly dear.
    for times in np.arange(most, 1.25, -0.1).round(1).tolist():
        size = replace(quality, disc=quality.disc.widened(times), pad=quality.pad.widened(times))
        if is_served(wider := replace(problem, quality=size)):
            return wider
    return problem


def most_iterations(problem: ContactProblem) -> int:
    """Return after how many iterations a way through a problem's waypoints is given up."""
    work, longest_s = expected_work(problem), LONGEST_S[problem.quality.name]
    usual_s = min(_LONGEST_FORECASTS * work.core_s, _MOST_OF_LONGEST * longest_s)
    return math.ceil(max(longest_s, _FEWEST_FORECASTS * work.core_s, usual_s) / work.iteration_s)


def cheaper(problem: ContactProblem) -> dict[str, float]:
    """Return what would make a solve cheaper, and the core seconds that it would take then, the least first.

    Each is found by planning the changed problem, with cells of the same size, so that what does not help is not named.
    """
    changed = {}
    if problem.quality.name != "draft":
        changed["quality draft"] = affordable(replace(problem, quality=QUALITIES["draft"]))
    if problem.travel_mm > 0:
        shorter = tuple((x / 2, y / 2, z) for x, y, z in problem.waypoints_mm)
        changed["half the travel"] = replace(problem, waypoints_mm=shorter)
    shallower = tuple((x, y, z / 2) for x, y, z in problem.waypoints_mm)
    changed["half the depth"] = replace(problem, waypoints_mm=shallower)
    for field, name in (
        ("edge_radius_mm", "edge radius"),
        ("tip_radius_mm", "tip radius"),
        ("diameter_mm", "diameter"),
    ):
        size_mm = getattr(problem.indenter, field, None)
        if size_mm:
            larger = {**problem.indenter.model_dump(), field: 2 * size_mm}
            try:
                body = type(problem.indenter).model_validate(larger)
            except ValueError:
                continue
            changed[f"twice the {name} ({2 * size_mm:.3g} mm)"] = replace(problem, indenter=body)
    now_s, needed_s = expected_core_s(problem), {}
    for change, other in changed.items():
        try:
            needed_s[change] = expected_core_s(other)
        except ValueError:  # A body that touches with all of its face from some depth on, say.
            continue
    helping = {change: s for change, s in needed_s.items() if s <= _WORTHWHILE_SHARE * now_s}
    return dict(sorted(helping.items(), key=lambda item: item[1]))


def forecast(problem: ContactProblem) -> str:
    """Say what a solve takes; of a dear one also what would make it cheaper."""
    needed_s = expected_core_s(problem)
    said = f"about {needed_s:.0f} s of a core to solve at {problem.quality.name}"
    wider = QUALITIES[problem.quality.name].pad.across / problem.quality.pad.across
    said += f" with cells {wider:.1f} times as wide as usual" if wider > 1 else ""
    if needed_s <= DEAR_S[problem.quality.name]:
        return said
    helping = ", ".join(f"{change} {own_s:.0f} s" for change, own_s in cheaper(problem).items())
    return f"{said}; cheaper: {helping or 'nothing simple'}"
