"""The frame in which a contact is solved: which symmetry leads from a pose to it, and from its solution back."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.contact_radius import contact_radius_mm
from gelgap.sim.elastomer import Elastomer
from gelgap.sim.indenters.base import Indenter, Symmetry
from gelgap.sim.membrane import GRID_HALF_EXTENT_MM, MembraneState, grid_axes
from gelgap.sim.path import Pose
from gelgap.sim.problem import PadEdges
from gelgap.sim.scene import Scene
from gelgap.sim.solution import Solution
from gelgap.sim.surface import PolarPlaces, PolarTable, polar_table

# A contact is interior if the pad's edges are further away than this many thicknesses (docs/physics.md).
_INTERIOR_THICKNESSES = 2.4
# Points of the membrane this near the indenter touch it.
_TOUCHING_GAP_MM = 0.004
# The gel bulges beside the indenter and can touch it this far outside of what it cuts.
_BULGE_MM = 0.4


@dataclass(frozen=True, eq=False)
class CanonicalFrame:
    """Where a contact is solved.

    `pad_mm` is (x min, x max, y min, y max) of the pad around the contact point, None if its edges are too far to
    matter; it is the same for all points that share their solutions. `to_sensor` (2, 2) is orthogonal, a
    rotation or a reflection, and leads from this frame's plane to the sensor's.
    """

    pad_mm: PadEdges | None
    to_sensor: NDArray[np.float64]

    def travel_mm(self, pose: Pose) -> NDArray[np.float64]:
        """Return the sideways travel (2,) of a pose in this frame."""
        return self.to_sensor.T @ np.array([pose.shear_x_mm, pose.shear_y_mm])


def canonical_frame(scene: Scene, pose: Pose) -> CanonicalFrame:
    """Return the frame of a pose, by the symmetries that pad and indenter have and `scene.sharing` allows.

    The travel of an interior pose under a body of revolution is turned to +x. Other poses are mirrored to the pad's
    first quadrant, where their travel decides if they lie on an axis of the pad.
    """
    elastomer, sharing, symmetry = scene.elastomer, scene.sharing, scene.indenter.symmetry
    half_x, half_y = elastomer.pad_size_mm[0] / 2, elastomer.pad_size_mm[1] / 2
    x, y = pose.point_x_mm, pose.point_y_mm
    to_edge = min(half_x - abs(x), half_y - abs(y))
    interior = sharing.translation and to_edge >= _INTERIOR_THICKNESSES * elastomer.thickness_mm
    if interior and symmetry is Symmetry.REVOLUTION:
        angle = math.atan2(pose.shear_y_mm, pose.shear_x_mm)
        cosine, sine = math.cos(angle), math.sin(angle)
        return CanonicalFrame(None, np.array([[cosine, -sine], [sine, cosine]]))
    x, y = (0.0, 0.0) if interior else (x, y)
    mirror = np.ones(2)
    if sharing.reflection and symmetry is not Symmetry.NONE:
        mirror[0] = -1.0 if x < 0 or (x == 0 and pose.shear_x_mm < -1e-12) else 1.0
        mirror[1] = -1.0 if y < 0 or (y == 0 and pose.shear_y_mm < -1e-12) else 1.0
    x, y = x * mirror[0] + 0.0, y * mirror[1] + 0.0
    edges = (-half_x - x, half_x - x, -half_y - y, half_y - y)
    pad = None if interior else tuple(round(edge, 9) + 0.0 for edge in edges)
    return CanonicalFrame(pad, np.diag(mirror))


def placed_state(
    elastomer: Elastomer,
    pose: Pose,
    frame: CanonicalFrame,
    solution: Solution,
    record_index: int,
    half_extent_mm: tuple[float, float] = GRID_HALF_EXTENT_MM,
) -> MembraneState:
    """Return the membrane of a pose from the solution's record of it: moved to the pose's point, force by modulus.

    Its grid reaches at least `half_extent_mm` from the sensor's centre along x and y.
    """
    record, problem = solution.records[record_index], solution.problem
    x_mm, y_mm = grid_axes(half_extent_mm)
    table = _table(solution, record_index)
    point_mm, turn = (pose.point_x_mm, pose.point_y_mm), tuple(frame.to_sensor.ravel().tolist())
    rest, places = _places(half_extent_mm, point_mm, turn, table.displacement_mm.shape, table.symmetric)
    position = table.at(places)
    position[..., :2] += rest
    origin = record.indenter_mm + np.array([0.0, 0.0, problem.indenter.origin_height_mm])
    displacement, contact = _on_indenter(problem.indenter, position, origin)
    displacement[..., :2] -= rest
    displacement[..., :2] = displacement[..., :2] @ frame.to_sensor.T
    modulus_ratio = elastomer.mujoco_moduli.young_modulus_mpa / problem.moduli.young_modulus_mpa
    force = record.force_n * modulus_ratio
    energy = record.diagnostics.elastic_energy_mj * modulus_ratio
    return MembraneState(
        x_mm=x_mm,
        y_mm=y_mm,
        displacement_mm=displacement.astype(np.float32),
        contact=contact,
        force_n=np.array([*(frame.to_sensor @ force[:2]), force[2]]),
        contact_radius_mm=_contact_radius_mm(solution, record_index),
        converged=record.converged,
        diagnostics=replace(record.diagnostics, elastic_energy_mj=energy),
    )


@lru_cache(maxsize=64)
def _table(solution: Solution, record_index: int) -> PolarTable:
    return polar_table(solution, solution.records[record_index])


@lru_cache(maxsize=64)
def _contact_radius_mm(solution: Solution, record_index: int) -> float:
    return contact_radius_mm(solution, solution.records[record_index])


# Poses that follow one another often differ in depth alone.
@lru_cache(maxsize=16)
def _places(
    half_extent_mm: tuple[float, float],
    point_mm: tuple[float, float],
    turn: tuple[float, ...],
    shape: tuple[int, ...],
    symmetric: bool,
) -> tuple[NDArray[np.float64], PolarPlaces]:
    """Return the sensor's grid around a point in the frame turned by `turn` (4,), and its places in polar tables."""
    x_mm, y_mm = grid_axes(half_extent_mm)
    rest = np.stack(np.meshgrid(x_mm - point_mm[0], y_mm - point_mm[1]), axis=-1) @ np.reshape(turn, (2, 2))
    return rest, PolarPlaces.of(rest[..., 0], rest[..., 1], shape, symmetric)


def _on_indenter(
    indenter: Indenter, position_mm: NDArray[np.float64], origin_mm: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the positions (..., 3), those that touch moved onto the indenter's surface, and which touch."""
    from_indenter = position_mm - origin_mm
    reach_mm = indenter.penetration_radius_mm(indenter.deepest_mm) + _BULGE_MM
    near = (np.abs(from_indenter[..., 0]) < reach_mm) & (np.abs(from_indenter[..., 1]) < reach_mm)
    nearest = indenter.project(from_indenter[near])
    touches = nearest.distance_mm < _TOUCHING_GAP_MM
    contact = np.zeros(near.shape, dtype=bool)
    contact[near] = touches
    from_indenter[contact] = nearest.points_mm[touches]
    return origin_mm + from_indenter, contact
