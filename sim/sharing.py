"""Which physics problems a path needs, and how each pose's membrane follows from a problem's solution."""

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.cache import load_solution, store_solution
from gelgap.sim.elastomer import Elastomer
from gelgap.sim.equivalent_material import equivalent_material
from gelgap.sim.indentation import Solution, solve
from gelgap.sim.indenter import Sphere
from gelgap.sim.membrane import MembraneState, grid_axes
from gelgap.sim.path import ContactPath, Pose, PosePath
from gelgap.sim.problem import ContactProblem, Waypoint
from gelgap.sim.problem_mesh import mesh_scale
from gelgap.sim.quality import quality_named
from gelgap.sim.surface import PolarTable, contact_radius_mm, polar_table, pressed_onto_sphere

# A canonical gel is solved once; forces scale with the modulus at fixed friction, geometry and mount over modulus.
_CANONICAL_MODULUS_MPA = 0.3
# A contact is interior if the pad's edges are further away than this many thicknesses (docs/physics.md).
_INTERIOR_THICKNESSES = 2.4
# So many depths share a descent, but two cores get one each: the drags that branch off take most of the time.
_DEPTHS_OF_A_DESCENT = 3


@dataclass(frozen=True)
class Sharing:
    """What solves are shared over; each saving can be switched off.

    `modulus`: one solve serves every Young's modulus. `translation`: interior points share theirs, which also makes
    directions rotations of each other and half the gel enough. `reflection`: on a small pad, mirrored points and
    directions share theirs. `path`: poses at one point share descents, off which drags branch at their depths.
    `cache`: solutions are kept on disk.
    """

    modulus: bool = True
    translation: bool = True
    reflection: bool = True
    path: bool = True
    cache: bool = True


@dataclass(frozen=True)
class Solve:
    """One problem to solve, perhaps found in the cache."""

    problem: ContactProblem
    cached: bool = True

    @cached_property
    def key(self) -> str:
        return self.problem.key

    def run(self) -> Solution:
        """Return the solution from the cache, or solve and keep it."""
        solution = load_solution(self.key) if self.cached else None
        if solution is None:
            solution = solve(self.problem)
            if self.cached:
                store_solution(solution)
        return solution


@dataclass(frozen=True)
class Placement:
    """How a pose follows from a solve: which record, and from the canonical frame to the sensor's.

    `frame` (2, 2) is orthogonal: a rotation for an interior point, a reflection on a small pad.
    """

    solve: int
    record: int
    frame: NDArray[np.float64]


@dataclass(frozen=True)
class SolvePlan:
    """The distinct solves of a path, and the poses made from them."""

    elastomer: Elastomer
    indenter: Sphere
    poses: tuple[Pose, ...]
    solves: tuple[Solve, ...]
    placements: tuple[Placement | None, ...]

    def solve_key(self, pose_index: int) -> str:
        """Return the key of the solve that serves a pose; a reference without contact is served by any."""
        placement = self.placements[pose_index]
        return self.solves[placement.solve if placement else 0].key

    def state(self, pose_index: int, solution: Solution) -> MembraneState:
        """Return the membrane of a pose, made from the solution of its solve."""
        pose, placement = self.poses[pose_index], self.placements[pose_index]
        if placement is None:
            return flat_state()
        return placed_state(self.elastomer, pose, placement, solution)


