"""What a solve takes, before anything is solved: core seconds, from what its mesh and its load steps count.

The numbers are those of one core of a server of 2023; `gelgap benchmark stability` holds them against what scenes take.
"""

import logging
import math
from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from gelgap.assets import asset_path
from gelgap.assets.toml_file import read_toml
from gelgap.sim.grading import is_served
from gelgap.sim.mesh import elimination_groups, mesh_for
from gelgap.sim.problem import QUALITIES, ContactProblem
from gelgap.sim.steady import solved_problems

LOG = logging.getLogger(__name__)
# The file says what was fitted to solves, what was chosen, and what each number does.
_COST = SimpleNamespace(**read_toml(asset_path("fitted", "cost.toml")))
# A forecast above this many core seconds comes with advice on what would make the solve cheaper.
DEAR_S = {"draft": 30.0, "standard": 120.0, "fine": 300.0}
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
        touched_s = _COST.touchable_s * self.touchable + _COST.dense_s * self.touchable**3
        return touched_s + _COST.gflop_s * self.gflop

    @property
    def core_s(self) -> float:
        """About how many seconds of a core all of it takes."""
        return _COST.build_s * self.thousands**_COST.build_power + self.iterations * self.iteration_s


def expected_core_s(problem: ContactProblem) -> float:
    """Return about how many seconds of a core a problem takes."""
    return sum(expected_work(part).core_s for part in solved_problems(problem))


@lru_cache(maxsize=32)
def expected_work(problem: ContactProblem) -> Work:
    """Return what the solve of a problem will consist of, if all of its slides are solved to their ends."""
    groups = elimination_groups(problem)
    columns = 3.0 * np.array([len(group.columns) for group in groups])
    rows = 3.0 * np.array([len(group.rows) for group in groups[:-1]]) + 1
    kept, columns = columns[-1], columns[:-1]
    gflop = float((columns**3 / 3 + columns**2 * rows + columns * rows**2).sum()) / 1e9
    thousands = len(mesh_for(problem).vertices_mm) / 1000
    return Work(thousands, kept / 3000, gflop, expected_iterations(problem))


def expected_iterations(problem: ContactProblem) -> float:
    """Return about how many iterations the load steps of a problem take."""
    # The first load step onto the gel is taken in three.
    iterations = 2 * _COST.press_iterations * problem.parents.count(-1)
    for start, end in problem.segments:
        change = end - start
        steps, sideways_mm = problem.steps(change), np.hypot(*change[:2]) + problem.arc_mm(change[3:])
        if sideways_mm > 0:
            iterations += (
                _COST.drag_iterations * steps + _COST.cell_iterations * sideways_mm / problem.cell_mm
            )
        else:
            # Vertices that slide over a sharp edge do so one after another.
            features = abs(change[2]) / steps / problem.indenter.feature_size_mm
            iterations += _COST.press_iterations * steps * max(1.0, features)
    return float(iterations)


def affordable(problem: ContactProblem) -> ContactProblem:
    """Return a draft with cells so wide that its forecast is what one may take, if they serve the body; else itself.

    A warning says by how much they are wider.
    """
    wider = _widened(problem)
    if wider is not problem:
        said = "%s at draft: it is dear, so that cells are %.1f times as wide as usual; quality standard has its own"
        LOG.warning(said, problem.indenter.label, _width(wider))
    return wider


def _width(problem: ContactProblem) -> float:
    """Return how many times as wide as its quality's a problem's cells are."""
    return QUALITIES[problem.quality.name].pad.across / problem.quality.pad.across


def _widened(problem: ContactProblem) -> ContactProblem:
    quality = problem.quality
    if quality.name != "draft" or not problem.indenter.convex:
        return problem
    swept_mm = np.ptp(problem.cut_mm, axis=1) + np.ptp(problem.segments[:, :, :2], axis=(0, 1))
    cells = math.prod(swept_mm[axis] / problem.cell_along_mm(axis) for axis in (0, 1))
    may_s = max(_COST.draft_s, _COST.draft_waypoint_s * len(problem.waypoints_mm))
    if cells * expected_iterations(problem) < _COST.cells_per_s * may_s:
        return problem
    most = min(_COST.widest, round((expected_core_s(problem) / may_s) ** _COST.widened_power, 1))
    # Cells wider by less would change many solves that are hardly dear.
    for times in np.arange(most, 1.25, -0.1).round(1).tolist():
        size = replace(quality, disc=quality.disc.widened(times), pad=quality.pad.widened(times))
        if is_served(wider := replace(problem, quality=size)):
            return wider
    return problem


def most_iterations(problem: ContactProblem) -> int:
    """Return after how many iterations a way through a problem's waypoints is given up."""
    work, longest_s = expected_work(problem), _COST.longest_s[problem.quality.name]
    usual_s = min(_COST.longest_forecasts * work.core_s, _COST.most_of_longest * longest_s)
    return math.ceil(max(longest_s, _COST.fewest_forecasts * work.core_s, usual_s) / work.iteration_s)


def cheaper(problem: ContactProblem) -> dict[str, float]:
    """Return what would make a solve cheaper, and the core seconds that it would take then, the least first.

    Each is found by planning the changed problem, with cells of the same size, so that what does not help is not named.
    """
    changed = {}
    if problem.quality.name != "draft":
        changed["quality draft"] = _widened(replace(problem, quality=QUALITIES["draft"]))
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
    if (width := _width(problem)) > 1:
        said += f" with cells {width:.1f} times as wide as usual"
    if needed_s <= DEAR_S[problem.quality.name]:
        return said
    helping = ", ".join(f"{change} {core_s:.0f} s" for change, core_s in cheaper(problem).items())
    return f"{said}; cheaper: {helping or 'nothing simple'}"
