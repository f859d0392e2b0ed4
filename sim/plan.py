"""Which physics problems poses need, who shares them, and which of their solutions serves each pose."""

import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from gelgap.assets.locks import cache_folder, key_lock
from gelgap.assets.names import one_line
from gelgap.assets.progress import shown_progress
from gelgap.sim.grading import check_sharpness
from gelgap.sim.indenter import Floats, Indenter
from gelgap.sim.membrane import GRID_HALF_EXTENT_MM, MembraneState, covered_extent_mm, grid_axes
from gelgap.sim.path import ContactPath, PosePath
from gelgap.sim.problem import ContactProblem, SolveProgress, silent
from gelgap.sim.relief import bridged
from gelgap.sim.scene import CanonicalFrame, Elastomer, Pose, Scene, Sharing, canonical_frame
from gelgap.sim.solution import Solution, load_solution, store_solution
from gelgap.sim.solved import ContactSolve, NoContact, Placement, SolvedPose

LOG = logging.getLogger(__name__)
# At most this many depths share a descent, whose mesh is made for the largest contact: it is this many times as wide as
# the smallest at most.
DEPTHS_PER_DESCENT = 3
_WIDEST_TO_NARROWEST = 2.7
# A solve that takes longer, core seconds, says so before it begins.
_WORTH_SAYING_S = 10.0


@dataclass(frozen=True)
class Solve:
    """One problem to solve, perhaps found in the cache."""

    __repr__ = one_line

    problem: ContactProblem
    cached: bool = True

    @cached_property
    def key(self) -> str:
        return self.problem.key

    @property
    def solves(self) -> "tuple[Solve, ...]":
        """What has to be solved for it: itself, as a library of poses has several."""
        return (self,)

    def served_by(
        self, solutions: Mapping[str, Solution], picture: Callable[[MembraneState], Floats] | None = None
    ) -> Solution:
        """Return its own solution; a picture is not asked for."""
        return solutions[self.key]

    @cached_property
    def expected_core_s(self) -> float:
        """Seconds of a core that the solve takes on a server of 2023; other machines may take twice as long."""
        from gelgap.sim.cost import expected_core_s

        return expected_core_s(self.problem)

    @cached_property
    def forecast(self) -> str:
        """What the solve takes, in words; of a dear one also what would make it cheaper."""
        from gelgap.sim.cost import forecast

        return forecast(self.problem)

    def run(self, progress: SolveProgress = silent) -> Solution:
        """Return the solution from the cache, or solve and keep it.

        A process that needs what another one is solving waits for it.
        """
        if not self.cached:
            return self._solved(progress)
        solution = load_solution(self.key)
        if solution is not None:
            return solution
        with key_lock(
            cache_folder(), self.key, lambda: LOG.info("waiting for another process that solves the same")
        ):
            solution = load_solution(self.key)
            if solution is None:
                solution = self._solved(progress)
                store_solution(solution)
        return solution

    def _solved(self, progress: SolveProgress) -> Solution:
        from gelgap.sim import newton

        problem = self.problem
        half = "half " if problem.symmetric else ""
        what = f"{problem.quality.name} {half}{'pad' if problem.pad_mm or not half else 'disc'}"

        if self.expected_core_s > _WORTH_SAYING_S:
            LOG.info("%s", self.forecast)
        with shown_progress() as show:

            def tell(done: int, total: int) -> None:
                progress(done, total)
                show(f"load steps ({what})", done, total)

            return newton.solve(problem, tell)


