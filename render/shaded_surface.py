"""The deformed membrane as shading needs it: positions, normals, a height map in world coordinates, what changed."""

from typing import NamedTuple

import numba
import numpy as np

from gelgap.render.lattice import Grid, Lattice

# Below these a vertex counts as undeformed: the picture then differs by less than one code value.
CHANGED_MM = 8e-3
CHANGED_SLOPE = 8e-4
# A triangle is folded if its area, in cells and seen from the camera, is below minus this.
FOLDED_AREA = 0.05


class Surface(NamedTuple):
    """A deformed membrane on a lattice, as kernels take it: float32, row-major; heights are −z, towards the camera."""

    positions_mm: np.ndarray  # (rows, columns, 3)
    normals: np.ndarray  # (rows, columns, 3), towards the camera
    height_mm: np.ndarray  # (rows, columns), of the deformed surface above the lattice's own points
    changed: np.ndarray  # (rows, columns) bool: moved or tilted, so lit otherwise than undeformed
    grid: Grid

    def all_changed(self) -> "Surface":
        """Return the surface with every vertex marked as changed, so that all light is computed."""
        return self._replace(changed=np.ones_like(self.changed))


@numba.njit(cache=True, error_model="numpy")
def _positions(displacement, x_mm, y_mm, positions):
    for j in range(len(y_mm)):
        for i in range(len(x_mm)):
            positions[j, i, 0] = displacement[j, i, 0] + x_mm[i]
            positions[j, i, 1] = displacement[j, i, 1] + y_mm[j]
            positions[j, i, 2] = displacement[j, i, 2]


@numba.njit(cache=True, error_model="numpy")
def _normals_and_changed(positions, columns_mm, rows_mm, changed_mm, changed_slope, normals, changed):
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
            changed[j, i] = moved > changed_mm or slope > changed_slope


@numba.njit(cache=True, error_model="numpy")
def _triangle_heights(a, b, c, height):
    """Write −z of a triangle of corners (x, y in cells, z in mm) to the lattice points under it."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = a, b, c
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if area <= np.float32(1e-3):
        return  # upright, or leaning over by a hair as at the rim of a dragged contact: nothing lies under it
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


@numba.njit(cache=True, error_model="numpy")
def _in_cells(positions, j, i, grid):
    """Return a vertex as (x in cells, y in cells, z in mm)."""
    x = (positions[j, i, 0] - grid.x0_mm) * grid.cells_per_mm
    y = (positions[j, i, 1] - grid.y0_mm) * grid.cells_per_mm
    return x, y, positions[j, i, 2]


@numba.njit(cache=True, error_model="numpy")
def _is_folded(a, b, c):
    """Return whether a triangle of corners in cells is turned over."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]) < np.float32(-FOLDED_AREA)


@numba.njit(cache=True, error_model="numpy")
def _world_heights(positions, changed, grid, height):
    """Raster the deformed surface onto the lattice's own points; return how many triangles are folded.

    Where nothing changed, a vertex still stands on its own point.
    """
    rows, columns, _ = positions.shape
    folded = 0
    for j in range(rows):
        for i in range(columns):
            height[j, i] = -positions[j, i, 2]
    for j in range(rows - 1):
        for i in range(columns - 1):
            if not (changed[j, i] or changed[j, i + 1] or changed[j + 1, i] or changed[j + 1, i + 1]):
                continue
            a, b = _in_cells(positions, j, i, grid), _in_cells(positions, j, i + 1, grid)
            c, d = _in_cells(positions, j + 1, i + 1, grid), _in_cells(positions, j + 1, i, grid)
            folded += _is_folded(a, b, c)
            folded += _is_folded(a, c, d)
            _triangle_heights(a, b, c, height)
            _triangle_heights(a, c, d, height)
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


def deformed_surface(
    lattice: Lattice,
    displacement_mm: np.ndarray,
    name: str,
    changed_mm: float = CHANGED_MM,
    changed_slope: float = CHANGED_SLOPE,
) -> Surface:
    """Return the surface of a displacement on the lattice.

    Raises
    ------
    ValueError
        With the membrane's name, if the membrane is folded: one rest point in front of another.
    """
    columns_mm, rows_mm = lattice.x_mm.astype(np.float32), lattice.y_mm.astype(np.float32)
    positions = np.empty((lattice.rows, lattice.columns, 3), np.float32)
    if displacement_mm.shape != positions.shape:
        raise ValueError(
            f"{name}: the displacement has shape {displacement_mm.shape}, the lattice {positions.shape}"
        )
    _positions(displacement_mm, lattice.x_mm, lattice.y_mm, positions)
    height = np.empty((lattice.rows, lattice.columns), np.float32)
    normals, changed = np.empty_like(positions), np.empty(height.shape, bool)
    _normals_and_changed(
        positions, columns_mm, rows_mm, np.float32(changed_mm), np.float32(changed_slope), normals, changed
    )
    folded = _world_heights(positions, changed, lattice.grid, height)
    if folded:
        raise ValueError(
            f"{name}: the displacement folds the membrane in {folded} triangles (neighbouring points have "
            "changed places); it is not a surface that a camera could see"
        )
    return Surface(positions, normals, height, changed, lattice.grid)
