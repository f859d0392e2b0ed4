"""One gel solved at every depth and travel of a grid, and the poses between them by interpolation."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.canonical_frame import PlacedSurface, canonical_frame, placed_surface
from gelgap.sim.contact_radius import contact_radius_mm
from gelgap.sim.elastomer import Elastomer
from gelgap.sim.indenters.base import Indenter
from gelgap.sim.membrane import MembraneState, flat_state
from gelgap.sim.path import ContactPath, Pose, PosePath
from gelgap.sim.plan import Placement, SolvePlan, plan_solves
from gelgap.sim.scene import Scene, Sharing
from gelgap.sim.solution import Solution
from gelgap.sim.surface import PolarPlaces, PolarTable, polar_table, pressure_table

PATH_DEPTHS_MM = (0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
PATH_TRAVELS_MM = (0.0, 0.2, 0.4, 0.6)
# A pad this large has no edges that matter, so that one path serves every contact point.
_WITHOUT_EDGES = {"pad_size_mm": (100.0, 100.0)}
# By Hertz, force grows as depth^1.5 and the square of the contact radius as the depth.
_FORCE_EXPONENT = 1.5


@dataclass(frozen=True, eq=False)
class SolvedPose:
    """A membrane and what else its solve tells.

    `pressure_mpa` is the normal pressure on the rest grid, (ny, nx), and `indenter_mm` (3,) how far the indenter has
    come from where it touches the gel, in the sensor's frame: less deep than commanded if a spring mounts it.
    """

    state: MembraneState
    pressure_mpa: NDArray[np.float32]
    indenter_mm: NDArray[np.float64]

    @classmethod
    def untouched(cls) -> Self:
        """Return the membrane without contact."""
        state = flat_state()
        return cls(state, np.zeros(state.contact.shape, np.float32), np.zeros(3))


def plan_path(elastomer: Elastomer, indenter: Indenter, quality: str = "draft") -> SolvePlan:
    """Return the solves that a `SolvedPath` is made of; gels that share their solutions have the same ones.

    Raises
    ------
    ValueError
        If the grid's deepest press or farthest travel is more than pad or indenter allow, or there is no such quality.
    """
    grid = ContactPath("grid", (0.0,), (0.0,), PATH_DEPTHS_MM, PATH_TRAVELS_MM, (0.0,))
    return plan_solves(elastomer.model_copy(update=_WITHOUT_EDGES), indenter, grid, quality)


def solved_pose(plan: SolvePlan, pose_index: int, solution: Solution | None) -> SolvedPose:
    """Return `plan.state` of a pose with pressure and indenter."""
    state, placement = plan.state(pose_index, solution), plan.placements[pose_index]
    if placement is None:
        return SolvedPose.untouched()
    pose, record = plan.poses[pose_index], solution.records[placement.record]
    table = pressure_table(solution, record)
    rest = np.stack(np.meshgrid(state.x_mm - pose.point_x_mm, state.y_mm - pose.point_y_mm), axis=-1)
    places = PolarPlaces.of(rest @ placement.frame.to_sensor, table.values.shape, table.symmetric)
    ratio = plan.elastomer.mujoco_moduli.young_modulus_mpa / solution.problem.moduli.young_modulus_mpa
    pressure = table.at(places)[..., 0] * ratio
    return SolvedPose(state, pressure.astype(np.float32), placement.frame.on_sensor(record.indenter_mm))


def solve_in_full(
    elastomer: Elastomer, indenter: Indenter, pose: Pose, quality: str = "standard"
) -> SolvedPose:
    """Solve one pose like `solve_pose`, and return pressure and indenter as well.

    Raises
    ------
    ValueError
        If the pose lies off the pad or deeper than it allows, or there is no such quality.
    """
    plan = plan_solves(elastomer, indenter, PosePath("pose", (pose,)), quality)
    return solved_pose(plan, 0, plan.solves[0].run() if plan.solves else None)


@dataclass(frozen=True, eq=False)
class SolvedPath:
    """The equilibria of one gel on a grid of depths and travels, for a modulus of 1 MPa, without the pad's edges.

    Arrays begin with (depths, travels); the first depth is 0, without contact. `displacement_mm` and `pressure_mpa` are
    values of polar tables around the contact point, the others hold a value or vector for each equilibrium.
    """

    indenter: Indenter
    depths_mm: NDArray[np.float64]
    travels_mm: NDArray[np.float64]
    displacement_mm: NDArray[np.float32]
    pressure_mpa: NDArray[np.float32]
    indenter_mm: NDArray[np.float64]
    force_n: NDArray[np.float64]
    contact_radius_mm: NDArray[np.float64]
    converged: NDArray[np.bool_]

    @classmethod
    def from_solutions(cls, plan: SolvePlan, solutions: dict[str, Solution]) -> Self:
        """Return the path of `plan_path`'s plan, from the solutions of its solves by their keys."""
        equilibria = [
            _equilibrium(solutions[plan.solves[placement.solve].key], placement)
            for placement in plan.placements[1:]
        ]
        rows = max(len(displacement) for displacement, *_ in equilibria)
        stacked = [
            np.stack([_with_rows(values, rows) if values.ndim == 3 else values for values in column])
            for column in zip(*equilibria, strict=True)
        ]
        shape = (len(PATH_DEPTHS_MM), len(PATH_TRAVELS_MM))
        arrays = [values.reshape(*shape, *values.shape[1:]) for values in stacked]
        displacement_mm, pressure_mpa, indenter_mm, force_n, radius_mm, converged = (
            np.concatenate([np.zeros_like(values[:1]), values]) for values in arrays
        )
        converged[0] = True
        return cls(
            indenter=plan.indenter,
            depths_mm=np.array([0.0, *PATH_DEPTHS_MM]),
            travels_mm=np.array(PATH_TRAVELS_MM),
            displacement_mm=displacement_mm,
            pressure_mpa=pressure_mpa,
            indenter_mm=indenter_mm,
            force_n=force_n,
            contact_radius_mm=radius_mm,
            converged=converged,
        )

    def pose(self, elastomer: Elastomer, pose: Pose) -> SolvedPose:
        """Return a pose by interpolation: membranes linearly in depth and travel, forces in depth^1.5 and travel.

        It counts as converged if the equilibria around it are. Forces are those of the elastomer's modulus.

        Raises
        ------
        ValueError
            If the pose is deeper or further sideways than the path.
        """
        self._check(pose)
        if pose.depth_mm == 0:
            return SolvedPose.untouched()
        depth, travel = _bracket(self.depths_mm, pose.depth_mm), _bracket(self.travels_mm, pose.radius_mm)
        by_force = _bracket(self.depths_mm**_FORCE_EXPONENT, pose.depth_mm**_FORCE_EXPONENT)
        frame = canonical_frame(
            Scene(elastomer.model_copy(update=_WITHOUT_EDGES), self.indenter, "draft", Sharing()), pose
        )
        modulus = elastomer.mujoco_moduli.young_modulus_mpa
        indenter_mm = _between(self.indenter_mm, depth, travel)
        table = PolarTable(_between(self.displacement_mm, depth, travel), symmetric=True)
        surface = placed_surface(pose, frame, self.indenter, table, indenter_mm)
        return SolvedPose(
            self._state(pose, surface, frame.on_sensor(modulus * _between(self.force_n, by_force, travel))),
            self._pressure(surface, depth, travel, modulus),
            frame.on_sensor(indenter_mm),
        )

    def _check(self, pose: Pose) -> None:
        deepest, farthest = self.depths_mm[-1], self.travels_mm[-1]
        if pose.depth_mm > deepest:
            raise ValueError(f"depth_mm = {pose.depth_mm:g}: the path ends at {deepest:g} mm")
        if pose.radius_mm > farthest + 1e-9:
            raise ValueError(f"shear = {pose.radius_mm:g} mm: the path ends at {farthest:g} mm")

    def _state(self, pose: Pose, surface: PlacedSurface, force_n: NDArray[np.float64]) -> MembraneState:
        depth, travel = _bracket(self.depths_mm, pose.depth_mm), _bracket(self.travels_mm, pose.radius_mm)
        around = self.converged[np.ix_(*([corner for corner, _ in pair] for pair in (depth, travel)))]
        return MembraneState(
            x_mm=surface.x_mm,
            y_mm=surface.y_mm,
            displacement_mm=surface.displacement_mm,
            contact=surface.contact,
            force_n=force_n,
            contact_radius_mm=float(np.sqrt(_between(self.contact_radius_mm**2, depth, travel))),
            converged=bool(around.all()),
        )

    def _pressure(
        self, surface: PlacedSurface, depth: "_Bracket", travel: "_Bracket", modulus_mpa: float
    ) -> NDArray[np.float32]:
        table = PolarTable(_between(self.pressure_mpa, depth, travel), symmetric=True)
        return (modulus_mpa * table.at(surface.places)[..., 0]).astype(np.float32)


