"""Which physics problems a path needs, and which of their solutions serves each pose."""

import logging
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gelgap.assets.locks import cache_folder, key_lock
from gelgap.sim.cache import load_solution, store_solution
from gelgap.sim.canonical_frame import CanonicalFrame, canonical_frame, placed_state
from gelgap.sim.elastomer import Elastomer
from gelgap.sim.indenters.base import Indenter
from gelgap.sim.membrane import GRID_HALF_EXTENT_MM, MembraneState, flat_state
from gelgap.sim.mesh.scale import contact_width, mesh_scale
from gelgap.sim.newton import SolveProgress, silent
from gelgap.sim.pace import timed_solve
from gelgap.sim.path import ContactPath, Pose, PosePath
from gelgap.sim.problem import ContactProblem, Waypoint
from gelgap.sim.scene import Scene, Sharing
from gelgap.sim.solution import Solution

LOG = logging.getLogger(__name__)
# At most this many depths share a descent.
_DEPTHS_PER_DESCENT = 3
# A membrane's grid covers a contact as far as this many of the radii at which the indenter cuts the rest plane.
_COVERED_RADII = 1.5


@dataclass(frozen=True)
class Solve:
    """One problem to solve, perhaps found in the cache."""

    problem: ContactProblem
    cached: bool = True

    @cached_property
    def key(self) -> str:
        return self.problem.key

    def run(self, progress: SolveProgress = silent) -> Solution:
        """Return the solution from the cache, or solve and keep it.

        A process that needs what another one is solving waits for it.
        """
        if not self.cached:
            return timed_solve(self.problem, progress)
        solution = load_solution(self.key)
        if solution is not None:
            return solution
        with key_lock(
            cache_folder(), self.key, lambda: LOG.info("waiting for another process that solves the same")
        ):
            solution = load_solution(self.key)
            if solution is None:
                solution = timed_solve(self.problem, progress)
                store_solution(solution)
        return solution


@dataclass(frozen=True)
class Placement:
    """How a pose follows from a solve: by which of its records, seen from which frame."""

    solve: int
    record: int
    frame: CanonicalFrame


@dataclass(frozen=True)
class SolvePlan:
    """The distinct solves of a path, and the poses made from them; a pose without contact has no placement."""

    elastomer: Elastomer
    indenter: Indenter
    poses: tuple[Pose, ...]
    solves: tuple[Solve, ...]
    placements: tuple[Placement | None, ...]

    def solve_key(self, pose_index: int) -> str:
        """Return the key of the solve that serves a pose; a reference without contact is served by any."""
        placement = self.placements[pose_index]
        return self.solves[placement.solve if placement else 0].key

    def state(
        self,
        pose_index: int,
        solution: Solution | None,
        half_extent_mm: tuple[float, float] = GRID_HALF_EXTENT_MM,
    ) -> MembraneState:
        """Return the membrane of a pose, made from the solution of its solve; without contact it needs none.

        Its grid covers the contact and reaches at least `half_extent_mm` from the sensor's centre along x and y, but
        no further than the pad if that is larger than the grid by default.
        """
        pose, placement = self.poses[pose_index], self.placements[pose_index]
        half_extent_mm = self._half_extent_mm(pose, half_extent_mm)
        if placement is None:
            return flat_state(half_extent_mm)
        return placed_state(self.elastomer, pose, placement.frame, solution, placement.record, half_extent_mm)

    def _half_extent_mm(self, pose: Pose, wanted_mm: tuple[float, float]) -> tuple[float, float]:
        reach_mm = pose.radius_mm + _COVERED_RADII * self.indenter.penetration_radius_mm(pose.depth_mm)
        points_mm = pose.point_x_mm, pose.point_y_mm
        x_mm, y_mm = (
            min(max(wanted, abs(point) + reach_mm), size / 2)
            for wanted, point, size in zip(wanted_mm, points_mm, self.elastomer.pad_size_mm, strict=True)
        )
        return x_mm, y_mm


# A problem, and for each pose that it serves the record and the frame to see it from.
_Served = tuple[ContactProblem, dict[int, tuple[int, CanonicalFrame]]]


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
    scene = Scene(elastomer, indenter, quality, sharing or Sharing())
    poses = path.poses
    for pose in {(p.point_x_mm, p.point_y_mm, p.depth_mm, p.radius_mm): p for p in poses}.values():
        scene.check(pose)
    solves: list[Solve] = []
    placements: list[Placement | None] = [None] * len(poses)
    for problem, served in (*_descent_problems(scene, poses), *_trajectory_problems(scene, poses)):
        for index, (record, frame) in served.items():
            placements[index] = Placement(len(solves), record, frame)
        solves.append(Solve(problem, scene.sharing.cache))
    return SolvePlan(elastomer, indenter, poses, tuple(solves), tuple(placements))


