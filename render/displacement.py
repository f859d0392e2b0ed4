"""A membrane as a caller gives it: checked, and brought onto the renderer's lattice."""

from dataclasses import dataclass

import numba
import numpy as np

from gelgap.render.lattice import TAPER_MM, Lattice

UNIFORM_TOLERANCE_MM = 1e-4
# Spacings are the same below this relative difference.
UNIFORM_STRETCH = 1e-6


@dataclass(frozen=True)
class Membrane:
    """The displacement of the outer membrane on a regular rest grid; pressing moves to −z.

    Raises
    ------
    ValueError
        With the membrane's name, if the grid is not regular, shapes do not match or a value is not finite.
    """

    x_mm: np.ndarray  # (nx,)
    y_mm: np.ndarray  # (ny,)
    displacement_mm: np.ndarray  # (ny, nx, 3)
    name: str = "membrane"

    def __post_init__(self) -> None:
        shape, expected = np.shape(self.displacement_mm), (len(self.y_mm), len(self.x_mm), 3)
        if shape != expected:
            raise ValueError(
                f"{self.name}: displacement_mm has shape {shape}; x_mm and y_mm ask for {expected}"
            )
        self._check_axis("x_mm", self.x_mm)
        self._check_axis("y_mm", self.y_mm)
        bad = np.count_nonzero(~np.isfinite(self.displacement_mm))
        if bad:
            raise ValueError(f"{self.name}: displacement_mm has {bad} values that are not finite")

    def _check_axis(self, axis: str, values_mm: np.ndarray) -> None:
        values_mm = np.asarray(values_mm, float)
        if values_mm.ndim != 1 or len(values_mm) < 4:
            raise ValueError(
                f"{self.name}: {axis} must be a vector of at least 4 values, not of shape {values_mm.shape}"
            )
        _, spacing_mm = _start_and_spacing(values_mm)
        steps_mm = np.diff(values_mm)
        uneven = np.abs(steps_mm - spacing_mm).max() > UNIFORM_TOLERANCE_MM
        if not np.isfinite(spacing_mm) or spacing_mm <= 0 or uneven:
            raise ValueError(f"{self.name}: {axis} must increase in equal steps")

    def displacement_on(self, lattice: Lattice) -> np.ndarray:
        """Return the (rows, columns, 3) displacement on the lattice's points."""
        return self.field_on(lattice, np.asarray(self.displacement_mm))

    def field_on(self, lattice: Lattice, field: np.ndarray) -> np.ndarray:
        """Return a (ny, nx, 3) field of the membrane on the lattice's points, which are taken if the grid has them."""
        x, y = _start_and_spacing(self.x_mm), _start_and_spacing(self.y_mm)
        rows = _points_among(lattice.y0_mm, lattice.rows, lattice.spacing_mm, y, field.shape[0])
        columns = _points_among(lattice.x0_mm, lattice.columns, lattice.spacing_mm, x, field.shape[1])
        if rows is not None and columns is not None:
            return np.ascontiguousarray(field[rows, columns])
        return _resample(field.astype(float), x, y, lattice.x_mm, lattice.y_mm, TAPER_MM)


def _start_and_spacing(axis_mm: np.ndarray) -> tuple[float, float]:
    first_mm, last_mm = float(axis_mm[0]), float(axis_mm[-1])
    return first_mm, (last_mm - first_mm) / (len(axis_mm) - 1)


def _points_among(
    first_mm: float, count: int, spacing_mm: float, axis: tuple[float, float], length: int
) -> slice | None:
    """Return which points of an axis (first value, spacing) of some length the given ones are; None if others."""
    start_mm, step_mm = axis
    first = round((first_mm - start_mm) / step_mm)
    apart = abs(start_mm + first * step_mm - first_mm) > UNIFORM_TOLERANCE_MM
    stretched = abs(step_mm / spacing_mm - 1) > UNIFORM_STRETCH
    if apart or stretched or first < 0 or first + count > length:
        return None
    return slice(first, first + count)


@numba.njit(cache=True)
def _cubic_weights(t):
    return (
        -0.5 * t + t * t - 0.5 * t * t * t,
        1 - 2.5 * t * t + 1.5 * t * t * t,
        0.5 * t + 2 * t * t - 1.5 * t * t * t,
        -0.5 * t * t + 0.5 * t * t * t,
    )


@numba.njit(cache=True)
def _resample(field, x_axis, y_axis, x_mm, y_mm, taper_mm):
    """Catmull-Rom interpolation of a (rows, columns, 3) field; beyond its edge it fades linearly to 0.

    An axis of the field is (first value, spacing); x_mm and y_mm are the axes of the result.
    """
    rows, columns, channels = field.shape
    (x0, dx), (y0, dy) = x_axis, y_axis
    out = np.empty((len(y_mm), len(x_mm), channels))
    weights, neighbours = np.empty((len(x_mm), 4)), np.empty((len(x_mm), 4), np.int64)
    beyond_x_mm = np.empty(len(x_mm))
    for io in range(len(x_mm)):
        u = (x_mm[io] - x0) / dx
        inside_u = min(max(u, 0.0), columns - 1.0)
        i = min(int(inside_u), columns - 2)
        wu = _cubic_weights(inside_u - i)
        for a in range(4):
            weights[io, a], neighbours[io, a] = wu[a], min(max(i + a - 1, 0), columns - 1)
        beyond_x_mm[io] = abs(u - inside_u) * dx
    row = np.empty((columns, channels))  # between the field's rows, at its columns
    for jo in range(len(y_mm)):
        v = (y_mm[jo] - y0) / dy
        inside_v = min(max(v, 0.0), rows - 1.0)
        j = min(int(inside_v), rows - 2)
        wv = _cubic_weights(inside_v - j)
        row[:] = 0.0
        for b in range(4):
            at = field[min(max(j + b - 1, 0), rows - 1)]
            for i in range(columns):
                for k in range(channels):
                    row[i, k] += wv[b] * at[i, k]
        for io in range(len(x_mm)):
            fade = max(0.0, 1 - max(beyond_x_mm[io], abs(v - inside_v) * dy) / taper_mm)
            for k in range(channels):
                total = 0.0
                for a in range(4):
                    total += weights[io, a] * row[neighbours[io, a], k]
                out[jo, io, k] = fade * total
    return out
