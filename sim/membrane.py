"""The deformed outer membrane of one pose: its state and file, and how it follows from a solution's vertices."""

import io
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from gelgap.assets.array_file import read_arrays, write_arrays
from gelgap.sim.estimate import Diagnostics, Errors
from gelgap.sim.grading import sizes_along
from gelgap.sim.indenter import Floats, Indenter
from gelgap.sim.problem import MESHES, ContactProblem
from gelgap.sim.scene import Elastomer, Pose
from gelgap.sim.solution import Record, Solution

GRID_SPACING_MM = 0.1
GRID_HALF_EXTENT_MM = (7.0, 5.5)

# The arrays of a saved state.
_NEEDED = ("x_mm", "y_mm", "displacement_mm")
_OPTIONAL = ("contact", "force_n", "torque_n_mm", "contact_radius_mm", "converged")

# A triangle of the grid is folded if its area, in cells and seen from the camera, is below minus this; the renderer
# refuses the same.
FOLDED_AREA = 0.05

# Chosen beside the references; the file says what each does.
_MEMBRANE = SimpleNamespace(**MESHES["membrane"])


# A polar table's rows are this far apart up to a radius, and further apart beyond it.
_FINE_SPACING_MM = 0.05
_COARSE_SPACING_MM = 0.25
_FINE_RADIUS_MM = 4.0
_SECTORS = 64
_INSET_MM = 1e-9  # points beyond the vertices' hull are moved this far inside: rounding bends its edges


def grid_axes(half_extent_mm: tuple[float, float] = GRID_HALF_EXTENT_MM) -> tuple[Floats, Floats]:
    """Return the rest grid's axes, centred on the sensor: x_mm (141,) and y_mm (111,), or more values.

    The grid reaches at least `half_extent_mm` from the centre along x and y, and never less far than by default.
    """
    extents_mm = map(max, GRID_HALF_EXTENT_MM, half_extent_mm)
    cells = (math.ceil(extent_mm / GRID_SPACING_MM - 1e-3) for extent_mm in extents_mm)
    x_mm, y_mm = (np.round(np.arange(-count, count + 1) * GRID_SPACING_MM, 9) for count in cells)
    return x_mm, y_mm


