"""Where a contact ends between two vertices of the mesh: its radius, the torque that goes with it, and what sticks.

A vertex touches the indenter or it does not, so a mesh turns with a contact that is up to a fifth of a cell too wide or
too narrow, and torque grows with the cube of the radius. The gap beside the contact says where it ends; how the torque
is spread over the vertices says how wide the mesh takes it to be. Where a twist sticks, this makes errors of a
sphere's torque at `standard` three times smaller (15.5 to 4.7 % rms), in 1 ms.
"""

import math
from types import SimpleNamespace

import numpy as np

from gelgap.sim.grading import sizes_along
from gelgap.sim.indenter import Floats, Sphere
from gelgap.sim.problem import MESHES, ContactProblem
from gelgap.sim.shapes import Ellipsoid
from gelgap.sim.solution import Record, Solution

# The radius over the root mean square of those at which the torque acts: shear of a sticking twist grows as
# r / sqrt(a² - r²) on a half-space (Reissner & Sagoci 1944), and by finite elements to 1 % on thin pads as well.
_RADIUS_OVER_TORQUES = math.sqrt(1.25)
# Chosen or fitted beside the references; the file says what each does.
_RIM = SimpleNamespace(**MESHES["rim"])


def contact_radius_mm(solution: Solution, record: Record) -> float:
    """Return the deformed radius at which the contact ends; 0 if fewer than three vertices carry force."""
    if np.count_nonzero(record.normal_force_n > 0) < 3:
        return 0.0
    return _gap_radius_mm(solution, record) or _pressure_radius_mm(solution, record)


def twist_factor(solution: Solution, record: Record) -> float:
    """Return by what a record's torque about the contact's axis is to be multiplied for where the contact ends.

    It is 1 where half of the load slides, or the contact is not round.
    """
    radius_mm = None if solution.problem.symmetric else _gap_radius_mm(solution, record)
    if radius_mm is None:
        return 1.0
    places_mm = solution.rest_of(record) + record.displacement_mm[:, :2] - record.indenter_mm[:2]
    force_n = record.contact_force_n.astype(float)
    torques = places_mm[:, 0] * force_n[:, 1] - places_mm[:, 1] * force_n[:, 0]
    mean_square = float((torques * (places_mm**2).sum(axis=1)).sum() / (torques.sum() or math.inf))
    cell_mm = _cell_mm(solution.problem, radius_mm)
    turned_mm = _RADIUS_OVER_TORQUES * math.sqrt(max(mean_square, 0.0)) + _RIM.beyond_torque_cells * cell_mm
    # Without a twist, torque is noise.
    if abs(turned_mm - radius_mm) > _RIM.largest_correction_share * radius_mm:
        return 1.0
    sticks = max(0.0, 2 * record.diagnostics.sticking_fraction - 1)
    return (radius_mm / turned_mm) ** (3 * sticks)


def sticking_share(solution: Solution, record: Record) -> float:
    """Return the share of the normal force that sticks: of a ball's, from where friction is how far below its bound.

    What friction lacks is spread as the pressure of a smaller contact, the part that sticks (Cattaneo 1938): their mean
    squares of the radius are as their areas. Vertices, which let go one by one, are off by 0.07 rms, this by 0.03.
    """
    problem, by_vertices = solution.problem, record.diagnostics.sticking_fraction
    curved = isinstance(problem.indenter, Sphere | Ellipsoid) and problem.static_friction is None
    if not curved or not 0 < by_vertices < 1:
        return by_vertices
    places_mm = solution.rest_of(record) + record.displacement_mm[:, :2]
    normal_n = np.maximum(record.normal_force_n.astype(float), 0.0)
    square_n2 = (record.contact_force_n.astype(float) ** 2).sum(axis=1)
    lacking_n = problem.friction * normal_n - np.sqrt(np.maximum(square_n2 - normal_n**2, 0.0))

    def mean_square_mm2(force_n: Floats) -> float:
        # The other half of a symmetric contact has its centre on the other side.
        centre_mm = (force_n @ places_mm) / force_n.sum() * [1.0, not problem.symmetric]
        return force_n @ ((places_mm - centre_mm) ** 2).sum(axis=1) / force_n.sum()

    areas = mean_square_mm2(np.maximum(lacking_n, 0.0)) / mean_square_mm2(normal_n)
    return float(1 - max(0.0, 1 - areas) ** 1.5)


