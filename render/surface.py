"""From a membrane as a caller gives it to the surface that is lit: the renderer's grid, positions, normals, heights."""

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from gelgap.render.imaging import Camera

# What a state covers by convention: the paper's 12×9 mm footprint and a margin of 1 mm for shadows and perspective.
STATE_HALF_EXTENT_MM = (7.0, 5.5)
MARGIN_MM = 1.0
# Extents are rounded up to whole steps of this, so that cameras that differ little share their membranes.
EXTENT_STEP_MM = 0.5
TAPER_MM = 3.0
# Grids are regular, and their points the same, within this distance and, relative, this stretch.
UNIFORM_TOLERANCE_MM = 1e-4
UNIFORM_STRETCH = 1e-6
# Below these a vertex counts as undeformed: the picture then differs by less than one code value.
CHANGED_MM, CHANGED_SLOPE = np.float32(8e-3), np.float32(8e-4)
# A triangle is folded if its area, in cells and seen from the camera, is below minus this.
FOLDED_AREA = 0.05


# numba's cache on disk refers by name to the NamedTuples that kernels take. Who renames or removes one must rename the
# modules of those kernels too: a cache that an older version has left there would fail to load.
class Grid(NamedTuple):
    """Where a lattice's first point lies and how far apart its points are, as kernels take it: float32."""

    x0_mm: np.float32
    y0_mm: np.float32
    spacing_mm: np.float32
    cells_per_mm: np.float32


def view_half_extent_mm(camera: Camera, size_px: tuple[int, int]) -> tuple[float, float]:
    """Return how far a membrane must reach from the sensor's centre along x and y for a picture of this size.

    That is a state's convention, or what the camera sees with a margin where it is larger.
    """
    half_mm = _half_extent_mm(camera, size_px)
    return tuple((np.ceil(half_mm / EXTENT_STEP_MM - 1e-3) * EXTENT_STEP_MM).tolist())


def _half_extent_mm(camera: Camera, size_px: tuple[int, int]) -> np.ndarray:
    camera.farthest_slope(size_px)  # or a ValueError
    edges = (np.array([-0.5, side / 2 - 0.5, side - 0.5]) for side in size_px)
    columns, rows = map(np.ravel, np.meshgrid(*edges))
    seen_mm = np.abs(camera.plane_points_mm(columns, rows, size_px)).max(axis=0)
    footprint_mm = np.asarray(camera.footprint_mm(size_px)) / 2 + np.abs(camera.position_mm[:2])
    # What a lens shows beyond the footprint may take most of the margin.
    return np.max([STATE_HALF_EXTENT_MM, footprint_mm + MARGIN_MM, seen_mm + MARGIN_MM / 4], axis=0)