@dataclass(frozen=True)
class SolvePlan:
    """The distinct solves of poses, and what follows from them: `placements` has, by its number, each in contact."""

    __repr__ = one_line

    elastomer: Elastomer
    indenter: Indenter
    poses: tuple[Pose, ...]
    solves: tuple[Solve, ...]
    placements: Mapping[int, Placement]

    def solve_key(self, pose_index: int) -> str:
        """Return the key of the solve that serves a pose in contact."""
        return self.solves[self.placements[pose_index].solve].key

    def state(
        self,
        pose_index: int,
        solutions: Mapping[str, Solution],
        half_extent_mm: tuple[float, float] = GRID_HALF_EXTENT_MM,
    ) -> SolvedPose | NoContact:
        """Return the membrane of a pose, made from the solution of its solve by its key; without contact it needs none.

        Its grid covers the contact and reaches at least `half_extent_mm` from the sensor's centre along x and y, but
        no further than the pad if that is larger than the grid by default.
        """
        gel, body, pose = self.elastomer, self.indenter, self.poses[pose_index]
        placement = self.placements.get(pose_index)
        if placement is None:
            axes_mm = grid_axes(covered_extent_mm(gel, body, pose, half_extent_mm))
            return NoContact.untouched(*axes_mm, pose=pose)
        contact = ContactSolve(gel, body, pose, placement, solutions[self.solve_key(pose_index)])
        return contact.state(half_extent_mm)


def plan_solves(
    elastomer: Elastomer,
    indenter: Indenter,
    path: ContactPath | PosePath,
    quality: str = "standard",
    sharing: Sharing | None = None,
) -> SolvePlan:
    """Find the distinct physics problems of a path.

    Raises
    ------
    ValueError
        If a pose lies off the pad or deeper than it allows, a trajectory leaves its point, or there is no such quality.
    """
    return _plan(Scene(elastomer, indenter, quality, sharing or Sharing()), path.poses)


def plan_visit(
    elastomer: Elastomer,
    indenter: Indenter,
    poses: Sequence[Pose],
    quality: str = "standard",
    sharing: Sharing | None = None,
) -> SolvePlan:
    """Find the one problem of poses that the indenter visits one after the other at one point, as one trajectory.

    ValueError if the poses do not share their point, lie off the pad or deeper than it allows, or there is no such
    quality.
    """
    if len({pose.trajectory for pose in poses} - {None}) > 1:
        raise ValueError("poses: are of several trajectories; solve each by itself, or plan them as a path")
    scene = Scene(elastomer, indenter, quality, sharing or Sharing())
    return _plan(scene, tuple(replace(pose, trajectory=0) for pose in poses))


# A problem, and for each pose that it serves the record and the frame to see it from.
_Served = tuple[ContactProblem, dict[int, tuple[int, CanonicalFrame]]]


def _plan(scene: Scene, poses: tuple[Pose, ...]) -> SolvePlan:
    from gelgap.sim.cost import affordable

    for pose in {
        (p.point_x_mm, p.point_y_mm, p.depth_mm, p.radius_mm, p.turn_deg): p for p in poses
    }.values():
        scene.check(pose)
    solves: list[Solve] = []
    placements: dict[int, Placement] = {}
    for problem, served in (*_descent_problems(scene, poses), *_trajectory_problems(scene, poses)):
        for index, (record, frame) in served.items():
            placements[index] = Placement(len(solves), record, frame)
        problem = bridged(problem)
        check_sharpness(problem)
        solves.append(Solve(affordable(problem), scene.sharing.cache))
    return SolvePlan(scene.elastomer, scene.indenter, poses, tuple(solves), placements)


class _Drag(NamedTuple):
    """A press to a depth, then a travel sideways (0 for a press alone) and a turn, as seen in the canonical frame."""

    depth_mm: float
    direction: tuple[float, float]
    travel_mm: float
    turn_deg: tuple[float, ...] = (0.0, 0.0, 0.0)


def _descent_problems(scene: Scene, poses: Sequence[Pose]) -> list[_Served]:
    """Return the problems of poses that belong to no trajectory: those of one point, pad and mesh share descents."""
    frames: dict[int, CanonicalFrame] = {}
    groups: dict[tuple, dict[_Drag, list[int]]] = {}
    for index, pose in enumerate(poses):
        if pose.trajectory is not None or pose.depth_mm == 0:
            continue
        frame = frames[index] = canonical_frame(scene, pose)
        direction = np.round(frame.travel_mm(pose) / (pose.radius_mm or 1.0), 9) + 0.0
        drag = _Drag(pose.depth_mm, tuple(direction.tolist()), pose.radius_mm, frame.command(pose)[3:])
        # A turn needs a mesh of its own.
        alone = (drag if any(drag.turn_deg) else None) if scene.sharing.path else index
        group = groups.setdefault((frame.pad_mm, alone), {})
        group.setdefault(drag, []).append(index)
    problems = []
    for (pad_mm, *_), group in groups.items():
        for share in _descents(scene.indenter, sorted({drag.depth_mm for drag in group})):
            drags = [drag for drag in group if drag.depth_mm in share]
            commands, parents, record_of = _branching_descent(drags)
            served = {index: (record_of[drag], frames[index]) for drag in drags for index in group[drag]}
            problems.append((ContactProblem.of(scene, pad_mm, commands, parents), served))
    # The deepest, which take longest, come first, so that processes which share the solves end together.
    return sorted(problems, key=lambda item: -item[0].depth_mm)