@dataclass(frozen=True, eq=False)
class MembraneState:
    """The outer membrane on its rest grid, in the sensor's frame.

    `displacement_mm` is (ny, nx, 3), `contact` (ny, nx) bool, `force_n` (3,) the force of the indenter on the sensor,
    `torque_n_mm` (3,) its torque about the contact point p on the undeformed membrane; about the sensor's origin it is
    `torque_n_mm` + p × `force_n`. `contact_radius_mm` is the deformed radius where the normal pressure vanishes (0
    without contact).
    """

    x_mm: Floats
    y_mm: Floats
    displacement_mm: NDArray[np.float32]
    contact: NDArray[np.bool_]
    force_n: Floats
    contact_radius_mm: float = 0.0
    converged: bool = True
    diagnostics: Diagnostics = field(default_factory=Diagnostics)
    torque_n_mm: Floats = field(default_factory=lambda: np.zeros(3))

    def __repr__(self) -> str:
        x_n, y_n, z_n = self.force_n
        how = "converged" if self.converged else "NOT converged"
        return (
            f"MembraneState(force ({x_n:+.3f}, {y_n:+.3f}, {z_n:+.3f}) N, contact radius {self.contact_radius_mm:.2f} "
            f"mm, {len(self.x_mm)}×{len(self.y_mm)} points, {how})"
        )

    def _repr_png_(self) -> bytes:
        """Return the membrane's depth as a picture, which notebooks show."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(4.5, 3.2), layout="constrained")
        panel = figure.subplots()
        edges_mm = self.x_mm[0], self.x_mm[-1], self.y_mm[-1], self.y_mm[0]
        depth = panel.imshow(-self.displacement_mm[..., 2], extent=edges_mm)
        panel.set(xlabel="x, mm", ylabel="y, mm")
        figure.colorbar(depth, ax=panel, label="depth, mm")
        png = io.BytesIO()
        figure.savefig(png, format="png")
        return png.getvalue()

    @property
    def rest_mm(self) -> Floats:
        """Where the grid's points are on the undeformed membrane, (ny, nx, 3)."""
        return np.stack([*np.meshgrid(self.x_mm, self.y_mm), np.zeros(self.contact.shape)], axis=-1)

    @property
    def places_mm(self) -> Floats:
        """Where the grid's points are on the deformed membrane, (ny, nx, 3)."""
        return self.rest_mm + self.displacement_mm

    @property
    def error(self) -> Errors:
        """How far the state may be off: the estimates of its `diagnostics`."""
        found = self.diagnostics
        return Errors(np.array(found.force_error_n), found.contact_radius_error_mm, found.membrane_error_mm)

    @classmethod
    def untouched(cls, x_mm: Floats, y_mm: Floats, **fields: Any) -> Self:
        """Return the undeformed membrane, without contact, on a grid's axes; `fields` are those of a subclass."""
        shape = (len(y_mm), len(x_mm))
        displacement_mm, contact = np.zeros((*shape, 3), np.float32), np.zeros(shape, dtype=bool)
        return cls(x_mm, y_mm, displacement_mm, contact, np.zeros(3), **fields)

    def save(self, path: str | Path) -> None:
        """Write the state to an npz file (keys x_mm, y_mm, displacement_mm, contact, force_n, and scalars)."""
        write_arrays(path, {name: getattr(self, name) for name in (*_NEEDED, *_OPTIONAL)})

    @staticmethod
    def load(path: str | Path) -> "MembraneState":
        """Read a state that `save` wrote, or any npz with x_mm, y_mm and displacement_mm.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is not an .npz file of arrays, one is missing or damaged, or shapes or types do not match.
        """
        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"membrane state {path} does not exist")
        try:
            arrays = read_arrays(path, (*_NEEDED, *_OPTIONAL))
        except ValueError as error:
            raise ValueError(f"{path} is not an .npz file of arrays ({error})") from None
        missing = [name for name in _NEEDED if name not in arrays]
        if missing:
            raise ValueError(f"{path} lacks {', '.join(missing)}: a membrane needs {', '.join(_NEEDED)}")
        for name in ("x_mm", "y_mm"):
            if arrays[name].ndim != 1:
                raise ValueError(f"{name} in {path} has shape {arrays[name].shape}: must be (n,)")
        untouched = MembraneState.untouched(arrays["x_mm"], arrays["y_mm"])
        found: dict[str, Any] = {}
        for name, values in arrays.items():
            like = getattr(untouched, name)
            if values.dtype.kind not in "biuf":
                raise ValueError(f"{name} in {path} holds {values.dtype}: must be numbers")
            if values.shape != np.shape(like):
                raise ValueError(f"{name} in {path} has shape {values.shape}: must be {np.shape(like)}")
            found[name] = values if values.shape else type(like)(values)
        return replace(untouched, **found)


def covered_extent_mm(
    elastomer: Elastomer, indenter: Indenter, pose: Pose, half_extent_mm: tuple[float, float]
) -> tuple[float, float]:
    """Return how far from the sensor's centre, along x and y, a grid reaches that covers a contact.

    That is at least `half_extent_mm`, but no further than the pad if that is larger than the grid by default.
    """
    reach_mm = pose.radius_mm + _MEMBRANE.covered_radii * indenter.penetration_radius_mm(pose.depth_mm)
    wanted_x, wanted_y = half_extent_mm
    size_x, size_y = elastomer.pad_size_mm
    return (
        min(max(wanted_x, abs(pose.point_x_mm) + reach_mm), size_x / 2),
        min(max(wanted_y, abs(pose.point_y_mm) + reach_mm), size_y / 2),
    )


def is_folded(x_mm: Floats, y_mm: Floats, displacement_mm: NDArray[np.float32]) -> bool:
    """Return whether a displaced rest grid lies on itself: one rest point in front of another, for the camera."""
    x = displacement_mm[..., 0] + x_mm.astype(np.float32)
    y = displacement_mm[..., 1] + y_mm.astype(np.float32)[:, None]
    # The two triangles of each cell share the diagonal from its first corner.
    first = np.s_[:-1, :-1]
    (right_x, across_x, up_x), (right_y, across_y, up_y) = (
        (v[:-1, 1:] - v[first], v[1:, 1:] - v[first], v[1:, :-1] - v[first]) for v in (x, y)
    )
    lower = right_x * across_y - across_x * right_y
    upper = across_x * up_y - up_x * across_y
    return bool(min(lower.min(), upper.min()) < -FOLDED_AREA * GRID_SPACING_MM**2)


