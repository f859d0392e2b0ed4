"""Any pose of one gel from a few solves: a library of poses, with its error on held-out poses that are solved exactly.

A press at some depths, a drag at each. How far a drag has come is measured by what it takes to slide: in Hertzian
contact an incompressible gel slides as a whole from a travel of about 1.5 μ × depth on (Mindlin 1949), so that drags at
different depths are alike where they are interpolated. A drag in one direction serves all, as an indenter of revolution
on a gel without edges allows, and every contact point and modulus. Served are presses and straight drags.
"""

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gelgap.assets.checksums import canonical_json, sha256
from gelgap.assets.names import one_line
from gelgap.assets.progress import shown_progress
from gelgap.sim.estimate import LARGEST_ESTIMATE, Diagnostics, diagnose
from gelgap.sim.indenter import Floats, Indenter, Symmetry
from gelgap.sim.membrane import (
    MembraneState,
    PolarTable,
    covered_extent_mm,
    grid_axes,
    is_folded,
    polar_table,
    press_onto,
    pressure_table,
)
from gelgap.sim.path import PosePath
from gelgap.sim.plan import Solve, SolvePlan, plan_solves
from gelgap.sim.relief import unbridged
from gelgap.sim.rim import contact_radius_mm
from gelgap.sim.scene import CanonicalFrame, Elastomer, Pose, Scene, Sharing, is_interior, plane_rotation
from gelgap.sim.solution import Solution, SolveDiagnostics, has_solution
from gelgap.sim.solved import NoContact, Placement, SolvedPose

if TYPE_CHECKING:
    import pandas as pd

LOG = logging.getLogger(__name__)
PictureOf = Callable[[MembraneState], Floats]
"""Draws a membrane, in code values; what it is for is to say how much a library's error is seen."""

MOST_SOLVES = 8
"""A library takes no more solves than this, those of its held-out poses among them."""
FORCE_BOUND, MEMBRANE_BOUND_UM = 0.02, 4.0
"""What a library's error is to stay below on held-out poses: rms of the force's share, and of the membrane in µm."""
_DEPTHS = 5
_STICKING_TRAVELS, _SLIDING_TRAVELS = 4, 4
# Where a drag is held out, between the travels that are solved: halves of their numbers.
_HELD_OUT_TRAVELS = (0.0, 1.5, 3.5, 5.5, 7.5)
_SLIDES_FROM = 1.5
# By Hertz, at depth d: force as d^1.5, contact radius as d^0.5, torque as both. A mount gives way as the force grows.
_GROWTH = {
    "force_n": 1.5, "torque_n_mm": 2.0, "contact_radius_mm": 0.5, "mount_mm": 1.5, "elastic_energy_mj": 2.5,
    "slip_mm": 1.0, "errors": 0.0, "sticking_fraction": 0.0, "min_volume_ratio": 0.0,
}  # fmt: skip
_LARGEST_OF = ("residual", "iterations", "imbalance", "coulomb_excess", "tension")