# Indices of neighbours and their weights.
_Bracket = tuple[tuple[int, float], ...]


def _bracket(nodes: NDArray[np.float64], value: float) -> _Bracket:
    """Return the one or two nodes around a value, and their weights for linear interpolation."""
    for k, (low, high) in enumerate(pairwise(nodes)):
        if value <= high:
            share = float((value - low) / (high - low))
            return tuple((at, weight) for at, weight in ((k, 1 - share), (k + 1, share)) if weight > 1e-9)
    return ((len(nodes) - 1, 1.0),)


def _between(values: np.ndarray, depth: _Bracket, travel: _Bracket) -> np.ndarray:
    """Return values (depths, travels, …) interpolated linearly."""
    return sum(
        (np.float32(a * b) if values.dtype == np.float32 else a * b) * values[i, j]
        for i, a in depth
        for j, b in travel
    )


def _equilibrium(solution: Solution, placement: Placement) -> tuple[np.ndarray, ...]:
    """Return the fields of a `SolvedPath` for one equilibrium."""
    record = solution.records[placement.record]
    per_mpa = 1 / solution.problem.moduli.young_modulus_mpa
    return (
        polar_table(solution, record).values,
        pressure_table(solution, record).values * np.float32(per_mpa),
        record.indenter_mm,
        record.force_n * per_mpa,
        np.array(contact_radius_mm(solution, record)),
        np.array(record.converged),
    )


def _with_rows(values: NDArray[np.float32], rows: int) -> NDArray[np.float32]:
    """Return a polar table with more rows, which repeat the rim."""
    return np.pad(values, ((0, rows - len(values)), (0, 0), (0, 0)), mode="edge")