def _descents(indenter: Indenter, depths_mm: list[float]) -> list[Floats]:
    """Share out ascending depths among descents."""
    wide_mm = np.array([indenter.penetration_radius_mm(depth) for depth in depths_mm])
    shares, left = [], np.array(depths_mm)
    while len(left):
        alike = left[wide_mm[: len(left)] * _WIDEST_TO_NARROWEST >= wide_mm[len(left) - 1]]
        # Two depths get a descent each, for two cores: the drags that branch off take most of the time.
        wanted = max(2, math.ceil(len(alike) / DEPTHS_PER_DESCENT))
        shares += np.array_split(alike, min(len(alike), wanted))
        left = left[: len(left) - len(alike)]
    return shares


def _trajectory_problems(scene: Scene, poses: Sequence[Pose]) -> Iterator[_Served]:
    """Yield the problem of each trajectory that makes contact."""
    trajectories: dict[int, list[int]] = {}
    for index, pose in enumerate(poses):
        if pose.trajectory is not None:
            trajectories.setdefault(pose.trajectory, []).append(index)
    for members in trajectories.values():
        visited = [poses[index] for index in members]
        if len({(pose.point_x_mm, pose.point_y_mm) for pose in visited}) > 1:
            raise ValueError("poses: must share one contact point to be visited in one go")
        if not any(pose.depth_mm for pose in visited):
            continue
        furthest = max(visited, key=lambda pose: (pose.radius_mm, np.linalg.norm(pose.roll_deg)))
        frame = canonical_frame(scene, replace(furthest, depth_mm=max(pose.depth_mm for pose in visited)))
        waypoints = [frame.command(pose) for pose in visited]
        x, y, z, *turn = waypoints[0]
        if any((x, y, *turn)):
            # The first pose is reached straight down and then sideways.
            waypoints.insert(0, (0.0, 0.0, z, 0.0, 0.0, 0.0))
        records = range(len(waypoints) - len(visited), len(waypoints))
        served = {
            index: (record, frame)
            for index, record in zip(members, records, strict=True)
            if poses[index].depth_mm
        }
        yield ContactProblem.of(scene, frame.pad_mm, waypoints, range(-1, len(waypoints) - 1)), served


def _branching_descent(
    drags: list[_Drag],
) -> tuple[tuple[tuple[float, ...], ...], tuple[int, ...], dict[_Drag, int]]:
    """Lead through the depths; at each, a branch for every direction goes through its travels.

    Returns waypoints and parents, as in a `ContactProblem`, and by drag the waypoint that it ends on.
    """
    waypoints: list[tuple[float, ...]] = []
    parents: list[int] = []
    record_of: dict[_Drag, int] = {}
    press, depth, direction = -1, 0.0, (0.0, 0.0)
    for drag in sorted(drags):
        if drag.depth_mm != depth:
            parents.append(press)
            press, depth, direction = len(waypoints), drag.depth_mm, (0.0, 0.0)
            waypoints.append((0.0, 0.0, -depth, 0.0, 0.0, 0.0))
        if drag.travel_mm == 0 and not any(drag.turn_deg):
            record_of[drag] = press
        else:
            parents.append(len(waypoints) - 1 if drag.direction == direction else press)
            direction, (x, y) = drag.direction, drag.direction
            record_of[drag] = len(waypoints)
            waypoints.append((x * drag.travel_mm, y * drag.travel_mm, -depth, *drag.turn_deg))
    return tuple(waypoints), tuple(parents), record_of