@dataclass(frozen=True)
class PoseRanges:
    """The poses that a library serves: depths from `shallowest_mm` to `deepest_mm`, and drags.

    A drag reaches as far as the smaller of `travel_mm` and `travel_by_depth` × depth.
    """

    shallowest_mm: float
    deepest_mm: float
    travel_mm: float
    travel_by_depth: float = 1e3

    def __post_init__(self) -> None:
        if not 0 < self.shallowest_mm <= self.deepest_mm:
            raise ValueError(
                f"deepest_mm = {self.deepest_mm:g}: must be above 0, and no less than the shallowest depth of the "
                f"library, {self.shallowest_mm:g} mm"
            )
        if not (self.travel_mm >= 0 and self.travel_by_depth >= 0):
            raise ValueError(f"travel of a library = {self.travel_mm:g} mm: must be 0 or more")

    @classmethod
    def of(cls, poses: Sequence[Pose], reach_mm: tuple[float, float, float] | None = None) -> "PoseRanges":
        """Return the ranges of poses, of which one at least makes contact, and of shallowest, deepest and farthest."""
        depths = [pose.depth_mm for pose in poses if pose.depth_mm > 0]
        travels = [pose.radius_mm for pose in poses]
        if reach_mm:
            depths, travels = [*depths, *reach_mm[:2]], [*travels, reach_mm[2]]
        return cls(min(depths), max(depths), max(travels))

    def farthest_mm(self, depth_mm: float) -> float:
        """Return how far a drag reaches at a depth."""
        return min(self.travel_mm, self.travel_by_depth * depth_mm)

    def check(self, pose: Pose) -> None:
        """Raise ValueError if a pose is none of these; between 0 and `shallowest_mm` poses are extrapolated."""
        if pose.depth_mm > self.deepest_mm + 1e-9:
            raise ValueError(f"depth_mm = {pose.depth_mm:g}: the library ends at {self.deepest_mm:g} mm")
        if any(pose.turn_deg):
            raise ValueError("twist_deg, roll_deg: a library serves no turns; solve this pose by itself")
        farthest_mm = self.farthest_mm(pose.depth_mm)
        if pose.radius_mm > farthest_mm + 1e-6 and pose.depth_mm > 0:
            raise ValueError(
                f"shear = {pose.radius_mm:g} mm: at a depth of {pose.depth_mm:g} mm the library ends at "
                f"{farthest_mm:g} mm"
            )


