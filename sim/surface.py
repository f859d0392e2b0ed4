"""The smooth outer membrane between the vertices of a solution."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.solution import Record, Solution

_FINE_SPACING_MM = 0.05
_COARSE_SPACING_MM = 0.25
_FINE_RADIUS_MM = 4.0
_SECTORS = 64


@dataclass(frozen=True)
class PolarTable:
    """Displacement of the membrane tabulated over material radius and angle around the contact point.

    `displacement_mm` is (n_r, n_angle, 3); angles run over the half circle if `symmetric`, else over the whole.
    """

    displacement_mm: NDArray[np.float32]
    symmetric: bool

    def at(self, places: "PolarPlaces") -> NDArray[np.float64]:
        """Interpolate linearly at places that are those of a table of this shape and symmetry."""
        a, b = places.outwards, places.onwards
        inner = self._entries(places.corner) * (1 - b) + self._entries(places.corner + 1) * b
        corner = places.corner + self.displacement_mm.shape[1]
        outer = self._entries(corner) * (1 - b) + self._entries(corner + 1) * b
        value = inner * (1 - a) + outer * a
        if self.symmetric:
            value[..., 1] *= places.side
        return value

    def _entries(self, indices: NDArray[np.intp]) -> NDArray[np.float32]:
        return np.take(self.displacement_mm.reshape(-1, 3), indices, axis=0)


@dataclass(frozen=True)
class PolarPlaces:
    """Where points (...) around the contact point lie in tables of one shape; beyond a table its rim holds.

    `corner` (...) is the entry before each point, `outwards` and `onwards` (..., 1) the shares of the way to the next
    radius and angle, `side` (...) the sign of y.
    """

    corner: NDArray[np.intp]
    outwards: NDArray[np.float64]
    onwards: NDArray[np.float64]
    side: NDArray[np.float64]

    @classmethod
    def of(
        cls, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64], shape: tuple[int, ...], symmetric: bool
    ) -> "PolarPlaces":
        """Find points in tables of this shape and symmetry."""
        rows, columns, _ = shape
        row = np.clip(_row(np.hypot(x_mm, y_mm)), 0, rows - 1 - 1e-6)
        angle = np.arctan2(y_mm, x_mm)
        column = np.abs(angle) / np.pi if symmetric else (angle / (2 * np.pi)) % 1.0
        column = np.clip(column * (columns - 1), 0, columns - 1 - 1e-6)
        i, j = row.astype(np.intp), column.astype(np.intp)
        return cls(i * columns + j, (row - i)[..., None], (column - j)[..., None], np.sign(y_mm))


def polar_table(solution: Solution, record: Record) -> PolarTable:
    """Recover the membrane between the vertices by a C¹ piecewise cubic and tabulate it."""
    from scipy.interpolate import CloughTocher2DInterpolator
    from scipy.spatial import cKDTree

    problem = solution.problem
    rest, displacement, _ = solution.whole_surface(record)
    low, high = rest.min(axis=0), rest.max(axis=0)
    rim = float(np.hypot(*rest.T).max())
    extent = rim if problem.pad_mm is None else np.hypot(*np.maximum(-low, high))
    radius = _radius(np.arange(np.ceil(_row(np.array(extent))) + 1))
    half_circle = np.linspace(0, np.pi, _SECTORS + 1)
    turn = half_circle if problem.symmetric else np.linspace(0, 2 * np.pi, 2 * _SECTORS + 1)
    # The mesh is a polygon, cut at the pad's edges: points beyond it take the displacement of its rim.
    meshed = np.minimum(radius, 0.999 * rim * np.cos(np.pi / (2 * problem.mesh_size.sectors)))
    x, y = np.outer(meshed, np.cos(turn)), np.outer(meshed, np.sin(turn))
    x, y = np.clip(x, low[0], high[0]), np.clip(y, low[1], high[1])
    points = np.stack([x, y], -1)
    values = CloughTocher2DInterpolator(rest, displacement)(points)
    outside = np.isnan(values[..., 0])
    values[outside] = displacement[cKDTree(rest).query(points[outside])[1]]
    return PolarTable(values.astype(np.float32), problem.symmetric)


def _row(radius_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    fine = np.minimum(radius_mm, _FINE_RADIUS_MM) / _FINE_SPACING_MM
    return fine + np.maximum(radius_mm - _FINE_RADIUS_MM, 0) / _COARSE_SPACING_MM


def _radius(row: NDArray[np.float64]) -> NDArray[np.float64]:
    fine_rows = _FINE_RADIUS_MM / _FINE_SPACING_MM
    return np.minimum(row, fine_rows) * _FINE_SPACING_MM + np.maximum(row - fine_rows, 0) * _COARSE_SPACING_MM