def _descent_problems(scene: Scene, poses: Sequence[Pose]) -> list[_Served]:
    """Return the problems of poses that belong to no trajectory: those of one point, pad and mesh share descents."""
    frames: dict[int, CanonicalFrame] = {}
    groups: dict[tuple, dict[_Drag, list[int]]] = {}
    for index, pose in enumerate(poses):
        if pose.trajectory is not None or pose.depth_mm == 0:
            continue
        frame = frames[index] = canonical_frame(scene, pose)
        direction = np.round(frame.travel_mm(pose) / (pose.radius_mm or 1.0), 9) + 0.0
        drag = _Drag(pose.depth_mm, tuple(direction.tolist()), pose.radius_mm)
        contact = (scene.indenter, scene.elastomer.thickness_mm, pose.depth_mm)
        fineness = (mesh_scale(*contact), contact_width(*contact))
        alone = None if scene.sharing.path else index
        group = groups.setdefault((frame.pad_mm, fineness, alone), {})
        group.setdefault(drag, []).append(index)
    problems = []
    for (pad_mm, *_), group in groups.items():
        for drags in _shared_descents(list(group)):
            waypoints_mm, parents, record_of = _branching_descent(drags)
            served = {index: (record_of[drag], frames[index]) for drag in drags for index in group[drag]}
            problems.append((scene.problem(pad_mm, waypoints_mm, parents), served))
    # The deepest, which take longest, come first, so that processes which share the solves end together.
    return sorted(problems, key=lambda item: -item[0].depth_mm)


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
        frame = canonical_frame(scene, max(visited, key=lambda pose: pose.radius_mm))
        travels = [np.round(frame.travel_mm(pose), 12) + 0.0 for pose in visited]
        waypoints = [(x, y, -pose.depth_mm) for (x, y), pose in zip(travels, visited, strict=True)]
        if travels[0].any():
            # The first pose is reached straight down and then sideways.
            waypoints.insert(0, (0.0, 0.0, waypoints[0][2]))
        records = range(len(waypoints) - len(visited), len(waypoints))
        served = {
            index: (record, frame)
            for index, record in zip(members, records, strict=True)
            if poses[index].depth_mm
        }
        yield scene.problem(frame.pad_mm, tuple(waypoints), tuple(range(-1, len(waypoints) - 1))), served


@dataclass(frozen=True, order=True)
class _Drag:
    """A press to a depth, then a travel sideways (0 for a press alone), as seen in the canonical frame."""

    depth_mm: float
    direction: tuple[float, float]
    travel_mm: float


def _shared_descents(drags: list[_Drag]) -> list[list[_Drag]]:
    """Divide drags at one point among descents, each through neighbouring depths."""
    depths = sorted({drag.depth_mm for drag in drags})
    # Two depths get a descent each, for two cores: the drags that branch off take most of the time.
    wanted = max(2, math.ceil(len(depths) / _DEPTHS_PER_DESCENT))
    shares = np.array_split(np.array(depths), min(len(depths), wanted))
    return [[drag for drag in drags if drag.depth_mm in share] for share in shares]


def _branching_descent(
    drags: list[_Drag],
) -> tuple[tuple[Waypoint, ...], tuple[int, ...], dict[_Drag, int]]:
    """Lead through the depths; at each, a branch for every direction goes through its travels.

    Returns waypoints and parents, as in a `ContactProblem`, and by drag the waypoint that it ends on.
    """
    waypoints: list[Waypoint] = []
    parents: list[int] = []
    record_of: dict[_Drag, int] = {}
    press, depth, direction = -1, 0.0, (0.0, 0.0)
    for drag in sorted(drags):
        if drag.depth_mm != depth:
            parents.append(press)
            press, depth, direction = len(waypoints), drag.depth_mm, (0.0, 0.0)
            waypoints.append((0.0, 0.0, -depth))
        if drag.travel_mm == 0:
            record_of[drag] = press
        else:
            parents.append(len(waypoints) - 1 if drag.direction == direction else press)
            direction, (x, y) = drag.direction, drag.direction
            record_of[drag] = len(waypoints)
            waypoints.append((x * drag.travel_mm, y * drag.travel_mm, -depth))
    return tuple(waypoints), tuple(parents), record_of