@dataclass(frozen=True)
class Lattice:
    """A regular grid of points in the plane of the undeformed membrane, row-major, rows along +y."""

    x0_mm: float
    y0_mm: float
    spacing_mm: float
    columns: int
    rows: int

    @classmethod
    def covering(cls, camera: Camera, size_px: tuple[int, int], spacing_mm: float) -> "Lattice":
        """Return the grid that covers a state's convention and what the camera sees with its margin.

        Every second of its vertices reach as far.
        """
        half_mm = _half_extent_mm(camera, size_px)
        half_cells = np.ceil(half_mm / spacing_mm - 1e-3).astype(int)
        x0_mm, y0_mm = (-half_cells * spacing_mm).tolist()
        columns, rows = (2 * half_cells + 1).tolist()
        return cls(x0_mm, y0_mm, spacing_mm, columns, rows)

    @property
    def x_mm(self) -> np.ndarray:
        return self.x0_mm + self.spacing_mm * np.arange(self.columns)

    @property
    def y_mm(self) -> np.ndarray:
        return self.y0_mm + self.spacing_mm * np.arange(self.rows)

    @property
    def grid(self) -> Grid:
        return Grid(*np.float32([self.x0_mm, self.y0_mm, self.spacing_mm, 1 / self.spacing_mm]))

    def points_mm(self) -> np.ndarray:
        """Return (rows, columns, 2) rest coordinates."""
        return np.stack(np.meshgrid(self.x_mm, self.y_mm), axis=-1)

    def every(self, step: int) -> "Lattice":
        """Return the grid of every `step`-th vertex of this one."""
        columns, rows = ((count - 1) // step + 1 for count in (self.columns, self.rows))
        return Lattice(self.x0_mm, self.y0_mm, self.spacing_mm * step, columns, rows)


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


class Surface(NamedTuple):
    """A deformed membrane on a lattice, as kernels take it: float32, row-major; heights are −z, towards the camera."""

    positions_mm: np.ndarray  # (rows, columns, 3)
    normals: np.ndarray  # (rows, columns, 3), towards the camera
    height_mm: np.ndarray  # (rows, columns), of the deformed surface above the lattice's own points
    changed: np.ndarray  # (rows, columns) bool: moved or tilted, so lit otherwise than undeformed
    grid: Grid


@numba.njit(cache=True, error_model="numpy")
def _normals_and_changed(positions, columns_mm, rows_mm, normals, changed):
    rows, columns, _ = positions.shape
    for j in range(rows):
        up, down = max(j - 1, 0), min(j + 1, rows - 1)
        for i in range(columns):
            left, right = max(i - 1, 0), min(i + 1, columns - 1)
            ax = positions[j, right, 0] - positions[j, left, 0]
            ay = positions[j, right, 1] - positions[j, left, 1]
            az = positions[j, right, 2] - positions[j, left, 2]
            bx = positions[down, i, 0] - positions[up, i, 0]
            by = positions[down, i, 1] - positions[up, i, 1]
            bz = positions[down, i, 2] - positions[up, i, 2]
            nx = az * by - ay * bz
            ny = ax * bz - az * bx
            nz = ay * bx - ax * by
            scale = np.float32(1) / np.sqrt(nx * nx + ny * ny + nz * nz)
            normals[j, i, 0] = nx * scale
            normals[j, i, 1] = ny * scale
            normals[j, i, 2] = nz * scale
            moved = max(
                abs(positions[j, i, 0] - columns_mm[i]),
                abs(positions[j, i, 1] - rows_mm[j]),
                abs(positions[j, i, 2]),
            )
            slope = max(abs(nx * scale), abs(ny * scale))
            changed[j, i] = moved > CHANGED_MM or slope > CHANGED_SLOPE


@numba.njit(cache=True, error_model="numpy")
def _triangle_heights(a, b, c, height):
    """Write −z of a triangle (corners in cells, in mm) to the lattice points under it; return whether it is folded."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = a, b, c
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if area <= np.float32(1e-3):
        # Upright, or leaning over by a hair as at the rim of a dragged contact: nothing lies under it.
        return area < np.float32(-FOLDED_AREA)
    rows, columns = height.shape
    i0 = max(int(np.ceil(min(ax, bx, cx))), 0)
    i1 = min(int(np.floor(max(ax, bx, cx))), columns - 1)
    j0 = max(int(np.ceil(min(ay, by, cy))), 0)
    j1 = min(int(np.floor(max(ay, by, cy))), rows - 1)
    tolerance = np.float32(-1e-4)
    inverse = np.float32(1) / area
    for j in range(j0, j1 + 1):
        for i in range(i0, i1 + 1):
            x, y = np.float32(i), np.float32(j)
            wb = ((x - ax) * (cy - ay) - (cx - ax) * (y - ay)) * inverse
            wc = ((bx - ax) * (y - ay) - (x - ax) * (by - ay)) * inverse
            if wb >= tolerance and wc >= tolerance and wb + wc <= np.float32(1) - tolerance:
                height[j, i] = -(az + wb * (bz - az) + wc * (cz - az))
    return False


@numba.njit(cache=True, error_model="numpy")
def _in_cells(positions, j, i, grid):
    """Return a vertex as (x in cells, y in cells, z in mm)."""
    x = (positions[j, i, 0] - grid.x0_mm) * grid.cells_per_mm
    y = (positions[j, i, 1] - grid.y0_mm) * grid.cells_per_mm
    return x, y, positions[j, i, 2]


@numba.njit(cache=True, error_model="numpy")
def _world_heights(positions, changed, grid, height):
    """Raster the deformed surface onto the lattice's own points; return how many triangles are folded.

    `height` holds −z of the vertices at first: where nothing changed, a vertex still stands on its own point.
    """
    rows, columns, _ = positions.shape
    folded = 0
    for j in range(rows - 1):
        for i in range(columns - 1):
            if not (changed[j, i] or changed[j, i + 1] or changed[j + 1, i] or changed[j + 1, i + 1]):
                continue
            a, b = _in_cells(positions, j, i, grid), _in_cells(positions, j, i + 1, grid)
            c, d = _in_cells(positions, j + 1, i + 1, grid), _in_cells(positions, j + 1, i, grid)
            folded += _triangle_heights(a, b, c, height)
            folded += _triangle_heights(a, c, d, height)
    return folded


_last_surface: tuple[Lattice, np.ndarray, Surface] | None = None


def shared_surface(lattice: Lattice, displacement_mm: np.ndarray, name: str) -> Surface:
    """Return `deformed_surface`; the same displacement again, as under another light, gives the last one again."""
    global _last_surface
    last = _last_surface
    if last is not None and last[0] == lattice and np.array_equal(last[1], displacement_mm):
        return last[2]
    surface = deformed_surface(lattice, displacement_mm, name)
    _last_surface = (lattice, displacement_mm.copy(), surface)
    return surface


def deformed_surface(lattice: Lattice, displacement_mm: np.ndarray, name: str) -> Surface:
    """Return the surface of a displacement on the lattice.

    Raises
    ------
    ValueError
        With the membrane's name, if the membrane is folded: one rest point in front of another.
    """
    columns_mm, rows_mm = lattice.x_mm.astype(np.float32), lattice.y_mm.astype(np.float32)
    positions = np.empty((lattice.rows, lattice.columns, 3), np.float32)
    positions[:] = displacement_mm
    positions[..., 0] = displacement_mm[..., 0] + lattice.x_mm
    positions[..., 1] = displacement_mm[..., 1] + lattice.y_mm[:, None]
    height = np.negative(positions[..., 2], order="C")
    normals, changed = np.empty_like(positions), np.empty(height.shape, bool)
    _normals_and_changed(positions, columns_mm, rows_mm, normals, changed)
    folded = _world_heights(positions, changed, lattice.grid, height)
    if folded:
        raise ValueError(
            f"{name}: the displacement folds the membrane in {folded} triangles (neighbouring points have "
            "changed places); it is not a surface that a camera could see"
        )
    return Surface(positions, normals, height, changed, lattice.grid)