@dataclass(frozen=True)
class LibraryPlan:
    """The solves of a library: those of its poses at `depths` depths, and one for each depth that is held out."""

    __repr__ = one_line

    elastomer: Elastomer
    indenter: Indenter
    ranges: PoseRanges
    quality: str = "draft"
    depths: int = field(default_factory=lambda: _DEPTHS)

    def __post_init__(self) -> None:
        if self.indenter.symmetry is not Symmetry.REVOLUTION:
            raise ValueError(
                f"indenter ({self.indenter.label}): a library serves bodies of revolution; solve its poses singly"
            )
        deepest, farthest = self.ranges.deepest_mm, self.ranges.farthest_mm(self.ranges.deepest_mm)
        try:
            Scene(self.elastomer, self.indenter, self.quality, Sharing()).check(Pose(deepest, farthest))
        except ValueError as error:
            raise ValueError(f"deepest_mm = {deepest:g}, farthest drag {farthest:g} mm: {error}") from None

    @cached_property
    def depths_mm(self) -> tuple[float, ...]:
        low, high = self.ranges.shallowest_mm, self.ranges.deepest_mm
        number = self.depths if high > low + 1e-3 else 1
        evenly_wide_mm = np.round(np.linspace(low**0.5, high**0.5, number) ** 2, 6)
        return (*evenly_wide_mm[:-1].tolist(), high)

    @cached_property
    def solved(self) -> SolvePlan:
        """The plan of its poses, depth by depth."""
        return self.plan_of(self.depths_mm)

    @cached_property
    def held_out(self) -> tuple[SolvePlan, ...]:
        """The plans of the poses between them, one for each depth: as they are solved by themselves."""
        return tuple(self.held_out_between(low, high) for low, high in pairwise(self.depths_mm))

    @property
    def solves(self) -> tuple[Solve, ...]:
        return (*self.solved.solves, *(solve for plan in self.held_out for solve in plan.solves))

    @cached_property
    def key(self) -> str:
        """A hash of what its poses follow from."""
        return "library-" + sha256(canonical_json([solve.key for solve in self.solves]))

    def travels_mm(self, depth_mm: float) -> Floats:
        """Return the travels that are solved at a depth: first those at which the contact begins to slide."""
        slides_mm, farthest_mm = self._turn_mm(depth_mm)
        if farthest_mm == 0:
            return np.zeros(1)
        sticking = np.linspace(0.0, slides_mm, _STICKING_TRAVELS + 1)
        sliding = np.linspace(slides_mm, farthest_mm, _SLIDING_TRAVELS + 1)
        return np.concatenate([sticking, sliding[1:]]).round(6)

    def place_of(self, depth_mm: float, travel_mm: float) -> float:
        """Return where a travel lies among those solved at its depth: 0 for the first, 1 for the next."""
        solved = self.travels_mm(depth_mm)
        return float(np.interp(travel_mm, solved, np.arange(len(solved))))

    def _turn_mm(self, depth_mm: float) -> tuple[float, float]:
        """Return a travel from which the contact slides, less where that is beyond the ranges, and the farthest."""
        farthest_mm = self.ranges.farthest_mm(depth_mm)
        friction = self.elastomer.static_friction or self.elastomer.friction
        slides_mm = _SLIDES_FROM * friction * depth_mm
        if farthest_mm == 0 or slides_mm == 0:
            return 0.5 * farthest_mm, farthest_mm
        return slides_mm * farthest_mm / (slides_mm + farthest_mm), farthest_mm

    def plan_of(self, depths_mm: Sequence[float]) -> SolvePlan:
        """Return the plan of the library's poses at depths."""
        return self._plan([(depth, travel) for depth in depths_mm for travel in self.travels_mm(depth)])

    def held_out_between(self, low_mm: float, high_mm: float) -> SolvePlan:
        """Return the plan of the poses that are held out between two depths."""
        depth = round(((low_mm**0.5 + high_mm**0.5) / 2) ** 2, 6)
        solved = self.travels_mm(depth)
        places = [place for place in _HELD_OUT_TRAVELS if place <= len(solved) - 1]
        return self._plan([(depth, np.interp(place, range(len(solved)), solved)) for place in places])

    def _plan(self, contacts_mm: Sequence[tuple[float, float]]) -> SolvePlan:
        poses = tuple(Pose(depth_mm=depth, shear_x_mm=round(float(t), 6)) for depth, t in contacts_mm)
        gel = self.elastomer.model_copy(update={"pad_size_mm": (100.0, 100.0)})  # without edges
        plan = plan_solves(gel, self.indenter, PosePath("library", poses), self.quality)
        plan = replace(
            plan, solves=tuple(replace(own, problem=unbridged(own.problem)) for own in plan.solves)
        )
        if any(solve.problem.relief is not None for solve in plan.solves):
            raise ValueError(
                f"indenter ({self.indenter.label}): has relief finer than the mesh at quality {self.quality}, which a "
                "library does not hold; solve its poses by themselves"
            )
        return plan

    def build(self, solutions: Mapping[str, Solution]) -> "PoseLibrary":
        """Return the library of the solutions of `solved` by their keys, its error unknown."""
        return PoseLibrary.of(self, self.solved, solutions)

    def served_by(self, solutions: Mapping[str, Solution], picture: PictureOf | None = None) -> "PoseLibrary":
        """Return the library of all `solves`, with its errors on held-out poses, of pictures too if one can be drawn.

        As long as they are above the bounds, the interval of depths where they are largest is halved, by two more
        solves: the depth between, and a held-out depth in the deeper half; at most `MOST_SOLVES` in all.
        """
        import pandas as pd

        plans = dict(zip(pairwise(self.depths_mm), self.held_out, strict=True))
        solutions = {solve.key: solutions[solve.key] for solve in self.solves}
        added: list[SolvePlan] = [self.solved]
        while True:
            library = PoseLibrary.of(self, joined(added), solutions)
            errors = [library.errors_of(plan, solutions, picture) for plan in plans.values()]
            if not errors:
                return replace(library, solves=len(solutions))
            held_out = pd.concat(errors, ignore_index=True)
            library = replace(library, held_out=held_out, solves=len(solutions))
            if library.errors["within_bounds"] is not False or len(solutions) + 2 > MOST_SOLVES:
                return library
            excesses = {between: _excess(held_out, between) for between in plans}
            worst = max(excesses, key=lambda between: excesses[between])
            depth = plans.pop(worst).poses[0].depth_mm
            LOG.info("one more depth in the library, %g mm, where its error is largest", depth)
            deeper = (depth, worst[1])
            plans[deeper] = self.held_out_between(*deeper)
            added.append(self.plan_of((depth,)))
            solutions |= solve_all((*added[-1].solves, *plans[deeper].solves))


def joined(plans: Sequence[SolvePlan]) -> SolvePlan:
    """Return the plans of one gel under several indenters as one, their poses one after another."""
    poses: list[Pose] = []
    solves: list[Solve] = []
    placements: dict[int, Placement] = {}
    for plan in plans:
        for index, placement in plan.placements.items():
            placements[len(poses) + index] = replace(placement, solve=placement.solve + len(solves))
        poses += plan.poses
        solves += plan.solves
    return replace(plans[0], poses=tuple(poses), solves=tuple(solves), placements=placements)


