"""The frame in which a contact is solved: which symmetry leads from a pose to it, and from its solution back."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

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

    @property
    def to_sensor_3d(self) -> NDArray[np.float64]:
        """The same for vectors (3,) in space."""
        turn = np.eye(3)
        turn[:2, :2] = self.to_sensor
        return turn

    def on_sensor(self, vector: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return a vector (3,) of this frame, such as a force, in the sensor's."""
        return self.to_sensor_3d @ vector


def is_interior(elastomer: Elastomer, pose: Pose) -> bool:
    """Return whether the pad's edges are too far from a contact point to matter."""
    point_mm = pose.point_x_mm, pose.point_y_mm
    to_edge_mm = min(
        size / 2 - abs(place) for size, place in zip(elastomer.pad_size_mm, point_mm, strict=True)
    )
    return to_edge_mm >= _INTERIOR_THICKNESSES * elastomer.thickness_mm


def canonical_frame(scene: Scene, pose: Pose) -> CanonicalFrame:
    """Return the frame of a pose, by the symmetries that pad and indenter have and `scene.sharing` allows.

    The travel of an interior pose under a body of revolution is turned to +x. Other poses are mirrored to the pad's
    first quadrant, where their travel decides if they lie on an axis of the pad.
    """
    elastomer, sharing, symmetry = scene.elastomer, scene.sharing, scene.indenter.symmetry
    half_x, half_y = elastomer.pad_size_mm[0] / 2, elastomer.pad_size_mm[1] / 2
    x, y = pose.point_x_mm, pose.point_y_mm
    interior = sharing.translation and is_interior(elastomer, pose)
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
    table = _table(solution, record_index)
    surface = placed_surface(pose, frame, problem.indenter, table, record.indenter_mm, half_extent_mm)
    modulus_ratio = elastomer.mujoco_moduli.young_modulus_mpa / problem.moduli.young_modulus_mpa
    energy = record.diagnostics.elastic_energy_mj * modulus_ratio
    return MembraneState(
        x_mm=surface.x_mm,
        y_mm=surface.y_mm,
        displacement_mm=surface.displacement_mm,
        contact=surface.contact,
        force_n=frame.on_sensor(record.force_n * modulus_ratio),
        contact_radius_mm=_contact_radius_mm(solution, record_index),
        converged=record.converged,
        diagnostics=replace(record.diagnostics, elastic_energy_mj=energy),
    )


class PlacedSurface(NamedTuple):
    """The membrane on a rest grid, in the sensor's frame.

    `x_mm` (nx,) and `y_mm` (ny,) are the grid's axes, `displacement_mm` is (ny, nx, 3), `contact` (ny, nx), and
    `places` are the grid's points in the polar tables of the contact.
    """

    x_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]
    displacement_mm: NDArray[np.float32]
    contact: NDArray[np.bool_]
    places: PolarPlaces


def placed_surface(
    pose: Pose,
    frame: CanonicalFrame,
    indenter: Indenter,
    table: PolarTable,
    indenter_mm: NDArray[np.float64],
    half_extent_mm: tuple[float, float] = GRID_HALF_EXTENT_MM,
) -> PlacedSurface:
    """Return a table's membrane at a pose's point; what touches the indenter at `indenter_mm` (3,) lies on it."""
    point_mm, turn = (pose.point_x_mm, pose.point_y_mm), tuple(frame.to_sensor.ravel().tolist())
    rest, places = _places(half_extent_mm, point_mm, turn, table.values.shape[:2], table.symmetric)
    displacement = table.at(places)
    origin = indenter_mm + np.array([0.0, 0.0, indenter.origin_height_mm])
    contact = _press_onto(indenter, rest, displacement, origin)
    turned = (displacement.reshape(-1, 3) @ frame.to_sensor_3d.T).reshape(displacement.shape)
    return PlacedSurface(*grid_axes(half_extent_mm), turned.astype(np.float32), contact, places)


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
    return rest, PolarPlaces.of(rest, shape, symmetric)


def _press_onto(
    indenter: Indenter,
    rest_mm: NDArray[np.float64],
    displacement_mm: NDArray[np.float64],
    origin_mm: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Move points (..., 3) that touch the indenter onto its surface, in place; return which do (...)."""
    reach_mm = indenter.penetration_radius_mm(indenter.deepest_mm) + _BULGE_MM
    rest, moved = rest_mm.reshape(-1, 2), displacement_mm.reshape(-1, 3)
    along_x, along_y = (np.abs(rest[:, k] + moved[:, k] - origin_mm[k]) for k in range(2))
    near = np.flatnonzero((along_x < reach_mm) & (along_y < reach_mm))
    from_origin = np.concatenate([rest[near], np.zeros((len(near), 1))], axis=1) - origin_mm
    nearest = indenter.project(from_origin + moved[near])
    touches = nearest.distance_mm < _TOUCHING_GAP_MM
    moved[near[touches]] = (nearest.points_mm - from_origin)[touches]
    contact = np.zeros(len(rest), dtype=bool)
    contact[near[touches]] = True
    return contact.reshape(displacement_mm.shape[:-1])