def plan_solves(
    elastomer: Elastomer,
    indenter: Sphere,
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
    sharing = sharing or Sharing()
    poses = path.poses
    for pose in {(p.point_x_mm, p.point_y_mm, p.depth_mm): p for p in poses}.values():
        check_pose(elastomer, indenter, pose)
    groups: dict[tuple, list[_Drag]] = {}
    frames: dict[int, NDArray[np.float64]] = {}
    trajectories: dict[int, list[int]] = {}
    for index, pose in enumerate(poses):
        if pose.trajectory is not None:
            trajectories.setdefault(pose.trajectory, []).append(index)
            continue
        if pose.depth_mm == 0:
            continue
        origin, frame, pad = canonical_contact(elastomer, pose, sharing)
        frames[index] = frame
        way = frame.T @ np.array([pose.shear_x_mm, pose.shear_y_mm])
        direction = tuple(float(c) + 0.0 for c in np.round(way / (pose.radius_mm or 1.0), 9))
        fineness = mesh_scale(indenter.radius_mm, elastomer.thickness_mm, pose.depth_mm)
        alone = () if sharing.path else (index,)
        drag = _Drag(pose.depth_mm, direction, pose.radius_mm, index)
        groups.setdefault((pad, origin, fineness, *alone), []).append(drag)
    descents = [(pad, drags) for (pad, *_), group in groups.items() for drags in _descents(group)]
    # The deepest, which take longest, come first, so that processes which share the solves end together.
    descents.sort(key=lambda descent: -max(drag.depth_mm for drag in descent[1]))
    solves: list[Solve] = []
    placements: list[Placement | None] = [None] * len(poses)
    for pad, drags in descents:
        waypoints, parents, record_of = _branching_ways(drags)
        problem = contact_problem(elastomer, indenter, pad, waypoints, parents, quality, sharing)
        for drag in drags:
            placements[drag.pose] = Placement(len(solves), record_of[drag.way], frames[drag.pose])
        solves.append(Solve(problem, sharing.cache))
    for members in trajectories.values():
        problem, frame, records = visiting_problem(
            elastomer, indenter, tuple(poses[index] for index in members), quality, sharing
        )
        if problem is None:
            continue
        for index, record in zip(members, records, strict=True):
            if poses[index].depth_mm:
                placements[index] = Placement(len(solves), record, frame)
        solves.append(Solve(problem, sharing.cache))
    return SolvePlan(elastomer, indenter, poses, tuple(solves), tuple(placements))


@dataclass(frozen=True)
class _Drag:
    """A pose in its canonical frame: down to a depth, then sideways by a radius (0 for a press alone)."""

    depth_mm: float
    direction: tuple[float, float]
    radius_mm: float
    pose: int

    @property
    def way(self) -> tuple[float, tuple[float, float], float]:
        return self.depth_mm, self.direction, self.radius_mm


def _descents(drags: list[_Drag]) -> list[list[_Drag]]:
    """Divide drags at one point into descents, each through neighbouring depths."""
    depths = sorted({drag.depth_mm for drag in drags})
    count = min(len(depths), max(2, math.ceil(len(depths) / _DEPTHS_OF_A_DESCENT)))
    return [
        [drag for drag in drags if drag.depth_mm in shared]
        for shared in np.array_split(np.array(depths), count)
    ]


def _branching_ways(
    drags: list[_Drag],
) -> tuple[tuple[Waypoint, ...], tuple[int, ...], dict[tuple[float, tuple[float, float], float], int]]:
    """Return waypoints and parents of a descent off which drags branch at their depths, and each drag's record."""
    waypoints: list[Waypoint] = []
    parents: list[int] = []
    record_of: dict[tuple[float, tuple[float, float], float], int] = {}
    press, depth, direction = -1, 0.0, (0.0, 0.0)
    for drag in sorted(drags, key=lambda drag: drag.way):
        if drag.depth_mm != depth:
            parents.append(press)
            press, depth, direction = len(waypoints), drag.depth_mm, (0.0, 0.0)
            waypoints.append((0.0, 0.0, -depth))
        if drag.radius_mm == 0:
            record_of[drag.way] = press
        elif drag.way not in record_of:
            parents.append(len(waypoints) - 1 if drag.direction == direction else press)
            direction, (x, y) = drag.direction, drag.direction
            record_of[drag.way] = len(waypoints)
            waypoints.append((x * drag.radius_mm + 0.0, y * drag.radius_mm + 0.0, -depth))
    return tuple(waypoints), tuple(parents), record_of


def visiting_problem(
    elastomer: Elastomer, indenter: Sphere, poses: tuple[Pose, ...], quality: str, sharing: Sharing
) -> tuple[ContactProblem | None, NDArray[np.float64], tuple[int, ...]]:
    """Return the problem of poses that are visited one after the other, the canonical frame, and each pose's record.

    The first pose is reached straight down and then sideways, each further one in a straight line. Without a pose in
    contact there is no problem.

    Raises
    ------
    ValueError
        If the poses do not share one contact point.
    """
    if len({(pose.point_x_mm, pose.point_y_mm) for pose in poses}) > 1:
        raise ValueError("poses: must share one contact point to be visited in one go")
    _, frame, pad = canonical_contact(elastomer, max(poses, key=lambda pose: pose.radius_mm), sharing)
    ways = [np.round(frame.T @ np.array([pose.shear_x_mm, pose.shear_y_mm]), 12) + 0.0 for pose in poses]
    waypoints = [(float(x), float(y), -pose.depth_mm) for (x, y), pose in zip(ways, poses, strict=True)]
    sideways = ways[0].any()
    if sideways:
        waypoints.insert(0, (0.0, 0.0, waypoints[0][2]))
    records = tuple(range(int(sideways), len(waypoints)))
    if not any(pose.depth_mm for pose in poses):
        return None, frame, records
    parents = tuple(range(-1, len(waypoints) - 1))
    problem = contact_problem(elastomer, indenter, pad, tuple(waypoints), parents, quality, sharing)
    return problem, frame, records


def check_pose(elastomer: Elastomer, indenter: Sphere, pose: Pose) -> None:
    """Raise ValueError if the pose lies off the pad or deeper than the pad or the sphere allows."""
    half_x, half_y = elastomer.pad_size_mm[0] / 2, elastomer.pad_size_mm[1] / 2
    for name, value, half in (
        ("point_x_mm", pose.point_x_mm, half_x),
        ("point_y_mm", pose.point_y_mm, half_y),
    ):
        if abs(value) > half:
            raise ValueError(f"{name} = {value:g}: lies off the pad, must be in [{-half:g}, {half:g}] mm")
    deepest = min(0.6 * elastomer.thickness_mm, indenter.diameter_mm / 2)
    if pose.depth_mm > deepest:
        raise ValueError(
            f"depth_mm = {pose.depth_mm:g}: must be in [0, {deepest:g}] mm, which is 0.6 of the pad's thickness and at "
            "most the indenter's radius"
        )
    if pose.radius_mm > elastomer.thickness_mm:
        raise ValueError(
            f"shear = {pose.radius_mm:g} mm: must be at most the pad's thickness, {elastomer.thickness_mm:g} mm"
        )


def flat_state() -> MembraneState:
    """Return the undeformed membrane."""
    x_mm, y_mm = grid_axes()
    shape = (len(y_mm), len(x_mm))
    return MembraneState(
        x_mm,
        y_mm,
        np.zeros((*shape, 3), np.float32),
        np.zeros(shape, dtype=bool),
        np.zeros(3),
        converged=True,
    )


def canonical_contact(
    elastomer: Elastomer, pose: Pose, sharing: Sharing
) -> tuple[tuple[float, float], NDArray[np.float64], tuple[float, float, float, float] | None]:
    """Return the canonical contact point, the frame that leads from it to the pose, and the pad around it."""
    half_x, half_y = elastomer.pad_size_mm[0] / 2, elastomer.pad_size_mm[1] / 2
    x, y = pose.point_x_mm, pose.point_y_mm
    to_edge = min(half_x - abs(x), half_y - abs(y))
    if sharing.translation and to_edge >= _INTERIOR_THICKNESSES * elastomer.thickness_mm:
        angle = math.atan2(pose.shear_y_mm, pose.shear_x_mm)
        cosine, sine = math.cos(angle), math.sin(angle)
        return (0.0, 0.0), np.array([[cosine, -sine], [sine, cosine]]), None
    mirror = np.ones(2)
    if sharing.reflection:
        # Mirror to the pad's first quadrant; on an axis of the pad the shear decides.
        mirror[0] = -1.0 if x < 0 or (x == 0 and pose.shear_x_mm < -1e-12) else 1.0
        mirror[1] = -1.0 if y < 0 or (y == 0 and pose.shear_y_mm < -1e-12) else 1.0
    x, y = x * mirror[0] + 0.0, y * mirror[1] + 0.0
    pad = tuple(round(value, 9) + 0.0 for value in (-half_x - x, half_x - x, -half_y - y, half_y - y))
    return (x, y), np.diag(mirror), pad


def contact_problem(
    elastomer: Elastomer,
    indenter: Sphere,
    pad: tuple[float, float, float, float] | None,
    waypoints: tuple[Waypoint, ...],
    parents: tuple[int, ...],
    quality: str,
    sharing: Sharing,
) -> ContactProblem:
    mesh_and_steps = quality_named(quality)
    young, poisson = _mujoco_material(elastomer)
    scale = _CANONICAL_MODULUS_MPA / elastomer.young_modulus_mpa if sharing.modulus else 1.0
    mount = elastomer.mount_stiffness_n_per_mm
    return ContactProblem(
        young_modulus_mpa=round(young * scale, 12),
        poisson_ratio=poisson,
        friction=elastomer.friction,
        thickness_mm=elastomer.thickness_mm,
        sphere_radius_mm=indenter.radius_mm,
        mount_stiffness_n_per_mm=None if mount is None else round(mount * scale, 9),
        pad_mm=pad,
        waypoints_mm=waypoints,
        parents=parents,
        quality=mesh_and_steps,
    )


def _mujoco_material(elastomer: Elastomer) -> tuple[float, float]:
    """Return the modulus and Poisson's ratio that make MuJoCo's energy act as the elastomer's."""
    young, poisson = elastomer.young_modulus_mpa, elastomer.poisson_ratio
    if elastomer.strain_energy == "isochoric":
        young, poisson = equivalent_material(young, poisson)
    return young, poisson


def placed_state(elastomer: Elastomer, pose: Pose, placement: Placement, solution: Solution) -> MembraneState:
    record, problem = solution.records[placement.record], solution.problem
    frame = placement.frame
    x_mm, y_mm = grid_axes()
    relative = np.stack(np.meshgrid(x_mm - pose.point_x_mm, y_mm - pose.point_y_mm), axis=-1) @ frame
    displacement = _table(solution, placement.record).at(relative[..., 0], relative[..., 1])
    position = displacement.copy()
    position[..., :2] += relative
    centre = record.indenter_mm + np.array([0.0, 0.0, problem.sphere_radius_mm])
    position, contact = pressed_onto_sphere(position, centre, problem.sphere_radius_mm)
    position[..., :2] -= relative
    position[..., :2] = position[..., :2] @ frame.T
    young, _ = _mujoco_material(elastomer)
    force = record.force_n * (young / problem.young_modulus_mpa)
    return MembraneState(
        x_mm=x_mm,
        y_mm=y_mm,
        displacement_mm=position.astype(np.float32),
        contact=contact,
        force_n=np.array([*(frame @ force[:2]), force[2]]),
        contact_radius_mm=contact_radius_mm(solution, record),
        converged=record.converged,
        diagnostics=replace(
            record.diagnostics,
            elastic_energy_mj=record.diagnostics.elastic_energy_mj * (young / problem.young_modulus_mpa),
        ),
    )


@lru_cache(maxsize=64)
def _table(solution: Solution, record: int) -> PolarTable:
    return polar_table(solution, solution.records[record])
