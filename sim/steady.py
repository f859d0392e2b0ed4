"""Slides of any length: a straight drag that slides wholly goes on as it is, so that its state is moved, not solved.

The mesh and the load steps of a long slide then are those of its beginning. A slide of 1 mm, five times
the depth, takes a quarter of the time.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from gelgap.sim.estimate import LARGEST_ESTIMATE
from gelgap.sim.indenter import Floats
from gelgap.sim.problem import MESHES, ContactProblem, SolveProgress, silent
from gelgap.sim.solution import Record, Solution

# Chosen beside slides that were solved to their ends; the file says what each does.
_SLIDE = SimpleNamespace(**MESHES["slide"])


@dataclass(frozen=True)
class _End:
    """The `record` of a solved problem in which a slide is steady, `place_mm` (2,) from where the whole one begins.

    `earlier` is the record some way before that one, −1 where nothing resists the slide.
    """

    problem: int
    record: int
    earlier: int
    place_mm: Floats


@dataclass(frozen=True)
class _Moved:
    """A waypoint that is `moved_mm` (2,) from a slide's end, between which edges change the force by `of_edges`."""

    end: _End
    moved_mm: Floats
    of_edges: float


class _Look(NamedTuple):
    """By what share of it a slide's force changes from an earlier record to its end, and what share sticks at least."""

    change: float
    sticking: float


@dataclass(frozen=True)
class SteadySlide:
    """A problem whose slides end where they are steady, and what each waypoint of the `whole` problem is in it.

    What `solved` begins with has all waypoints that are not moved, by their numbers; the others, each a slide that ends
    where the pad's edges are as near as they are to a waypoint, are pressed where they begin.
    """

    whole: ContactProblem
    solved: tuple[ContactProblem, ...]
    waypoints: tuple[int | _Moved, ...]

    def looks(self, solutions: Sequence[Solution]) -> list[_Look]:
        """Return what the two looks at each slide that converged show, of those solved so far."""
        ends = [waypoint.end for waypoint in self.waypoints if isinstance(waypoint, _Moved)]
        done = [end for end in ends if end.earlier >= 0 and end.problem < len(solutions)]
        return [_look(solutions, end) for end in done if solutions[end.problem].records[end.record].converged]

    def moved(self, solutions: Sequence[Solution]) -> Solution:
        """Return the solution of the whole problem from those of the solved ones."""
        records = []
        for waypoint in self.waypoints:
            if isinstance(waypoint, int):
                records.append(solutions[0].records[waypoint])
                continue
            end = waypoint.end
            record = solutions[end.problem].records[end.record]
            change = _look(solutions, end).change if end.earlier >= 0 else 0.0
            shift_mm = end.place_mm + waypoint.moved_mm - record.indenter_mm[:2]
            record = _moved_record(record, shift_mm, math.hypot(change, waypoint.of_edges))
            records.append(replace(record, mesh=end.problem))
        rest_mm = tuple(solution.rest_mm[0] for solution in solutions)
        return Solution(self.whole, rest_mm, tuple(records))


def _look(solutions: Sequence[Solution], end: _End) -> _Look:
    records = solutions[end.problem].records
    record, earlier = records[end.record], records[end.earlier]
    change = np.linalg.norm(record.force_n - earlier.force_n) / np.linalg.norm(record.force_n)
    sticking = min(record.diagnostics.sticking_fraction, earlier.diagnostics.sticking_fraction)
    return _Look(float(change), float(sticking))


def solve_steadily(
    problem: ContactProblem,
    solve: Callable[[ContactProblem, SolveProgress], Solution],
    progress: SolveProgress = silent,
) -> Solution:
    """Solve a problem with its slides shortened where they are steady, or as it is where they are not.

    The first slide that is not steady where it was to be ends a pass: in the next, slides are twice as long, and what
    both have in common, such as the press, is not solved again. One that slides wholly twice and still changes does so
    as its vertices come and go, however far it is: the change is its stated error.
    """
    travels = _SLIDE.travels_to_slip
    slid_wholly = False
    largest = _largest_change(problem)
    solved: dict[ContactProblem, Solution] = {}
    while (slide := steady_slide(problem, travels)) is not None:
        total = sum(part.load_steps for part in slide.solved)
        before = 0
        solutions: list[Solution] = []
        for part in slide.solved:
            if part not in solved:
                solved[part] = solve(part, _as_part(progress, before, total))
            before += part.load_steps
            solutions.append(solved[part])
            looks = slide.looks(solutions)
            slides_wholly = all(look.sticking <= _SLIDE.sticking_share for look in looks)
            if not (slides_wholly and (slid_wholly or all(look.change <= largest for look in looks))):
                break
        else:
            return slide.moved(solutions)
        travels, slid_wholly = 2 * travels, slides_wholly
    return solve(problem, progress)


def _as_part(progress: SolveProgress, before: int, total: int) -> SolveProgress:
    """Return the progress of a part of a solve, `before` which as many load steps of the `total` are done."""

    def told(done: int, _: int) -> None:
        progress(before + done, total)

    return told


def solved_problems(problem: ContactProblem) -> tuple[ContactProblem, ...]:
    """Return what is solved for a problem."""
    slide = steady_slide(problem)
    return (problem,) if slide is None else slide.solved


