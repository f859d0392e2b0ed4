"""Scattered light: what walls, the gel and dents reflect, as a polynomial of the normal and of the place.

Light that no LED sends directly is smooth in the normal and in the place. It is Σ s (Y(n) − Y(flat)) q(x, y), Y the
real spherical harmonics up to an order and q the monomials of the place: on the flat membrane it is zero by
construction, so that a coefficient never changes the reference. `ambient` is light that the flat membrane has too.
"""

from typing import Annotated

import numba
import numpy as np
from pydantic import Field, model_validator

from gelgap.assets.settings import Settings
from gelgap.render.surface import Lattice, Surface

HARMONICS = (0, 3, 8, 15)
"""How many harmonics there are up to each order, without the constant."""
PLACES = (1, 3, 6)
"""How many monomials of the place there are up to each degree."""
LARGEST = 5.0
Span = Annotated[
    tuple[float, float, float, float],
    Field(description="x from, to, y from, to: the place is held at its edges"),
]
EVERYWHERE: Span = (-100.0, 100.0, -100.0, 100.0)
Scale = Annotated[float, Field(gt=0.1, le=1000, description="length that x and y are divided by")]


class Scattered(Settings):
    """Scattered light of an illumination, in linear camera RGB at exposure 1.

    The place is (x, y) / `scale_mm`, held at the edges of `span_mm`: the ground that the calibration's presses covered.
    """

    order: int = Field(default=0, ge=0, le=3, description="highest order of the harmonics; 0: none")
    degree: int = Field(default=0, ge=0, le=2, description="highest degree of the place")
    coefficients: tuple[tuple[float, ...], ...] = Field(
        repr=False,
        default=((), (), ()),
        description="by channel; harmonics × places, places fastest; each at most 5 in size",
    )
    ambient: tuple[tuple[float, ...], ...] = Field(
        repr=False,
        default=((), (), ()),
        description="by channel: light of the flat membrane too, for 1, x and y; none if empty",
    )
    span_mm: Span = EVERYWHERE
    scale_mm: Scale = 10.0

    @model_validator(mode="after")
    def _check(self) -> "Scattered":
        for name, many in (
            ("coefficients", (HARMONICS[self.order] * PLACES[self.degree],)),
            ("ambient", (0, PLACES[1])),
        ):
            rows = getattr(self, name)
            if len(rows) != 3 or any(len(row) not in many for row in rows):
                raise ValueError(
                    f"{name} must have 3 rows of {' or '.join(map(str, many))} numbers at order {self.order} and "
                    f"degree {self.degree}"
                )
            if any(abs(value) > LARGEST for row in rows for value in row):
                raise ValueError(f"{name} must lie in [-{LARGEST:g}, {LARGEST:g}]")
        x0, x1, y0, y1 = self.span_mm
        if x0 > x1 or y0 > y1:
            raise ValueError(f"span_mm = {self.span_mm} must have x and y from below to")
        return self


def monomials(x: np.ndarray, y: np.ndarray, degree: int) -> np.ndarray:
    """Return (…, places): 1, x, y, x², xy, y² up to a degree."""
    parts = [np.ones_like(x), x, y, x * x, x * y, y * y]
    return np.stack(parts[: PLACES[degree]], axis=-1)


def places(x_mm: np.ndarray, y_mm: np.ndarray, span_mm: Span, scale_mm: float, degree: int) -> np.ndarray:
    """Return the monomials of places in mm, in units of the scale and held at the edges of the span."""
    x0, x1, y0, y1 = span_mm
    return monomials(np.clip(x_mm, x0, x1) / scale_mm, np.clip(y_mm, y0, y1) / scale_mm, degree)


@numba.njit(cache=True, error_model="numpy", fastmath=True, inline="always")
def _fill_harmonics(x, y, z, out):
    """Write the harmonics of a unit normal, less those of the flat normal (0, 0, −1), up to as many as `out` holds."""
    one = z + 1 - z  # of the type of z, so that single precision stays single
    out[0] = x
    out[1] = y
    out[2] = z + one
    if len(out) >= 8:
        out[3] = x * y
        out[4] = x * z
        out[5] = y * z
        out[6] = x * x - y * y
        out[7] = one - z * z
    if len(out) >= 15:
        five_z2 = 5 * one * z * z - one
        out[8] = x * (x * x - 3 * one * y * y)
        out[9] = y * (3 * one * x * x - y * y)
        out[10] = x * y * z
        out[11] = z * (x * x - y * y)
        out[12] = x * five_z2
        out[13] = y * five_z2
        out[14] = 5 * one * z * z * z - 3 * one * z + 2 * one


@numba.njit(cache=True, error_model="numpy")
def _harmonics(normals, out):
    for i in range(len(normals)):
        _fill_harmonics(normals[i, 0], normals[i, 1], normals[i, 2], out[i])


def harmonics(normals: np.ndarray, order: int) -> np.ndarray:
    """Return (n, harmonics) of unit normals (n, 3), each 0 for the flat normal (0, 0, −1)."""
    out = np.zeros((len(normals), HARMONICS[order]))
    if order > 0:
        _harmonics(np.asarray(normals, float), out)
    return out


class ScatteredTable:
    """Scattered light prepared for one lattice: the place's polynomials summed once, harmonics left to each frame."""

    def __init__(self, scattered: Scattered, lattice: Lattice, exposure: float) -> None:
        x, y = np.meshgrid(lattice.x_mm, lattice.y_mm)
        count = HARMONICS[scattered.order]
        by_place = np.array(scattered.coefficients).reshape(3, count, PLACES[scattered.degree])
        span_mm, scale_mm = scattered.span_mm, scattered.scale_mm
        table = np.einsum("yxj,clj->yxcl", places(x, y, span_mm, scale_mm, scattered.degree), by_place)
        ambient = np.zeros((lattice.rows, lattice.columns, 3))
        for channel, row in enumerate(scattered.ambient):
            if row:
                ambient[..., channel] = places(x, y, span_mm, scale_mm, 1) @ row
        self._by_harmonic = np.ascontiguousarray(exposure * table, np.float32)
        self._ambient = (exposure * ambient).astype(np.float32)

    def add_to(self, linear: np.ndarray, surface: Surface) -> None:
        """Add the scattered light of a surface to (rows, columns, 3) linear light, which stays at 0 or above."""
        positions, normals, _, changed, grid = surface
        _add(positions, normals, changed, grid, self._by_harmonic, self._ambient, linear)


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _add(positions, normals, changed, grid, by_harmonic, ambient, linear):
    rows, columns, _ = linear.shape
    count = by_harmonic.shape[3]
    zero, half = np.float32(0), np.float32(0.5)
    values = np.zeros(max(count, 1), np.float32)
    for j in range(rows):
        for i in range(columns):
            row, column = j, i
            moved = changed[j, i]
            if moved:
                # A vertex has the scattered light of where it now is; the next lattice point is near enough.
                u = (positions[j, i, 0] - grid.x0_mm) * grid.cells_per_mm + half
                v = (positions[j, i, 1] - grid.y0_mm) * grid.cells_per_mm + half
                column = int(min(max(u, zero), np.float32(columns - 1)))
                row = int(min(max(v, zero), np.float32(rows - 1)))
                if count > 0:
                    _fill_harmonics(normals[j, i, 0], normals[j, i, 1], normals[j, i, 2], values)
            for channel in range(3):
                total = linear[j, i, channel] + ambient[row, column, channel]
                if moved:
                    for k in range(count):
                        total += values[k] * by_harmonic[row, column, channel, k]
                linear[j, i, channel] = max(total, zero)