def press_onto(
    indenter: Indenter, rest_mm: Floats, displacement_mm: NDArray[np.floating], origin_mm: Floats
) -> NDArray[np.bool_]:
    """Move points that touch the indenter, whose origin is at `origin_mm` (3,), onto its surface; return which do (…).

    Their `displacement_mm` (…, 3) from `rest_mm` (…, 2) on the plane is changed in place; it has to be contiguous.
    """
    depth_mm = max(min(indenter.origin_height_mm - origin_mm[2], indenter.deepest_mm), 0.0)
    reach_mm = indenter.penetration_radius_mm(depth_mm) + _MEMBRANE.bulge_mm
    half_width_mm = np.ptp(indenter.cut_mm(depth_mm), axis=1).min() / 2
    gap_mm = min(
        _MEMBRANE.touching_gap_mm, _MEMBRANE.touching_gap_share * half_width_mm**2 / indenter.feature_size_mm
    )
    rest, moved = rest_mm.reshape(-1, 2), displacement_mm.reshape(-1, 3)
    along_x, along_y = (np.abs(rest[:, k] + moved[:, k] - origin_mm[k]) for k in range(2))
    near = np.flatnonzero((along_x < reach_mm) & (along_y < reach_mm))
    from_origin = np.concatenate([rest[near], np.zeros((len(near), 1))], axis=1) - origin_mm
    nearest = indenter.project(from_origin + moved[near])
    touches = nearest.distance_mm < gap_mm
    moved[near[touches]] = (nearest.points_mm - from_origin)[touches]
    contact = np.zeros(len(rest), dtype=bool)
    contact[near[touches]] = True
    return contact.reshape(displacement_mm.shape[:-1])


@dataclass(frozen=True)
class PolarTable:
    """A field of the membrane tabulated over material radius and angle around the contact point.

    `values` is (n_r, n_angle, 3) for a displacement in mm, (n_r, n_angle, 1) for a scalar; angles run over the half
    circle if `symmetric`, else over the whole.
    """

    values: NDArray[np.float32]
    symmetric: bool

    def at(self, points_mm: Floats) -> Floats:
        """Return the field (…, channels) at points (…, 2) by linear interpolation; beyond the table its rim holds."""
        places_mm = points_mm.reshape(-1, 2)
        row = np.minimum(_row(np.hypot(*places_mm.T)), len(self.values) - 1 - 1e-6)
        found = _compiled()(self.values, self.symmetric, row, places_mm)
        return found.reshape(*points_mm.shape[:-1], -1)


def _interpolate(table: Any, symmetric: bool, row: Floats, places_mm: Floats) -> Floats:
    """Return what a table says (n, channels) in rows (n,), which need not be whole numbers, at places (n, 2)."""
    columns, channels = table.shape[1:]
    found = np.empty((len(row), channels))
    whole = math.pi if symmetric else 2 * math.pi
    for n in range(len(row)):
        angle = math.atan2(places_mm[n, 1], places_mm[n, 0])
        if angle < 0:
            angle = -angle if symmetric else angle + whole
        column = min(angle / whole * (columns - 1), columns - 1 - 1e-6)
        i, j = int(row[n]), int(column)
        outwards, onwards = row[n] - i, column - j
        for k in range(channels):
            inner = (1 - onwards) * table[i, j, k] + onwards * table[i, j + 1, k]
            outer = (1 - onwards) * table[i + 1, j, k] + onwards * table[i + 1, j + 1, k]
            found[n, k] = (1 - outwards) * inner + outwards * outer
        if symmetric and channels == 3:
            # A vector's component along y is mirrored as well.
            found[n, 1] *= np.sign(places_mm[n, 1])
    return found


@cache
def _compiled() -> Callable[[Any, bool, Floats, Floats], Floats]:
    """Compile the above where a table is read, and not in every program that imports states."""
    import numba

    return numba.njit(cache=True, error_model="numpy", fastmath=True)(_interpolate)