def equilibrium(solution: Solution, placement: Placement, gel: Elastomer) -> dict[str, Any]:
    """Return one solved pose as polar tables and numbers for a modulus of 1 MPa, as libraries of poses hold it."""
    record = solution.records[placement.record]
    per_mpa = 1 / solution.problem.moduli.young_modulus_mpa
    radius_mm = contact_radius_mm(solution, record)
    found = diagnose(solution, placement.record, radius_mm, 1.0, per_mpa, gel)
    force_errors_n = found.fz_error_n, found.shear_error_n
    how_solved = {own.name: getattr(found, own.name) for own in fields(SolveDiagnostics)}
    return how_solved | {
        "displacement_mm": polar_table(solution, record).values,
        "pressure_mpa": pressure_table(solution, record).values * np.float32(per_mpa),
        "indenter_mm": record.indenter_mm,
        "force_n": record.force_n * per_mpa,
        "torque_n_mm": record.torque_n_mm * per_mpa,
        "contact_radius_mm": radius_mm,
        "converged": record.converged,
        "coarse": found.coarse,
        "errors": (*force_errors_n, found.contact_radius_error_mm, found.membrane_error_mm),
    }


def solve_all(solves: Sequence[Solve]) -> dict[str, Solution]:
    """Return the solutions of solves by their keys, and show how far that is."""
    solutions = {}
    with shown_progress() as progress:
        for number, solve in enumerate(solves, start=1):
            if not has_solution(solve.key):
                progress("solves of a library", number - 1, len(solves))
            solutions[solve.key] = solve.run()
    return solutions


def _excess(held_out: "pd.DataFrame", between: tuple[float, float]) -> float:
    """Return the largest error between two depths, over its bound."""
    rows = held_out.query(f"converged and {between[0]} < depth_mm < {between[1]}")
    if rows.empty:
        return 0.0
    return max(_rms(rows["force_share"]) / FORCE_BOUND, _rms(rows["membrane_um"]) / MEMBRANE_BOUND_UM)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class LibraryPose(MembraneState):
    """The membrane at a pose between those of a library, its neighbours there."""

    neighbours: "_Neighbours"
    modulus_mpa: float

    @cached_property
    def pressure_mpa(self) -> NDArray[np.float32]:
        """The normal pressure on the rest grid, (ny, nx)."""
        table = self.neighbours.table(self.neighbours.library.pressure_mpa)
        per_mpa = table.at(self.neighbours.points_mm((self.x_mm, self.y_mm)))[..., 0]
        return (self.modulus_mpa * per_mpa.clip(min=0.0)).astype(np.float32)

    @property
    def indenter_mm(self) -> Floats:
        """How far the indenter (3,) has come from touching the gel."""
        return self.neighbours.frame.on_sensor(self.neighbours.indenter_mm)


PoseState = SolvedPose | LibraryPose | NoContact
"""The membrane at a pose, wherever it is from, with pressure and indenter."""


