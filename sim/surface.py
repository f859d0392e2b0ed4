"""The smooth outer membrane recovered from a solution's vertices, and the contact that presses it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.indentation import Record, Solution

_FINE_SPACING_MM = 0.05
_COARSE_SPACING_MM = 0.25
_FINE_RADIUS_MM = 4.0
_SECTORS = 64
_TOUCHING_GAP_MM = 0.004


@dataclass(frozen=True)
class PolarTable:
    """Displacement of the membrane tabulated over material radius and angle around the contact point.

    `displacement_mm` is (n_r, n_angle, 3); angles run over the half circle if `half`, else over the whole.
    """

    displacement_mm: NDArray[np.float32]
    half: bool

    def at(self, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Interpolate linearly at points around the contact point; beyond the table its rim holds."""
        rows, columns, _ = self.displacement_mm.shape
        row = np.clip(_row(np.hypot(x_mm, y_mm)), 0, rows - 1 - 1e-6)
        angle = np.arctan2(y_mm, x_mm)
        column = np.abs(angle) / np.pi if self.half else (angle / (2 * np.pi)) % 1.0
        column = np.clip(column * (columns - 1), 0, columns - 1 - 1e-6)
        i, j = row.astype(np.intp), column.astype(np.intp)
        a, b = (row - i)[..., None], (column - j)[..., None]
        flat = self.displacement_mm.reshape(-1, 3)
        corner = i * columns + j
        inner = flat[corner] * (1 - b) + flat[corner + 1] * b
        outer = flat[corner + columns] * (1 - b) + flat[corner + columns + 1] * b
        value = inner * (1 - a) + outer * a
        if self.half:
            value[..., 1] *= np.sign(y_mm)
        return value


def polar_table(solution: Solution, record: Record) -> PolarTable:
    """Recover the membrane between the vertices by a C¹ piecewise cubic and tabulate it."""
    from scipy.interpolate import CloughTocher2DInterpolator
    from scipy.spatial import cKDTree

    problem = solution.problem
    half = problem.half
    rest, displacement = solution.rest_mm, record.displacement_mm.astype(float)
    if half:
        mirrored = rest[:, 1] > 1e-9
        rest = np.concatenate([rest, rest[mirrored] * [1, -1]])
        displacement = np.concatenate([displacement, displacement[mirrored] * [1, -1, 1]])
    low, high = rest.min(axis=0), rest.max(axis=0)
    rim = float(np.hypot(*rest.T).max())
    reach = rim if problem.pad_mm is None else np.hypot(*np.maximum(-low, high))
    radius = _radius(np.arange(np.ceil(_row(np.array(reach))) + 1))
    turn = np.linspace(0, np.pi, _SECTORS + 1) if half else np.linspace(0, 2 * np.pi, 2 * _SECTORS + 1)
    # The mesh is a polygon, cut at the pad's edges: points beyond it take the displacement of its rim.
    meshed = np.minimum(radius, 0.999 * rim * np.cos(np.pi / (2 * problem.mesh_size.sectors)))
    x, y = np.outer(meshed, np.cos(turn)), np.outer(meshed, np.sin(turn))
    x, y = np.clip(x, low[0], high[0]), np.clip(y, low[1], high[1])
    points = np.stack([x, y], -1)
    values = CloughTocher2DInterpolator(rest, displacement)(points)
    outside = np.isnan(values[..., 0])
    values[outside] = displacement[cKDTree(rest).query(points[outside])[1]]
    return PolarTable(displacement_mm=values.astype(np.float32), half=half)


def _row(radius_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    fine = np.minimum(radius_mm, _FINE_RADIUS_MM) / _FINE_SPACING_MM
    return fine + np.maximum(radius_mm - _FINE_RADIUS_MM, 0) / _COARSE_SPACING_MM


def _radius(row: NDArray[np.float64]) -> NDArray[np.float64]:
    fine_rows = _FINE_RADIUS_MM / _FINE_SPACING_MM
    return np.minimum(row, fine_rows) * _FINE_SPACING_MM + np.maximum(row - fine_rows, 0) * _COARSE_SPACING_MM


def pressed_onto_sphere(
    position_mm: NDArray[np.float64], centre_mm: NDArray[np.float64], radius_mm: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Move points that touch the sphere, or lie in it, onto it along its radius; also return which do."""
    from_centre = position_mm - centre_mm
    distance = np.linalg.norm(from_centre, axis=-1)
    touching = distance < radius_mm + _TOUCHING_GAP_MM
    scale = np.where(touching, radius_mm / np.maximum(distance, 1e-9), 1.0)
    return centre_mm + from_centre * scale[..., None], touching


def contact_radius_mm(solution: Solution, record: Record) -> float:
    """Return the deformed radius at which the normal pressure vanishes.

    Near the edge of a smooth contact the pressure goes as √(a² − r²), so the normal force carried outside of radius
    r goes as (a² − r²)^(3/2): its power 2/3 is a straight line in r² that meets zero at a². Radii count from the
    centre of the force, and from the indenter's axis where the pad's edge cuts the contact off.
    """
    force = record.normal_force_n.astype(float)
    loaded = force > 0
    if loaded.sum() < 3:
        return 0.0
    rest = solution.rest_mm[loaded]
    position = rest + record.displacement_mm[loaded, :2]
    force = force[loaded]
    cut_off = _on_edge(rest, solution.problem.pad_mm).any()
    if solution.problem.half:
        on_plane = position[:, 1] < 1e-9
        position = np.concatenate([position, position[~on_plane] * [1, -1]])
        force = np.concatenate([force, force[~on_plane]])
    centre = record.indenter_mm[:2] if cut_off else (force @ position) / force.sum()
    square = ((position - centre) ** 2).sum(axis=1)
    order = np.argsort(-square)
    square, force = square[order], force[order]
    outside = np.cumsum(force) - 0.5 * force
    share = outside / force.sum()
    same = 1e-6 * square.max()
    edge = (share > 0.02) & (share < 0.6)
    if edge.sum() < 3 or np.ptp(square[edge]) < same:
        edge = share > 0
    if np.ptp(square[edge]) < same:
        return float(np.sqrt(square.max()))
    slope, offset = np.polyfit(square[edge], share[edge] ** (2 / 3), 1)
    return float(np.sqrt(max(-offset / slope, 0.0))) if slope < 0 else float(np.sqrt(square.max()))


def _on_edge(
    rest_mm: NDArray[np.float64], pad_mm: tuple[float, float, float, float] | None
) -> NDArray[np.bool_]:
    if pad_mm is None:
        return np.zeros(len(rest_mm), dtype=bool)
    return (np.abs(rest_mm[:, [0, 0, 1, 1]] - np.array(pad_mm)) < 1e-9).any(axis=1)