@dataclass(frozen=True)
class Cells:
    """How many cells lie between lines: `up_to_mm` are, for x and y, places and the number of cells up to each.

    Along a box's edges cells are longer than wide, and staggered: a cubic in mm gets ripples of 0.016 to 0.034 rms in
    the slope there, one in cells, which are all alike, of 0.006 to 0.012 (five boxes). Beyond the contact, `box_mm`
    (2, 2), blocks of cells become as long as wide, so that within `fades_mm` from it mm take over.
    """

    up_to_mm: tuple[tuple[Floats, Floats], ...]
    box_mm: Floats
    fades_mm: float

    def up_to(self, points_mm: Floats) -> Floats:
        """Return numbers of cells (…, 2) up to points (…, 2)."""
        counts = [np.interp(points_mm[..., axis], *scale) for axis, scale in enumerate(self.up_to_mm)]
        return np.stack(counts, axis=-1)

    def share(self, points_mm: Floats) -> Floats:
        """Return 1 in the contact at points (…, 2), less beside it, and 0 beyond (…)."""
        off_mm = np.maximum(self.box_mm[:, 0] - points_mm, points_mm - self.box_mm[:, 1]).max(axis=-1)
        left = np.clip(1 - off_mm / self.fades_mm, 0.0, 1.0)
        return left * left * (3 - 2 * left)


def cells_between(solution: Solution, record: Record) -> Cells:
    """Return the cells of a mesh between lines, as it lies under a record."""
    problem, rest_mm = solution.problem, solution.rest_of(record)
    way_mm = problem.segments[:, :, :2].reshape(-1, 2) + record.moved_mm
    way_mm = np.stack([way_mm.min(axis=0), way_mm.max(axis=0)], axis=-1)
    sizes = [sizes_along(problem, axis, problem.thickness_mm, tuple(way_mm[axis])) for axis in (0, 1)]
    reach_mm = np.abs(rest_mm).max(axis=0)
    return Cells(
        tuple(own.passed(-reach, reach) for own, reach in zip(sizes, reach_mm, strict=True)),
        problem.cut_mm + way_mm,
        _MEMBRANE.fading_cells * float(min(own.size_mm.min() for own in sizes)),
    )


@dataclass(frozen=True)
class MembraneCubic:
    """The membrane's displacement between a solution's vertices: a C¹ piecewise cubic, beyond them that of the rim.

    Of a body that is not round it is taken at each point of a grid. A table would round off such edges by up to 20 µm,
    as it did for a box of 5 × 7 mm, and takes twice as long to make.
    """

    rest_mm: Floats
    displacement_mm: Floats

    @cached_property
    def _cubic(self) -> Any:
        from scipy.interpolate import CloughTocher2DInterpolator

        return CloughTocher2DInterpolator(self.rest_mm, self.displacement_mm)

    @cached_property
    def _edges(self) -> Floats:
        """Edges (n, 3) of the hull of the vertices; those through the contact point are kept by the clip."""
        from scipy.spatial import ConvexHull

        edges = ConvexHull(self.rest_mm).equations
        return edges[edges[:, 2] < -_INSET_MM]

    def within(self, points_mm: Floats) -> Floats:
        """Move points (…, 2) beyond the vertices' hull to its rim."""
        low, high = self.rest_mm.min(axis=0) + _INSET_MM, self.rest_mm.max(axis=0) - _INSET_MM
        points = np.clip(points_mm, low, high)
        x, y = points[..., 0], points[..., 1]
        beyond = np.ones(x.shape)
        # A product of matrices, one for each row of points, has BLAS' threads wait for one another: 100 times as long.
        for along_x, along_y, offset in self._edges:
            np.maximum(beyond, (along_x * x + along_y * y) / (-0.999 * offset), out=beyond)
        return points / beyond[..., None]

    def at(self, points_mm: Floats) -> Floats:
        """Return the displacement (…, 3) at points (…, 2)."""
        return self._inside(self.within(points_mm))

    def _inside(self, points_mm: Floats) -> Floats:
        return self._cubic(points_mm)


@dataclass(frozen=True)
class CubicInCells(MembraneCubic):
    """The same, as a cubic in cells where the contact is."""

    cells: Cells

    @cached_property
    def _cubic_in_cells(self) -> Any:
        from scipy.interpolate import CloughTocher2DInterpolator

        return CloughTocher2DInterpolator(self.cells.up_to(self.rest_mm), self.displacement_mm)

    def _inside(self, points_mm: Floats) -> Floats:
        values = super()._inside(points_mm)
        share = self.cells.share(points_mm)
        near = share > 0
        in_cells = self._cubic_in_cells(self.cells.up_to(points_mm[near]))
        values[near] += share[near, None] * (in_cells - values[near])
        return values


