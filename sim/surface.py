"""The smooth outer membrane between the vertices of a solution."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.solution import Record, Solution

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_FINE_SPACING_MM = 0.05
_COARSE_SPACING_MM = 0.25
_FINE_RADIUS_MM = 4.0
_SECTORS = 64


@dataclass(frozen=True)
class PolarTable:
    """A field of the membrane tabulated over material radius and angle around the contact point.

    `values` is (n_r, n_angle, 3) for a displacement in mm, (n_r, n_angle, 1) for a scalar; angles run over the half
    circle if `symmetric`, else over the whole.
    """

    values: NDArray[np.float32]
    symmetric: bool

    def at(self, places: "PolarPlaces") -> NDArray[np.float64]:
        """Interpolate linearly at places that are those of tables of this shape and symmetry."""
        channels = self.values.shape[2]
        value = places.weights @ self.values.reshape(-1, channels).astype(float)
        value = value.reshape(*places.side.shape, channels)
        if self.symmetric and channels == 3:
            value[..., 1] *= places.side
        return value


@dataclass(frozen=True)
class PolarPlaces:
    """Where points (...) around the contact point lie in tables of one shape; beyond a table its rim holds.

    `weights` (points, entries) are the shares of the table's entries in the value at each point, `side` (...) is the
    sign of y.
    """

    weights: "csr_array"
    side: NDArray[np.float64]

    @classmethod
    def of(cls, rest_mm: NDArray[np.float64], shape: tuple[int, ...], symmetric: bool) -> "PolarPlaces":
        """Find points (..., 2) in tables of this shape and symmetry."""
        from scipy.sparse import csr_array

        rows, columns = shape[:2]
        x_mm, y_mm = rest_mm[..., 0], rest_mm[..., 1]
        row = np.clip(_row(np.hypot(x_mm, y_mm)), 0, rows - 1 - 1e-6)
        angle = np.arctan2(y_mm, x_mm)
        column = np.abs(angle) / np.pi if symmetric else (angle / (2 * np.pi)) % 1.0
        column = np.clip(column * (columns - 1), 0, columns - 1 - 1e-6)
        i, j = row.astype(np.int32), column.astype(np.int32)
        outwards, onwards = row - i, column - j
        corner = i * columns + j
        entries = np.stack([corner, corner + 1, corner + columns, corner + columns + 1], -1)
        inner, outer = (1 - outwards) * (1 - onwards), outwards * (1 - onwards)
        shares = np.stack([inner, (1 - outwards) * onwards, outer, outwards * onwards], -1)
        first = np.arange(0, entries.size + 1, 4, dtype=np.int32)
        weights = csr_array((shares.ravel(), entries.ravel(), first), shape=(corner.size, rows * columns))
        return cls(weights, np.sign(y_mm))


def polar_table(solution: Solution, record: Record) -> PolarTable:
    """Recover the membrane between the vertices by a C¹ piecewise cubic and tabulate it."""
    from scipy.interpolate import CloughTocher2DInterpolator
    from scipy.spatial import cKDTree

    rest, displacement, _ = solution.whole_surface(record)
    points = _polar_points(solution, rest)
    values = CloughTocher2DInterpolator(rest, displacement)(points)
    outside = np.isnan(values[..., 0])
    values[outside] = displacement[cKDTree(rest).query(points[outside])[1]]
    return PolarTable(values.astype(np.float32), solution.problem.symmetric)


def pressure_table(solution: Solution, record: Record) -> PolarTable:
    """Tabulate the normal pressure in MPa: the vertices' forces over their shares of the deformed surface's area."""
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import Delaunay

    # Vertices in the plane of symmetry carry the force of one half, so that areas are those of this half as well.
    rest = solution.rest_mm
    triangulation = Delaunay(rest)
    corners = triangulation.simplices
    position = np.concatenate([rest, np.zeros((len(rest), 1))], axis=1) + record.displacement_mm
    first, second, third = (position[corners[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(second - first, third - first), axis=1) / 2
    share = np.bincount(corners.ravel(), np.repeat(area / 3, 3), minlength=len(rest))
    pressure = np.maximum(record.normal_force_n, 0) / np.maximum(share, 1e-9)
    values = LinearNDInterpolator(triangulation, pressure[:, None])(_polar_points(solution, rest))
    return PolarTable(np.nan_to_num(values).astype(np.float32), solution.problem.symmetric)


def _polar_points(solution: Solution, rest_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where a table samples the membrane, (n_r, n_angle, 2)."""
    problem = solution.problem
    low, high = rest_mm.min(axis=0), rest_mm.max(axis=0)
    rim = float(np.hypot(*rest_mm.T).max())
    extent = rim if problem.pad_mm is None else np.hypot(*np.maximum(-low, high))
    radius = _radius(np.arange(np.ceil(_row(np.array(extent))) + 1))
    half_circle = np.linspace(0, np.pi, _SECTORS + 1)
    turn = half_circle if problem.symmetric else np.linspace(0, 2 * np.pi, 2 * _SECTORS + 1)
    # The mesh is a polygon, cut at the pad's edges: points beyond it take the displacement of its rim.
    meshed = np.minimum(radius, 0.999 * rim * np.cos(np.pi / (2 * problem.mesh_size.sectors)))
    x, y = np.outer(meshed, np.cos(turn)), np.outer(meshed, np.sin(turn))
    return np.stack([np.clip(x, low[0], high[0]), np.clip(y, low[1], high[1])], -1)


def _row(radius_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    fine = np.minimum(radius_mm, _FINE_RADIUS_MM) / _FINE_SPACING_MM
    return fine + np.maximum(radius_mm - _FINE_RADIUS_MM, 0) / _COARSE_SPACING_MM


def _radius(row: NDArray[np.float64]) -> NDArray[np.float64]:
    fine_rows = _FINE_RADIUS_MM / _FINE_SPACING_MM
    return np.minimum(row, fine_rows) * _FINE_SPACING_MM + np.maximum(row - fine_rows, 0) * _COARSE_SPACING_MM