@dataclass(frozen=True, eq=False)
class PoseLibrary:
    """Equilibria at some depths and travels, for a modulus of 1 MPa; any pose in its ranges follows by interpolation.

    Arrays begin with (depths, travels). `displacement_mm` and `pressure_mpa` hold polar tables around the contact
    point; `numbers` values or vectors by name. `held_out` has a row for each pose that was held out, None if none was;
    `solves` counts all that were needed.
    """

    __repr__ = one_line

    plan: LibraryPlan
    depths_mm: Floats
    displacement_mm: NDArray[np.float32]
    pressure_mpa: NDArray[np.float32]
    numbers: dict[str, np.ndarray]
    held_out: "pd.DataFrame | None" = field(default=None, repr=False)
    solves: int = 0

    @classmethod
    def of(cls, plan: LibraryPlan, solved: SolvePlan, solutions: Mapping[str, Solution]) -> "PoseLibrary":
        """Return the library of the poses of a solve plan."""
        found = []
        for index, placement in solved.placements.items():
            pose, solution = solved.poses[index], solutions[solved.solve_key(index)]
            fields = equilibrium(solution, placement, solved.elastomer) | {"depth_mm": pose.depth_mm}
            # How far a mount has given way, along the drag: none where the drive is rigid.
            fields["mount_mm"] = fields.pop("indenter_mm") - [pose.radius_mm, 0.0, -pose.depth_mm]
            found.append(fields)
        found.sort(key=lambda fields: fields["depth_mm"])
        rows = max(len(fields["displacement_mm"]) for fields in found)
        depths_mm = np.unique([fields["depth_mm"] for fields in found])
        grid = len(depths_mm), len(found) // len(depths_mm)
        stacked = {}
        for name in found[0]:
            column = [np.asarray(fields[name]) for fields in found]
            if column[0].ndim == 3:  # beyond its last row a table holds its rim
                column = [np.pad(one, ((0, rows - len(one)), (0, 0), (0, 0)), "edge") for one in column]
            stacked[name] = np.reshape(column, (*grid, *column[0].shape))
        numbers = {name: stacked[name] for name in ("converged", "coarse", *_LARGEST_OF)}
        for name, power in _GROWTH.items():
            depth = depths_mm.reshape(-1, *(1,) * (stacked[name].ndim - 1))
            numbers[name] = stacked[name] / depth**power
        return cls(plan, depths_mm, stacked["displacement_mm"], stacked["pressure_mpa"], numbers)

    def state(
        self,
        elastomer: Elastomer,
        pose: Pose,
        half_extent_mm: tuple[float, float] = (0.0, 0.0),
        axes_mm: tuple[Floats, Floats] | None = None,
    ) -> LibraryPose | NoContact:
        """Return the membrane of a pose, the forces those of the elastomer's modulus.

        It lies on `axes_mm` (x, y), or on a grid of 0.1 mm that reaches `half_extent_mm` from the sensor's centre. It
        counts as converged if the equilibria around it are and it is unfolded, as coarse if one of them is or held-out
        forces are off by more than the quality promises. Estimates of error are theirs and held-out ones, as squares.

        Raises
        ------
        ValueError
            If the library does not reach the pose, the pad's edge is near, or the gel is another in more than modulus.
        """
        self._check_gel(elastomer)
        self.plan.ranges.check(pose)
        if not is_interior(elastomer, self.plan.indenter, pose):
            raise ValueError(
                f"contact point ({pose.point_x_mm:g}, {pose.point_y_mm:g}) mm: a library serves points that the pad's "
                "edges are too far from to matter; solve this pose by itself"
            )
        if axes_mm is None:
            axes_mm = grid_axes(covered_extent_mm(elastomer, self.plan.indenter, pose, half_extent_mm))
        return self._interpolated(elastomer, pose, axes_mm)

    def pose(self, elastomer: Elastomer, pose: Pose) -> LibraryPose | NoContact:
        """Return the membrane of a pose on the grid of `grid_axes`.

        Unlike for `state`, the pad's edges are left out, and of the elastomer all but the modulus.
        """
        self.plan.ranges.check(pose)
        return self._interpolated(elastomer, pose, grid_axes())

    def _check_gel(self, elastomer: Elastomer) -> None:
        """Refuse a gel that differs from the library's in more than size, or modulus and mount by one factor."""
        own, free = self.plan.elastomer, ("pad_size_mm", "young_modulus_mpa", "mount_stiffness_n_per_mm")
        for name, value in elastomer:
            if name not in free and value != getattr(own, name):
                raise ValueError(f"{name} = {value}: must be the library's, {getattr(own, name)}")
        mounts = [(gel.mount_stiffness_n_per_mm or 0.0) / gel.young_modulus_mpa for gel in (elastomer, own)]
        if not math.isclose(*mounts, rel_tol=1e-9):
            raise ValueError(
                f"mount_stiffness_n_per_mm = {elastomer.mount_stiffness_n_per_mm}: must be the library's, "
                f"{own.mount_stiffness_n_per_mm}, and grow as the modulus does"
            )

    def _interpolated(
        self, elastomer: Elastomer, pose: Pose, axes_mm: tuple[Floats, Floats]
    ) -> LibraryPose | NoContact:
        indenter = self.plan.indenter
        if pose.depth_mm == 0:
            return NoContact.untouched(*axes_mm, pose=pose)
        near = _Neighbours(self, pose)
        rest_mm = near.points_mm(axes_mm)
        displacement_mm = near.table(self.displacement_mm).at(rest_mm)
        origin_mm = near.indenter_mm + np.array([0.0, 0.0, indenter.origin_height_mm])
        contact = press_onto(indenter, rest_mm, displacement_mm, origin_mm)
        on_sensor_mm = near.frame.on_sensor(displacement_mm).astype(np.float32)
        folded = is_folded(*axes_mm, on_sensor_mm)
        modulus = elastomer.mujoco_moduli.young_modulus_mpa
        errors = near.value("errors")
        force_n = modulus * near.frame.on_sensor(near.value("force_n"))
        found = {name: near.each(name).max().item() for name in _LARGEST_OF}
        found |= {name: float(near.value(name)) for name in ("slip_mm", "min_volume_ratio")}
        # Estimates of the mesh's errors with those that were measured, if any were.
        measured = self.errors
        off_share = measured.get("force_rms_percent", 0.0) / 100
        off_n = off_share * float(np.linalg.norm(force_n))
        return LibraryPose(
            *axes_mm,
            on_sensor_mm,
            contact,
            force_n=force_n,
            torque_n_mm=modulus * near.frame.on_sensor(near.value("torque_n_mm")),
            contact_radius_mm=float(near.value("contact_radius_mm")),
            converged=bool(near.each("converged").all()) and not folded,
            diagnostics=Diagnostics(
                **found,
                sticking_fraction=float(near.value("sticking_fraction").clip(0.0, 1.0)),
                elastic_energy_mj=modulus * float(near.value("elastic_energy_mj")),
                fz_error_n=math.hypot(modulus * errors[0], off_n),
                shear_error_n=math.hypot(modulus * errors[1], off_n),
                contact_radius_error_mm=math.hypot(errors[2], measured.get("radius_rms_um", 0.0) / 1000),
                membrane_error_mm=math.hypot(errors[3], measured.get("membrane_rms_um", 0.0) / 1000),
                coarse=bool(near.each("coarse").any()) or off_share > LARGEST_ESTIMATE[self.plan.quality],
                folded=folded,
            ),
            neighbours=near,
            modulus_mpa=modulus,
        )

    def errors_of(
        self, plan: SolvePlan, solutions: Mapping[str, Solution], picture: PictureOf | None = None
    ) -> "pd.DataFrame":
        """Return how far off the library is on a plan's poses, a row for each: force, membrane, radius and picture.

        The membrane's error is rms within four contact radii, the picture's in its code values.
        """
        import pandas as pd

        rows = []
        for index, pose in enumerate(plan.poses):
            exact = plan.state(index, solutions)
            served = self.state(plan.elastomer, pose, axes_mm=(exact.x_mm, exact.y_mm))
            off_n = served.force_n - exact.force_n
            near = np.hypot(exact.x_mm, exact.y_mm[:, None]) < 4 * exact.contact_radius_mm
            off_mm = np.linalg.norm(served.displacement_mm - exact.displacement_mm, axis=-1)
            seen = exact.converged and served.converged
            row = {
                "depth_mm": pose.depth_mm,
                "travel_mm": pose.radius_mm,
                "force_n": float(np.linalg.norm(exact.force_n)),
                "force_share": float(np.linalg.norm(off_n) / np.linalg.norm(exact.force_n)),
                "membrane_um": 1e3 * _rms(off_mm[near]),
                "radius_um": 1e3 * abs(served.contact_radius_mm - exact.contact_radius_mm),
                "converged": seen,
            }
            if picture is not None:
                row["picture_codes"] = _rms(picture(served) - picture(exact)) if seen else math.nan
            rows.append(row)
        return pd.DataFrame(rows)

    @cached_property
    def errors(self) -> dict[str, Any]:
        """What the manifest says: solves, and errors on the held-out poses that converge, rms and largest, if any.

        Nothing at all where no pose was held out.
        """
        if self.held_out is None:
            return {}
        table = self.held_out[self.held_out["converged"]]
        errors = {
            "solves": self.solves,
            "depths_mm": self.depths_mm.tolist(),
            "held_out_poses": len(table),
            "held_out_unconverged": len(self.held_out) - len(table),
            "within_bounds": None,
        }
        if table.empty:
            LOG.warning("no held-out pose of a library converged: estimates are its own solves' alone")
            return errors
        force_rms, membrane_rms_um = _rms(table["force_share"]), _rms(table["membrane_um"])
        errors |= {
            "force_rms_percent": 100 * force_rms,
            "force_largest_percent": 100 * float(table["force_share"].max()),
            "membrane_rms_um": membrane_rms_um,
            "membrane_largest_um": float(table["membrane_um"].max()),
            "radius_rms_um": _rms(table["radius_um"]),
            "within_bounds": force_rms <= FORCE_BOUND and membrane_rms_um <= MEMBRANE_BOUND_UM,
        }
        if "picture_codes" in table:
            errors["picture_rms_codes"] = _rms(table["picture_codes"])
        return errors


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(np.asarray(values, float)))))


