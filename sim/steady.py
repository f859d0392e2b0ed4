"""Slides of any length: a straight drag that slides wholly goes on as it is, so that its state is moved, not solved.

The mesh and the load steps of a long slide then are those of its beginning. A slide of 1 mm, five times
the depth, takes a quarter of the time.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gelgap.sim.estimate import LARGEST_ESTIMATE
from gelgap.sim.indenter import Floats
from gelgap.sim.problem import ContactProblem
from gelgap.sim.solution import Record, Solution

# A drag is solved up to this many times the travel at which a paraboloid's contact has slipped wholly, and looked at
# some way before that as well.
_TRAVELS_TO_SLIP = 1.3
_EARLIER_SHARE = 0.75
# A drag is straight if no waypoint is further than this share of its way from the line.
_STRAIGHT_SHARE = 1e-4
# It is solved to its end if that is no more than this many times as far.
_SHORTENED_RATIO = 1.25
# A slide is steady if no more of its load than the first of these shares sticks, and if its force changed by no more
# than the second between the two looks.
_STICKING_SHARE = 0.02
_LARGEST_CHANGE = 0.01
# What the pad's edges may change of the force on the way, as a share of what a quality promises.
_LARGEST_OF_EDGES = 0.5
# An edge 2.4 thicknesses ahead of a contact of 0.47 of them in radius changes Fx by this, and half as much with every
# 0.4 thicknesses (docs/physics.md, Near edges); it is taken to be in proportion to the radius.
_OF_EDGE, _EDGE_THICKNESSES, _EDGE_RADIUS, _HALVED_BY = 0.019, 2.4, 0.47, 0.4


@dataclass(frozen=True)
class _Moved:
    """A waypoint beyond what is solved: `moved_mm` (2,) further than a record of the solved problem.

    `earlier` is the record some way before that one, −1 where nothing resists the slide.
    """

    record: int
    earlier: int
    moved_mm: Floats
    of_edges: float


@dataclass(frozen=True)
class SteadySlide:
    """A problem whose slides end where they are steady, and what each waypoint of the `whole` problem is in it."""

    whole: ContactProblem
    solved: ContactProblem
    waypoints: tuple[int | _Moved, ...]

    def moved(self, solution: Solution) -> Solution | None:
        """Return the solution of the whole problem from that of the solved one; None if a slide is not steady."""
        records = []
        for waypoint in self.waypoints:
            record = solution.records[waypoint if isinstance(waypoint, int) else waypoint.record]
            if isinstance(waypoint, _Moved):
                change = 0.0
                if waypoint.earlier >= 0:
                    earlier = solution.records[waypoint.earlier]
                    change = float(
                        np.linalg.norm(record.force_n - earlier.force_n) / np.linalg.norm(record.force_n)
                    )
                    sticks = max(record.diagnostics.sticking_fraction, earlier.diagnostics.sticking_fraction)
                    if record.converged and (change > _LARGEST_CHANGE or sticks > _STICKING_SHARE):
                        return None
                record = _moved_record(record, waypoint.moved_mm, math.hypot(change, waypoint.of_edges))
            records.append(record)
        return Solution(self.whole, solution.rest_mm, tuple(records))


def solve_steadily(problem: ContactProblem, solve: Callable[[ContactProblem], Solution]) -> Solution:
    """Solve a problem with its slides shortened where they are steady, or as it is where they are not."""
    slide = steady_slide(problem)
    moved = None if slide is None else slide.moved(solve(slide.solved))
    return solve(problem) if moved is None else moved


def steady_slide(problem: ContactProblem) -> SteadySlide | None:
    """Return how a problem is shortened; None if it has no straight slide that goes on far beyond full slip."""
    has_memory = problem.static_friction is not None or problem.mount_stiffness_n_per_mm is not None
    if has_memory or problem.turns_deg or not problem.travel_mm:
        return None
    commands: list[Floats] = []
    parents: list[int] = []
    waypoints: list[int | _Moved] = []
    # By the waypoint that a straight slide begins at, and its direction: the record where it ends, an earlier one, and
    # how far it goes.
    ends: dict[tuple[int, float, float], tuple[int, int, float]] = {}
    lines: dict[int, tuple[int, float, float]] = {}

    def add(command: Floats, parent: int) -> int:
        commands.append(command)
        parents.append(parent)
        return len(commands) - 1

    for (x, y, z), parent in zip(problem.waypoints_mm, problem.parents, strict=True):
        start = np.array(problem.waypoints_mm[parent]) if parent >= 0 else np.zeros(3)
        before = waypoints[parent] if parent >= 0 else -1
        travel, travelled = math.hypot(x, y), math.hypot(*start[:2])
        if travel == 0:
            if travelled > 0:
                return None
            waypoints.append(add(np.array([x, y, z]), before))
            continue
        along = np.array([x, y]) / travel
        if (
            parent < 0
            or start[2] != z
            or travelled > travel
            or np.abs(start[:2] - travelled * along).max() > _STRAIGHT_SHARE * travel
        ):
            return None
        slides_mm = _TRAVELS_TO_SLIP * travel_to_slip_mm(problem, -z)
        if travel <= _SHORTENED_RATIO * slides_mm:
            waypoints.append(add(np.array([x, y, z]), before))
            continue
        root = parent
        while np.any(problem.waypoints_mm[root][:2]):
            root = problem.parents[root]
        # What goes on from a slide is of its line, whatever the rounding of its direction.
        key = lines[parent] if isinstance(before, _Moved) else (root, *along.round(9).tolist())
        lines[len(waypoints)] = key
        if key not in ends:
            # Beyond a waypoint that is solved it is to slide as far as between the two looks.
            ends_mm = max(slides_mm, min(travel, travelled + (1 - _EARLIER_SHARE) * slides_mm))
            end, earlier = before, -1
            if slides_mm > 0:
                earlier = before
                if travelled < _EARLIER_SHARE * slides_mm:
                    earlier = add(np.array([*_EARLIER_SHARE * slides_mm * along, z]), before)
                end = add(np.array([*ends_mm * along, z]), earlier)
            ends[key] = end, earlier, ends_mm
        end, earlier, ends_mm = ends[key]
        of_edges = max(_of_edges(problem, share * along) for share in (ends_mm, travel))
        if of_edges > _LARGEST_OF_EDGES * LARGEST_ESTIMATE[problem.quality.name]:
            return None
        waypoints.append(_Moved(end, earlier, (travel - ends_mm) * along, of_edges))
    if all(isinstance(waypoint, int) for waypoint in waypoints):
        return None
    places = tuple(tuple(float(c) + 0.0 for c in command.round(12)) for command in commands)
    return SteadySlide(
        problem, replace(problem, waypoints_mm=places, parents=tuple(parents)), tuple(waypoints)
    )


def travel_to_slip_mm(problem: ContactProblem, depth_mm: float) -> float:
    """Return about how far a contact travels until all of it slips.

    That is 3 μ P (2 − ν) / (16 a G) of an incompressible half-space (Johnson 1985, eq. 7.42), 1.5 μ d by Hertz, with P
    of the bonded layer (Dimitriadis et al. 2002, Biophys. J. 82:2798) and the layer's own shear beside it.
    """
    area = math.prod(
        max(0.0, high - low) / 2 for low, high in np.reshape(problem.indenter.cut_mm(depth_mm), (2, 2))
    )
    chi = math.sqrt(area / 2) / problem.thickness_mm
    stiffer = 1 + 1.133 * chi + 1.283 * chi**2 + 0.769 * chi**3 + 0.0975 * chi**4
    return 1.5 * problem.friction * depth_mm * stiffer / (1 + 3 * math.pi / 16 * chi)


def _of_edges(problem: ContactProblem, place_mm: Floats) -> float:
    """Return by what share the pad's edges change the force of a contact at a place (2,)."""
    if problem.pad_mm is None:
        return 0.0
    x_min, x_max, y_min, y_max = problem.pad_mm
    x, y = place_mm
    away = min(x_max - x, x - x_min, y_max - y, y - y_min) / problem.thickness_mm
    radius = problem.penetration_radius_mm / problem.thickness_mm
    return _OF_EDGE * radius / _EDGE_RADIUS * 2 ** ((_EDGE_THICKNESSES - away) / _HALVED_BY)


def _moved_record(record: Record, moved_mm: Floats, error: float) -> Record:
    """Return a record's state moved over the plane by (2,), its force off by a share `error` more."""
    shift = np.array([*moved_mm, 0.0])
    return replace(
        record,
        indenter_mm=record.indenter_mm + shift,
        torque_n_mm=record.torque_n_mm + np.cross(shift, record.force_n),
        diagnostics=replace(
            record.diagnostics, slip_mm=record.diagnostics.slip_mm + float(np.linalg.norm(shift))
        ),
        moved_mm=np.array(moved_mm),
        moved_error=error,
    )
