"""One gel solved at every depth and travel of a grid, and the poses between them by interpolation."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.estimate import Diagnostics, diagnose
from gelgap.sim.indenter import Floats, Indenter
from gelgap.sim.membrane import (
    MembraneState,
    PolarTable,
    SolvedPose,
    contact_radius_mm,
    grid_axes,
    placed_surface,
    polar_table,
    pressure_table,
)
from gelgap.sim.path import ContactPath
from gelgap.sim.plan import Placement, SolvePlan, plan_solves
from gelgap.sim.scene import Elastomer, Pose, Scene, Sharing, canonical_frame
from gelgap.sim.solution import Solution

PATH_DEPTHS_MM = (0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
PATH_TRAVELS_MM = (0.0, 0.2, 0.4, 0.6)
# A pad this large has no edges that matter, so that one path serves every contact point.
_WITHOUT_EDGES = {"pad_size_mm": (100.0, 100.0)}
# By Hertz, force grows as depth^1.5 and the square of the contact radius as the depth.
_FORCE_EXPONENT = 1.5


def plan_path(elastomer: Elastomer, indenter: Indenter, quality: str = "draft") -> SolvePlan:
    """Return the solves that a `SolvedPath` is made of; gels that share their solutions have the same ones.

    Raises
    ------
    ValueError
        If the grid's deepest press or farthest travel is more than pad or indenter allow, or there is no such quality.
    """
    grid = ContactPath("grid", (0.0,), (0.0,), PATH_DEPTHS_MM, PATH_TRAVELS_MM, (0.0,))
    return plan_solves(elastomer.model_copy(update=_WITHOUT_EDGES), indenter, grid, quality)


@dataclass(frozen=True, eq=False)
class SolvedPath:
    """The equilibria of one gel on a grid of depths and travels, for a modulus of 1 MPa, without the pad's edges.

    Arrays begin with (depths, travels); the first depth is 0, without contact. `displacement_mm` and `pressure_mpa` are
    values of polar tables around the contact point, the others hold a value or vector for each equilibrium.
    """

    indenter: Indenter
    depths_mm: Floats
    travels_mm: Floats
    displacement_mm: NDArray[np.float32]
    pressure_mpa: NDArray[np.float32]
    indenter_mm: Floats
    force_n: Floats
    torque_n_mm: Floats
    contact_radius_mm: Floats
    converged: NDArray[np.bool_]
    coarse: NDArray[np.bool_]
    errors: Floats
    """Estimates of `ERRORS`, as `Diagnostics` has them."""

    @classmethod
    def from_solutions(cls, plan: SolvePlan, solutions: dict[str, Solution]) -> Self:
        """Return the path of `plan_path`'s plan, from the solutions of its solves by their keys."""
        equilibria = [
            equilibrium(solutions[plan.solves[placement.solve].key], placement)
            for placement in plan.placements[1:]
        ]
        rows = max(len(fields["displacement_mm"]) for fields in equilibria)
        arrays = {}
        for name in equilibria[0]:
            column = [fields[name] for fields in equilibria]
            if column[0].ndim == 3:  # smaller tables repeat their rim
                column = [np.pad(one, ((0, rows - len(one)), (0, 0), (0, 0)), "edge") for one in column]
            values = np.stack(column)
            values = values.reshape(len(PATH_DEPTHS_MM), len(PATH_TRAVELS_MM), *values.shape[1:])
            arrays[name] = np.concatenate([np.zeros_like(values[:1]), values])
        arrays["converged"][0] = True
        return cls(plan.indenter, np.array([0.0, *PATH_DEPTHS_MM]), np.array(PATH_TRAVELS_MM), **arrays)

    def pose(self, elastomer: Elastomer, pose: Pose) -> SolvedPose:
        """Return a pose by interpolation: membranes linearly in depth and travel, forces in depth^1.5 and travel.

        It counts as converged if the equilibria around it are, and as coarse if one of them is; estimates are theirs,
        and know nothing of the interpolation. Forces are those of the elastomer's modulus.

        Raises
        ------
        ValueError
            If the pose is deeper or further sideways than the path, or turns.
        """
        if any(pose.turn_deg):
            raise ValueError(
                "twist_deg and roll_deg: a path has no poses that turn; solve this one by itself"
            )
        deepest, farthest = self.depths_mm[-1], self.travels_mm[-1]
        if pose.depth_mm > deepest:
            raise ValueError(f"depth_mm = {pose.depth_mm:g}: the path ends at {deepest:g} mm")
        if pose.radius_mm > farthest + 1e-9:
            raise ValueError(f"shear = {pose.radius_mm:g} mm: the path ends at {farthest:g} mm")
        if pose.depth_mm == 0:
            return SolvedPose.untouched()
        depth, travel = _bracket(self.depths_mm, pose.depth_mm), _bracket(self.travels_mm, pose.radius_mm)
        by_force = _bracket(self.depths_mm**_FORCE_EXPONENT, pose.depth_mm**_FORCE_EXPONENT)
        gel = elastomer.model_copy(update=_WITHOUT_EDGES)
        frame = canonical_frame(Scene(gel, self.indenter, "draft", Sharing()), pose)
        modulus = elastomer.mujoco_moduli.young_modulus_mpa
        indenter_mm = _between(self.indenter_mm, depth, travel)
        table = PolarTable(_between(self.displacement_mm, depth, travel), symmetric=True)
        displacement_mm, contact, places = placed_surface(pose, frame, self.indenter, table, indenter_mm)
        pressure = PolarTable(_between(self.pressure_mpa, depth, travel), symmetric=True).at(places)
        x_mm, y_mm = grid_axes()
        around = np.ix_(*([corner for corner, _ in pair] for pair in (depth, travel)))
        fz_error, shear_error, radius_error_mm, membrane_error_mm = _between(
            self.errors, depth, travel
        ).tolist()
        state = MembraneState(
            x_mm=x_mm,
            y_mm=y_mm,
            displacement_mm=displacement_mm,
            contact=contact,
            force_n=frame.on_sensor(modulus * _between(self.force_n, by_force, travel)),
            torque_n_mm=frame.torque_on_sensor(modulus * _between(self.torque_n_mm, by_force, travel)),
            contact_radius_mm=float(np.sqrt(_between(self.contact_radius_mm**2, depth, travel))),
            converged=bool(self.converged[around].all()),
            diagnostics=Diagnostics(
                fz_error_n=modulus * fz_error,
                shear_error_n=modulus * shear_error,
                contact_radius_error_mm=radius_error_mm,
                membrane_error_mm=membrane_error_mm,
                coarse=bool(self.coarse[around].any()),
            ),
        )
        pressure_mpa = (modulus * pressure[..., 0]).astype(np.float32)
        return SolvedPose(state, pressure_mpa, frame.on_sensor(indenter_mm))


# Indices of neighbours and their weights.
_Bracket = tuple[tuple[int, float], ...]


def _bracket(nodes: Floats, value: float) -> _Bracket:
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


def equilibrium(solution: Solution, placement: Placement) -> dict[str, np.ndarray]:
    """Return the fields of a `SolvedPath`, tables and numbers for a modulus of 1 MPa, for one solved pose."""
    record = solution.records[placement.record]
    per_mpa = 1 / solution.problem.moduli.young_modulus_mpa
    radius_mm = contact_radius_mm(solution, record)
    found = diagnose(solution.problem, record, radius_mm, per_mpa, folded=False)
    errors = (
        found.fz_error_n,
        found.shear_error_n,
        found.contact_radius_error_mm,
        found.membrane_error_mm,
    )
    return {
        "displacement_mm": polar_table(solution, record).values,
        "pressure_mpa": pressure_table(solution, record).values * np.float32(per_mpa),
        "indenter_mm": record.indenter_mm,
        "force_n": record.force_n * per_mpa,
        "torque_n_mm": record.torque_n_mm * per_mpa,
        "contact_radius_mm": np.array(radius_mm),
        "converged": np.array(record.converged),
        "coarse": np.array(found.coarse),
        "errors": np.array(errors),
    }
