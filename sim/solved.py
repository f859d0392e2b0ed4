"""The answer of a solve at one pose: the membrane, and all that follows from it when it is asked for."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.estimate import diagnose
from gelgap.sim.indenter import Floats, Indenter, rotation
from gelgap.sim.membrane import (
    GRID_HALF_EXTENT_MM,
    MembraneCubic,
    MembraneState,
    PolarTable,
    covered_extent_mm,
    grid_axes,
    is_folded,
    membrane_between,
    press_onto,
    pressure_table,
    traction_table,
)
from gelgap.sim.relief import recesses_of, with_fill
from gelgap.sim.rim import contact_radius_mm, twist_factor
from gelgap.sim.scene import CanonicalFrame, Elastomer, Pose
from gelgap.sim.solution import Record, Solution
from gelgap.sim.surface import Surface
from gelgap.sim.traction import Slip, Traction, balanced_traction

# Vertices beside a pressing edge share its load unevenly. The pressure that fills recesses is therefore averaged over
# this many points of the grid, which is half a millimetre.
_SHARED_POINTS = 5
_NO_SLIP = "{}: a pose without contact has no slip"
# Many poses share a record: a frame takes 1 ms longer where each is diagnosed by itself.
_diagnosed = lru_cache(maxsize=64)(diagnose)


@dataclass(frozen=True)
class Placement:
    """How a pose follows from a solve: by which of its records, seen from which frame."""

    solve: int
    record: int
    frame: CanonicalFrame


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class NoContact(MembraneState):
    """The undeformed membrane at a pose that presses nothing into it: no solve is needed, and nothing is estimated."""

    pose: Pose

    @property
    def pressure_mpa(self) -> NDArray[np.float32]:
        """Zero on the rest grid, (ny, nx)."""
        return np.zeros(self.contact.shape, np.float32)

    @property
    def indenter_mm(self) -> Floats:
        """Zero: the indenter (3,) has come no further than to the gel."""
        return np.zeros(3)

    def traction(self) -> Traction:
        """Return a contact stress of zero on the membrane."""
        point_mm = (self.pose.point_x_mm, self.pose.point_y_mm)
        return balanced_traction(self, point_mm, np.zeros((*self.contact.shape, 3)))

    def slip(self) -> Slip:
        """Raise ValueError: what does not touch does not slip."""
        raise ValueError(_NO_SLIP.format(f"depth_mm = {self.pose.depth_mm:g}"))


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class SolvedPose(MembraneState):
    """The membrane at a pose that was solved; pressure, stress and slip follow from the same solve when asked for."""

    contact_solve: "ContactSolve"

    @cached_property
    def pressure_mpa(self) -> NDArray[np.float32]:
        """The normal pressure on the rest grid, (ny, nx)."""
        solve = self.contact_solve
        pressure = solve.around(pressure_table(solve.solution, solve.record), self)[..., 0]
        return (pressure * solve.modulus_ratio).astype(np.float32)

    @property
    def indenter_mm(self) -> Floats:
        """How far the indenter (3,) has come from touching the gel: less deep than commanded if a spring mounts it."""
        return self.contact_solve.indenter_mm

    def traction(self) -> Traction:
        """Return the contact stress on the membrane."""
        solve = self.contact_solve
        per_modulus = solve.around(traction_table(solve.solution, solve.record), self)
        stress_mpa = solve.placement.frame.on_sensor(per_modulus * solve.modulus_ratio)
        return balanced_traction(self, (solve.pose.point_x_mm, solve.pose.point_y_mm), stress_mpa)

    def slip(self) -> Slip:
        """Return how far the membrane has slid over the indenter since the press straight down.

        That is the last pose on the indenter's way before it went sideways or turned. Where the membrane sticks, it
        goes where the indenter's travel and turn carry it; slip is how far it is from there.

        Raises
        ------
        ValueError
            If that pose makes no contact.
        """
        before, after = self.contact_solve.press(), self.contact_solve
        first = before.state()
        then = after.state((first.x_mm[-1], first.y_mm[-1]))
        if then.contact.shape != first.contact.shape:
            first = before.state((then.x_mm[-1], then.y_mm[-1]))
        turn = rotation(np.array(after.pose.turn_deg)) @ rotation(np.array(before.pose.turn_deg)).T
        carried_mm = after.origin_mm + (first.places_mm - before.origin_mm) @ turn.T
        touching = (first.contact & then.contact)[..., None]
        return Slip(then.x_mm, then.y_mm, np.where(touching, then.places_mm - carried_mm, np.nan))


@dataclass(frozen=True)
class ContactSolve:
    """What a solved pose follows from: the scene, and the record of the solution that serves it."""

    elastomer: Elastomer
    indenter: Indenter
    pose: Pose
    placement: Placement
    solution: Solution

    @property
    def record(self) -> Record:
        return self.solution.records[self.placement.record]

    @property
    def modulus_ratio(self) -> float:
        """By how much forces are larger than those of the solved gel, which stands for all moduli."""
        problem = self.solution.problem
        return problem.moduli_of(self.elastomer).young_modulus_mpa / problem.moduli.young_modulus_mpa

    @property
    def indenter_mm(self) -> Floats:
        """How far the indenter (3,) has come from touching the gel, on the sensor."""
        return self.placement.frame.on_sensor(self.record.indenter_mm)

    @property
    def origin_mm(self) -> Floats:
        """Where the indenter's origin (3,) is on the sensor."""
        height_mm = self.indenter.turned(self.pose.turn_deg).origin_height_mm
        return self.indenter_mm + np.array([self.pose.point_x_mm, self.pose.point_y_mm, height_mm])

    def around(self, table: PolarTable, state: MembraneState) -> Floats:
        """Return a table's field (ny, nx, channels) on a state's grid, in the contact's frame."""
        return table.at(self.placement.frame.points_mm(state.x_mm, state.y_mm, self.pose))

    def press(self) -> "ContactSolve":
        """Return the last pose on the indenter's way before it went sideways or turned."""
        press = self.solution.problem.straight_down(self.placement.record)
        depth_mm = -self.solution.problem.waypoints_mm[press][2]
        if depth_mm == 0:
            raise ValueError(_NO_SLIP.format("depth_mm = 0 on the way to this pose"))
        pose = replace(
            self.pose, depth_mm=depth_mm, shear_x_mm=0.0, shear_y_mm=0.0, twist_deg=0.0, roll_deg=(0.0, 0.0)
        )
        return replace(self, pose=pose, placement=replace(self.placement, record=press))

    def state(self, half_extent_mm: tuple[float, float] = GRID_HALF_EXTENT_MM) -> SolvedPose:
        """Return the membrane on a grid that covers the contact and reaches at least `half_extent_mm`.

        It reaches no further than the pad if that is larger than the grid by default.
        """
        solution, index, frame = self.solution, self.placement.record, self.placement.frame
        record, ratio = self.record, self.modulus_ratio
        indenter = solution.problem.body_at(index)
        x_mm, y_mm = grid_axes(covered_extent_mm(self.elastomer, indenter, self.pose, half_extent_mm))
        between, radius_mm, twist = _membrane_and_edge(solution, index)
        diagnostics = _diagnosed(solution, index, radius_mm, twist, ratio, self.elastomer)
        rest_mm = frame.points_mm(x_mm, y_mm, self.pose)
        displacement_mm = between.at(rest_mm)
        origin_mm = record.indenter_mm + np.array([0.0, 0.0, indenter.origin_height_mm])
        contact = press_onto(indenter, rest_mm, displacement_mm, origin_mm)
        recesses = recesses_of(solution.problem)
        if recesses is not None and isinstance(indenter, Surface) and contact.any():
            pressure_mpa = _shared_pressure_mpa(pressure_table(solution, record).at(rest_mm)[..., 0], contact)
            from_origin_mm = np.pad(rest_mm[contact], ((0, 0), (0, 1))) + displacement_mm[contact] - origin_mm
            filled_mm = recesses.fill(from_origin_mm, indenter, pressure_mpa)
            displacement_mm[contact] += filled_mm
            force_n, depth_mm = ratio * abs(record.force_n[2]), abs(record.indenter_mm[2])
            diagnostics = with_fill(diagnostics, filled_mm, force_n, depth_mm, solution.problem.quality.name)
        on_sensor_mm = frame.on_sensor(displacement_mm).astype(np.float32)
        folded = is_folded(x_mm, y_mm, on_sensor_mm)
        return SolvedPose(
            x_mm,
            y_mm,
            on_sensor_mm,
            contact,
            force_n=frame.on_sensor(record.force_n * ratio),
            torque_n_mm=frame.torque_on_sensor(record.torque_n_mm * [1, 1, twist] * ratio),
            contact_radius_mm=radius_mm,
            converged=record.converged and not folded,
            diagnostics=replace(diagnostics, folded=folded),
            contact_solve=self,
        )


def _shared_pressure_mpa(field_mpa: Floats, contact: NDArray[np.bool_]) -> Floats:
    """Return the pressure (n,) at the points in contact of a field (ny, nx), averaged twice over its neighbours."""
    from scipy.ndimage import uniform_filter

    once_mpa = uniform_filter(field_mpa * contact, _SHARED_POINTS)
    return uniform_filter(once_mpa, _SHARED_POINTS)[contact]


@lru_cache(maxsize=64)
def _membrane_and_edge(solution: Solution, index: int) -> tuple[MembraneCubic | PolarTable, float, float]:
    """Return a record's membrane, contact radius and `twist_factor`, which many poses share."""
    record = solution.records[index]
    radius_mm, twist = contact_radius_mm(solution, record), twist_factor(solution, record)
    return membrane_between(solution, record), radius_mm, twist