def membrane_between(solution: Solution, record: Record) -> MembraneCubic | PolarTable:
    """Return the membrane between a record's vertices: a table, which is faster, under a round body."""
    if solution.problem.is_round:
        return polar_table(solution, record)
    rest, displacement, _ = solution.whole_surface(record)
    return CubicInCells(rest, displacement, cells_between(solution, record))


def polar_table(solution: Solution, record: Record) -> PolarTable:
    """Recover the membrane between the vertices by a C¹ piecewise cubic and tabulate it."""
    rest, displacement, _ = solution.whole_surface(record)
    values = MembraneCubic(rest, displacement).at(_polar_points(solution.problem, rest))
    return PolarTable(values.astype(np.float32), solution.problem.symmetric)


def pressure_table(solution: Solution, record: Record) -> PolarTable:
    """Tabulate the normal pressure in MPa: the vertices' forces over their shares of the deformed surface's area."""
    return _per_area(solution, record, np.maximum(record.normal_force_n, 0)[:, None])


def traction_table(solution: Solution, record: Record) -> PolarTable:
    """Tabulate the contact stress (3 components) in MPa in the same way."""
    return _per_area(solution, record, record.contact_force_n.astype(float))


def _per_area(solution: Solution, record: Record, force_n: Floats) -> PolarTable:
    """Tabulate forces (n, k) of the solution's vertices over their shares of the deformed area."""
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import Delaunay

    # Vertices in the plane of symmetry carry the force of one half, so that areas are those of this half as well.
    rest = solution.rest_of(record)
    triangulation = Delaunay(rest)
    position = np.concatenate([rest, np.zeros((len(rest), 1))], axis=1) + record.displacement_mm
    per_area = force_n / np.maximum(shares_mm2(position, triangulation.simplices), 1e-9)[:, None]
    points = MembraneCubic(rest, per_area).within(_polar_points(solution.problem, rest))
    values = LinearNDInterpolator(triangulation, per_area)(points)
    return PolarTable(values.astype(np.float32), solution.problem.symmetric)


def shares_mm2(places_mm: NDArray[np.floating], triangles: NDArray[np.integer]) -> Floats:
    """Return the share (n,) of the area of triangles (m, 3) that belongs to each of their corners (n, 3)."""
    first, second, third = (places_mm[triangles[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(second - first, third - first), axis=1) / 2
    return np.bincount(triangles.ravel(), np.repeat(area / 3, 3), len(places_mm)).astype(float)


def _polar_points(problem: ContactProblem, rest_mm: Floats) -> Floats:
    """Return where a table samples a membrane whose vertices (n, 2) are at rest there, (n_r, n_angle, 2)."""
    low, high = rest_mm.min(axis=0), rest_mm.max(axis=0)
    rim = float(np.hypot(*rest_mm.T).max())
    extent = rim if problem.pad_mm is None else np.hypot(*np.maximum(-low, high))
    radius = table_radius_mm(np.arange(float(np.ceil(_row(np.array(extent)))) + 1))
    half_circle = np.linspace(0, np.pi, _SECTORS + 1)
    turn = half_circle if problem.symmetric else np.linspace(0, 2 * np.pi, 2 * _SECTORS + 1)
    return np.stack([np.outer(radius, np.cos(turn)), np.outer(radius, np.sin(turn))], -1)


def _row(radius_mm: Floats) -> Floats:
    fine = np.minimum(radius_mm, _FINE_RADIUS_MM) / _FINE_SPACING_MM
    return fine + np.maximum(radius_mm - _FINE_RADIUS_MM, 0) / _COARSE_SPACING_MM


def table_radius_mm(row: Floats) -> Floats:
    """Return the radius at which a row of a polar table lies."""
    fine_rows = _FINE_RADIUS_MM / _FINE_SPACING_MM
    return np.minimum(row, fine_rows) * _FINE_SPACING_MM + np.maximum(row - fine_rows, 0) * _COARSE_SPACING_MM