def steady_slide(
    problem: ContactProblem, travels_to_slip: float = _SLIDE.travels_to_slip
) -> SteadySlide | None:
    """Return how a problem is shortened; None if it has no straight slide that goes on far beyond full slip.

    That is `travels_to_slip` times the travel to it.
    """
    has_memory = problem.static_friction is not None or problem.mount_stiffness_n_per_mm is not None
    if has_memory or problem.turns_deg or not problem.travel_mm:
        return None
    commands: list[Floats] = []
    parents: list[int] = []
    others: list[ContactProblem] = []
    waypoints: list[int | _Moved] = []
    largest = _largest_change(problem)
    # By the waypoint that a straight slide begins at, and its direction.
    ends: dict[tuple[int, float, float], list[_End]] = {}
    lines: dict[int, tuple[int, float, float]] = {}

    def add(command: Floats, parent: int) -> int:
        commands.append(command)
        parents.append(parent)
        return len(commands) - 1

    for (x, y, z), parent in zip(problem.waypoints_mm, problem.parents, strict=True):
        start = np.array(problem.waypoints_mm[parent]) if parent >= 0 else np.zeros(3)
        before: int | _Moved = waypoints[parent] if parent >= 0 else -1
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
            or np.abs(start[:2] - travelled * along).max() > _SLIDE.straight_share * travel
        ):
            return None
        slides_mm = travels_to_slip * travel_to_slip_mm(problem, -z)
        if travel <= _SLIDE.shortened_ratio * slides_mm:
            waypoints.append(add(np.array([x, y, z]), before))
            continue
        root = parent
        while np.any(problem.waypoints_mm[root][:2]):
            root = problem.parents[root]
        # What goes on from a slide is of its line, whatever the rounding of its direction.
        key = lines[parent] if isinstance(before, _Moved) else (root, *along.round(9).tolist())
        lines[len(waypoints)] = key
        place_mm = np.array([x, y])
        of_line = ends.setdefault(key, [])
        # Beyond a waypoint that is solved it is to slide as far as between the two looks.
        first_mm = max(slides_mm, min(travel, travelled + (1 - _SLIDE.earlier_share) * slides_mm)) * along
        near_enough = _of_edges(problem, first_mm, place_mm) <= largest
        if isinstance(before, int) and not of_line and near_enough:
            last, earlier = before, -1
            if slides_mm > 0:
                earlier = before
                if travelled < _SLIDE.earlier_share * slides_mm:
                    earlier = add(np.array([*_SLIDE.earlier_share * slides_mm * along, z]), before)
                last = add(np.array([*first_mm, z]), earlier)
            of_line.append(_End(0, last, earlier, first_mm))
        serving = [end for end in of_line if _of_edges(problem, end.place_mm, place_mm) <= largest]
        if not serving:
            others.append(_slide_that_ends(problem, place_mm, slides_mm * along, z))
            last = len(others[-1].parents) - 1
            serving = [_End(len(others), last, last - 1, place_mm)]
            of_line += serving
        end = serving[0]
        waypoints.append(_Moved(end, place_mm - end.place_mm, _of_edges(problem, end.place_mm, place_mm)))
    if all(isinstance(waypoint, int) for waypoint in waypoints):
        return None
    places = tuple(tuple(float(c) + 0.0 for c in command.round(12)) for command in commands)
    first = replace(problem, waypoints_mm=places, parents=tuple(parents))
    return SteadySlide(problem, (first, *others), tuple(waypoints))


def _slide_that_ends(
    problem: ContactProblem, place_mm: Floats, slide_mm: Floats, z_mm: float
) -> ContactProblem:
    """Return the problem of a slide by (2,) at a height that ends at a place (2,), in the frame where it begins."""
    shift_mm = place_mm - slide_mm
    shares = (0.0, _SLIDE.earlier_share, 1.0) if slide_mm.any() else (0.0,)
    places = [(*(share * slide_mm).round(12).tolist(), z_mm) for share in shares]
    edges_mm = np.array(problem.pad_mm) - np.repeat(shift_mm, 2)
    return replace(
        problem,
        pad_mm=tuple(edges_mm.tolist()),
        waypoints_mm=tuple(places),
        parents=tuple(range(-1, len(places) - 1)),
    )


def travel_to_slip_mm(problem: ContactProblem, depth_mm: float) -> float:
    """Return about how far a contact travels until all of it slips.

    That is 3 μ P (2 − ν) / (16 a G) of an incompressible half-space (Johnson 1985, eq. 7.42), 1.5 μ d by Hertz, with P
    of the bonded layer (Dimitriadis et al. 2002, Biophys. J. 82:2798) and the layer's own shear beside it.
    """
    area = math.prod(np.ptp(problem.indenter.cut_mm(depth_mm), axis=1).tolist()) / 4
    chi = math.sqrt(area / 2) / problem.thickness_mm
    stiffer = 1 + 1.133 * chi + 1.283 * chi**2 + 0.769 * chi**3 + 0.0975 * chi**4
    return 1.5 * problem.friction * depth_mm * stiffer / (1 + 3 * math.pi / 16 * chi)


def _largest_change(problem: ContactProblem) -> float:
    """Return by what share of its force a slide that counts as steady may be off for one reason."""
    return _SLIDE.largest_change * LARGEST_ESTIMATE[problem.quality.name]


def _of_edges(problem: ContactProblem, place_mm: Floats, other_mm: Floats) -> float:
    """Return by what share the pad's edges change the force of a contact between two places (2,)."""
    if problem.pad_mm is None:
        return 0.0
    edges_mm, outwards = np.reshape(problem.pad_mm, (2, 2)), np.array([-1.0, 1.0])
    away_mm = np.stack([outwards * (edges_mm - place[:, None]) for place in (place_mm, other_mm)])
    radius = problem.penetration_radius_mm / problem.thickness_mm
    nearness = 2 ** ((_SLIDE.edge_thicknesses - away_mm / problem.thickness_mm) / _SLIDE.halved_by)
    shares = _SLIDE.of_edge * radius / _SLIDE.edge_radius * nearness
    return float(np.abs(shares[1] - shares[0]).sum())


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