class _Neighbours:
    """The equilibria of a library that a pose is interpolated from: the nearest depths and travels, and their weights.

    Depth 0, the undeformed membrane, has a table of zeros, and numbers as Hertz has the shallowest press's grow.
    """

    def __init__(self, library: PoseLibrary, pose: Pose) -> None:
        self.library, self._pose = library, pose
        self.frame = CanonicalFrame(None, plane_rotation(math.atan2(pose.shear_y_mm, pose.shear_x_mm)))
        depths, by_depth = _weights((0.0, *np.sqrt(library.depths_mm).tolist()), math.sqrt(pose.depth_mm))
        place = library.plan.place_of(pose.depth_mm, pose.radius_mm)
        travels, by_travel = _weights(tuple(range(library.displacement_mm.shape[1])), place)
        self._at, self._weights = np.ix_(np.maximum(depths - 1, 0), travels), np.outer(by_depth, by_travel)
        self._of_tables = (self._weights * (depths > 0)[:, None]).astype(np.float32)

    def points_mm(self, axes_mm: tuple[Floats, Floats]) -> Floats:
        """Return a grid's points (ny, nx, 2) in the frame of the drag."""
        return self.frame.points_mm(*axes_mm, self._pose)

    def table(self, tables: NDArray[np.float32]) -> PolarTable:
        """Return what tables (depths, travels, …) say of the pose."""
        return PolarTable(np.tensordot(self._of_tables, tables[self._at], 2), symmetric=True)

    def value(self, name: str) -> Any:
        """Return a number of `_GROWTH`, or a vector (3,) in the frame of the drag."""
        values = self.library.numbers[name][self._at]
        return self._pose.depth_mm ** _GROWTH[name] * np.tensordot(self._weights, values, 2)

    @property
    def indenter_mm(self) -> Floats:
        """How far (3,) the indenter has come, in the frame of the drag."""
        return self.value("mount_mm") + np.array([self._pose.radius_mm, 0.0, -self._pose.depth_mm])

    def each(self, name: str) -> NDArray[Any]:
        """Return a number, or whether something is so, of each of the equilibria."""
        return self.library.numbers[name][self._at]


def _weights(nodes: tuple[float, ...], value: float) -> tuple[NDArray[np.intp], Floats]:
    """Return the nodes that a value is interpolated from, and their weights."""
    weights = _spline(nodes)(value) if len(nodes) > 1 else np.ones(1)
    near = np.flatnonzero(np.abs(weights) > 1e-9)
    return near, weights[near]


@lru_cache(maxsize=64)
def _spline(nodes: tuple[float, ...]) -> Callable[[float], Floats]:
    """Return the weights of nodes: cubic Hermite, slopes from the parabola through a node and its two neighbours."""
    from scipy.interpolate import CubicHermiteSpline

    own = np.eye(len(nodes))
    slopes = np.gradient(own, nodes, axis=0, edge_order=2 if len(nodes) > 2 else 1)
    return CubicHermiteSpline(nodes, own, slopes)