def _cell_mm(problem: ContactProblem, radius_mm: float) -> float:
    """Return how wide the mesh's cells are at a radius of a round contact."""
    if isinstance(problem.indenter, Sphere):
        return problem.cell_mm
    return float(sizes_along(problem, 0, problem.cell_mm, (0.0, 0.0)).at(np.array([radius_mm]))[0])


def _is_cut_off(solution: Solution, rest_mm: Floats) -> bool:
    """Return whether vertices in contact are on the pad's edge."""
    pad_mm = solution.problem.pad_mm
    return pad_mm is not None and bool((np.abs(rest_mm[:, [0, 0, 1, 1]] - np.array(pad_mm)) < 1e-9).any())


def _gap_radius_mm(solution: Solution, record: Record) -> float | None:
    """Return the contact's radius from the gaps outside of its rim; None if it is not round, or they do not tell.

    Just outside of a smooth contact the gap goes as (r − a)^(3/2), by Hertz up to r = 1.4 a: its power 2/3 is a
    straight line in r that begins at a.
    """
    problem = solution.problem
    sideways_n = float(np.hypot(*record.force_n[:2]))
    if not (problem.is_round and problem.indenter.convex) or record.indenter_mm[:2].any():
        return None
    if sideways_n > _RIM.largest_sideways_share * abs(record.force_n[2]):
        return None
    rest_mm, displacement_mm, force_n = solution.whole_surface(record)
    touching = force_n > 0
    if not touching.any() or _is_cut_off(solution, rest_mm[touching]):
        return None
    origin_mm = record.indenter_mm + np.array([0.0, 0.0, problem.indenter.origin_height_mm])
    from_origin_mm = np.column_stack([rest_mm, np.zeros(len(rest_mm))]) + displacement_mm - origin_mm
    gap_mm = problem.indenter.project(from_origin_mm).distance_mm
    distance_mm = np.hypot(*from_origin_mm[:, :2].T)
    outermost_mm = float(distance_mm[touching].max())
    cell_mm = _cell_mm(problem, outermost_mm)
    free = ~touching & (gap_mm > _RIM.smallest_gap_mm)
    beside = free & (distance_mm < outermost_mm + _RIM.gap_cells * cell_mm)
    if np.count_nonzero(beside) < 3 or np.ptp(distance_mm[beside]) < _RIM.one_ring_share * outermost_mm:
        return None
    slope, offset = np.polyfit(distance_mm[beside], gap_mm[beside] ** (2 / 3), 1)
    radius_mm = -offset / slope + _RIM.beyond_gap_cells * cell_mm if slope > 0 else 0.0
    return float(radius_mm) if abs(radius_mm - outermost_mm) < cell_mm else None


def _pressure_radius_mm(solution: Solution, record: Record) -> float:
    """Return the contact's radius from the normal forces inside of its rim.

    Near the edge of a smooth round contact the pressure goes as √(a² − r²), so the normal force carried outside of
    radius r goes as (a² − r²)^(3/2): its power 2/3 is a straight line in r² that meets zero at a². Radii count from the
    centre of the force, and from the indenter's axis where the pad's edge cuts the contact off.
    """
    rest, displacement, force = solution.whole_surface(record)
    loaded = force > 0
    rest, displacement, force = rest[loaded], displacement[loaded], force[loaded]
    position = rest + displacement[:, :2]
    centre = record.indenter_mm[:2] if _is_cut_off(solution, rest) else (force @ position) / force.sum()
    square = ((position - centre) ** 2).sum(axis=1)
    inwards = np.argsort(-square)
    square, force = square[inwards], force[inwards]
    share_outside = (np.cumsum(force) - 0.5 * force) / force.sum()
    largest = float(np.sqrt(square.max()))
    one_radius = 1e-6 * square.max()
    edge = (share_outside > _RIM.edge_shares[0]) & (share_outside < _RIM.edge_shares[1])
    if edge.sum() < 3 or np.ptp(square[edge]) < one_radius:
        edge = share_outside > 0
    if np.ptp(square[edge]) < one_radius:
        return largest
    slope, offset = np.polyfit(square[edge], share_outside[edge] ** (2 / 3), 1)
    widest_mm = largest + solution.problem.cell_mm  # which the line exceeds under a long body
    return min(float(np.sqrt(max(-offset / slope, 0.0))), widest_mm) if slope < 0 else largest
