"""Bodies by their surface: what of any body can be seen from below, as heights on a grid, and the distance from it.

Whatever the body is (a mesh, a height map, several bodies at once), the gel meets its underside; what that hides is as
if it was filled. The signed distance from the underside is worked out once, on a grid within a band around it, and
interpolated by quadratic B-splines, whose gradient is continuous, as Newton's method needs it.
"""

import base64
import logging
import math
import zlib
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gelgap.assets.image_file import read_levels
from gelgap.assets.settings import within
from gelgap.assets.toml_file import named_in_errors
from gelgap.sim.indenter import Floats, Symmetry
from gelgap.sim.mesh_file import MeshUnit, lower_end
from gelgap.sim.rounded import Shape

LOG = logging.getLogger(__name__)
MAP_SUFFIXES = (".npy", ".png", ".tif", ".tiff")
# A grid has about this many places along its longer side at most, and none nearer to one another than that.
_MOST_PLACES = 240
_FINEST_MM = 0.04
_MOST_SIDE = 4096
_DEEPEST_MM = 6.0
# Distances are exact so far outside and inside of the surface. What is further above the deepest press is not kept.
_OUTSIDE_MM, _INSIDE_MM = 0.3, 0.3
_KEPT_ABOVE_MM = 0.6
_NOTHING = 65535
# Heights that differ by less are all the same.
_LEAST_RELIEF_MM = 5e-3
# A surface is its own image if no larger share of its places differs by more than that.
_SAME_SHARE, _SAME_MM = 0.01, 5e-3
_STEEP_SHARE = 0.5
_TURNS_DEG = (37.0, 90.0)
# Curvature is sampled in about _CURVED_PLACES places, and summarised in _CURVED_STEPS intervals along an axis.
_CURVED_PLACES, _CURVED_STEPS = 8000, 200
# Over fewer places than this the normal turns as the places do, not as the surface does.
_FINEST_STEP = 2.0
# Beyond a rim steeper than the first number the wall is put at the second one times the rim's last rise.
_STEEP_RIM, _RIM_GROWTH = 0.7, 2.5


class Surface(Shape):
    """A body of any shape by the heights of its underside, the lowest of which is 0.

    `heights` are whole numbers (rows, `columns`) of `step_mm`: 16 bits each, little-endian, compressed by zlib, base64;
    65535 stands for no body. Rows grow with y, columns with x, `spacing_mm` apart; the axis is in their middle.
    """

    shape: ClassVar[str] = "surface"
    convex: ClassVar[bool] = False

    heights: str = Field(repr=False, description="Heights of the underside, encoded.")
    columns: Annotated[int, within(3, _MOST_SIDE, "")] = Field(description="Places along x, 3 to 4096.")
    spacing_mm: Annotated[float, within(1e-3, 1.0, "mm")] = Field(
        description="From one place to the next, mm, 0.001 to 1."
    )
    step_mm: Annotated[float, within(1e-7, 0.1, "mm")] = Field(
        description="Height of a step, mm, 1e-7 to 0.1; of a map file to 1000 (m), negative if larger is further off."
    )
    height_mm: Annotated[float, within(0.01, 500.0, "mm")] = Field(
        description="Height of the body, mm, 0.01 to 500; it is pressed to half of that at most."
    )
    edge_radius_mm: Annotated[float, within(0.0, 25.0, "mm")] = Field(
        default=0.0, description="Radius of the ball that has rounded edges and creases, mm, 0 to 25."
    )
    flip: bool = Field(
        default=False,
        strict=True,
        description="Whether it is a mesh file's top that touches, and not its bottom, −z.",
        exclude_if=lambda value: not value,
    )

    @model_validator(mode="after")
    def _check_heights(self) -> Self:
        _decoded_mm(self.heights, self.columns, self.step_mm)
        return self

    @classmethod
    def of(
        cls, heights_mm: Floats, spacing_mm: float, *, height_mm: float | None = None, **fields: Any
    ) -> Self:
        """Return the body whose underside has heights (rows, columns) in mm, infinite where nothing is.

        Rows grow with y and columns with x, as in the sensor's picture; the axis is in their middle, and the lowest
        touches first. `height_mm` is the whole body's height, by default twice its relief: all of that can be pressed
        in. With `edge_radius_mm` a ball of this radius rounds edges and corners, and fills creases.

        Raises
        ------
        ValueError
            If heights hold NaN, are all equal, or are so narrow that rounding by `edge_radius_mm` leaves nothing.
        """
        from gelgap.sim.height_grid import rolled_mm

        heights = np.asarray(heights_mm, float)
        if heights.ndim != 2 or min(heights.shape) < 3 or max(heights.shape) > _MOST_SIDE:
            raise ValueError(f"heights are {heights.shape}: must be 3 to {_MOST_SIDE} rows and columns")
        if np.isnan(heights).any() or np.isneginf(heights).any():
            raise ValueError(
                "heights hold NaN or an infinity that reaches into the gel: fill in, or write the other one for nothing"
            )
        if not np.isfinite(heights).any():
            raise ValueError("is empty: nowhere is there anything to press")
        relief_mm = float(np.ptp(heights[np.isfinite(heights)]))
        if height_mm is None:
            if not _LEAST_RELIEF_MM <= relief_mm <= 250.0:
                raise ValueError(
                    f"heights differ by {relief_mm:.3g} mm, must by 0.005 to 250 mm: step_mm is what 1 is, 1000 if in m"
                )
            height_mm = 2 * relief_mm
        heights, spacing_mm = _resampled(heights, spacing_mm)
        radius_mm = fields.get("edge_radius_mm", 0.0)
        lowest_mm = heights.min()
        heights = rolled_mm(heights, radius_mm, spacing_mm)
        if not np.isfinite(heights).any():
            raise ValueError(
                f"edge_radius_mm = {radius_mm:g}: is more than half as wide as anything of the body; give a smaller one"
            )
        if heights.min() - lowest_mm > radius_mm:
            raise ValueError(
                f"edge_radius_mm = {radius_mm:g}: takes {heights.min() - lowest_mm:.2g} mm off what touches first, "
                "which is thinner than twice that; give a smaller one"
            )
        heights -= heights.min()
        kept_mm = min(height_mm / 2, _DEEPEST_MM) + _KEPT_ABOVE_MM
        step_mm = round(min(kept_mm, max(heights[heights <= kept_mm].max(), 1e-2)) / (_NOTHING - 1) + 5e-9, 8)
        return cls(
            heights=_encoded(np.where(heights <= kept_mm, heights, np.inf), step_mm),
            columns=heights.shape[1],
            spacing_mm=spacing_mm,
            step_mm=step_mm,
            height_mm=height_mm,
            **fields,
        )

    @classmethod
    def load(
        cls,
        path: str | Path,
        unit: MeshUnit | None = None,
        *,
        spacing_mm: float | None = None,
        step_mm: float | None = None,
        **fields: Any,
    ) -> Self:
        """Read a mesh file, or a height map: a grey PNG or TIFF of 8 or 16 bits, or a 2-D array as .npy.

        A height map's rows grow with the sensor's y and its columns with x; larger values reach further into the gel,
        or less far if `step_mm` is negative. Places are `spacing_mm` apart, values `step_mm`, by default 1 mm for .npy.
        Of a mesh that crosses itself, or has holes, the lowest of what is above each place is pressed.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it cannot be read, a map has no size, holds what is no number, or is empty.
        """
        path = Path(path)
        with named_in_errors(path):
            if path.suffix.lower() in MAP_SUFFIXES:
                values = _map_values(path)
                step_mm = 1.0 if step_mm is None and path.suffix.lower() == ".npy" else step_mm
                spacing_mm = _size_mm("spacing_mm", spacing_mm, 0, 1)
                step_mm = _size_mm("step_mm", step_mm, -1000, 1000)
                empty = values == 0
                if step_mm < 0 and empty.any() and values[~empty].min(initial=np.inf) > values.max() / 2:
                    said = "%s: %d places are 0 and touch first: if a depth camera saw nothing there, fill them in"
                    LOG.warning(said, path.name, empty.sum())
                return cls.of(-step_mm * values, spacing_mm, **fields)
            triangles_mm, height_mm = lower_end(
                path, unit, fields.get("flip", False), _DEEPEST_MM + _KEPT_ABOVE_MM
            )
            heights_mm, spacing_mm = grid_under(triangles_mm)
            return cls.of(heights_mm, spacing_mm, height_mm=height_mm, **fields)

    @property
    def label(self) -> str:
        x_mm, y_mm = (np.ptp(self._points_mm[:, axis]) for axis in (0, 1))
        relief_mm = self._points_mm[:, 2].max()
        edge = f", edge radius {self.edge_radius_mm:g}" if self.edge_radius_mm else ""
        turn = f", yaw {self.yaw_deg:g}°" if self.yaw_deg else ""
        tilt = ", tilt {:g} × {:g}°".format(*self.tilt_deg) if any(self.tilt_deg) else ""
        return f"surface of {x_mm:.3g} × {y_mm:.3g} mm, relief {relief_mm:.2g} mm{edge}{turn}{tilt}"

    @property
    def deepest_mm(self) -> float:
        return min(self.height_mm / 2, _DEEPEST_MM)

    @property
    def feature_size_mm(self) -> float:
        return max(self.edge_radius_mm, 0.25 * self.contact_radius_mm(0.25 * self.deepest_mm), 0.05)

    @property
    def mesh_mm(self) -> tuple[Floats, NDArray[np.int64]]:
        """Vertices (n, 3) and triangles (m, 3) of the underside, from the origin, turned as the body is."""
        grid = _grid_of(self.heights_mm, self.spacing_mm)
        index = np.arange(grid[..., 0].size).reshape(grid.shape[:2])
        a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
        triangles = np.concatenate([np.stack(some, -1).reshape(-1, 3) for some in ((a, d, b), (b, d, c))])
        points = grid.reshape(-1, 3)
        kept = np.isfinite(points[triangles, 2]).all(axis=1)
        used, triangles = np.unique(triangles[kept], return_inverse=True)
        return points[used] @ self.axes.T, triangles.reshape(-1, 3)

    def contact_radius_mm(self, depth_mm: float) -> float:
        return _cut(self, depth_mm).widest_mm

    def _rim_mm(self, depth_mm: float) -> Floats:
        return _cut(self, depth_mm).rim_mm

    def curvature(self, depth_mm: float, axis: int, step_mm: float) -> tuple[Floats, Floats]:
        """Return the smallest radius of what bulges, along an axis, in each of some places: creases are no edges."""
        return _curvature(self, depth_mm, axis, step_mm)

    @property
    def heights_mm(self) -> Floats:
        """Heights (rows, columns) of the underside as it is not turned, infinite where nothing is."""
        return _decoded_mm(self.heights, self.columns, self.step_mm)

    def with_heights(self, heights_mm: Floats) -> "Surface":
        """Return the body with other heights (rows, columns), none of them higher than its highest."""
        return self.model_copy(update={"heights": _encoded(heights_mm, self.step_mm)})

    @property
    def _points_mm(self) -> Floats:
        return _points_mm(self.heights, self.columns, self.spacing_mm, self.step_mm)

    @property
    def _upright_symmetry(self) -> Symmetry:
        return _symmetry(self.heights, self.columns, self.spacing_mm, self.step_mm)

    @property
    def _height_mm(self) -> float:
        return self.height_mm

    def _support_mm(self, directions: Floats) -> Floats:
        corners = _corners_mm(self.heights, self.columns, self.spacing_mm, self.step_mm)
        lifted = np.where(directions[:, 2] > 0, directions[:, 2], 0.0) * (
            self.height_mm - corners[:, 2].max()
        )
        return (directions @ corners.T).max(axis=1) + np.maximum(lifted, 0.0)

    def _nearest(self, points_mm: Floats) -> tuple[Floats, Floats]:
        from gelgap.sim.height_grid import interpolated

        # A press reaches a part of a high body only; its distances are worked out by the millimetre.
        reached_mm = min(float(max(1, math.ceil(points_mm[:, 2].max(initial=0.0)))), self.deepest_mm)
        band = _band(self.heights, self.columns, self.spacing_mm, self.step_mm, reached_mm)
        places = (points_mm[:, [1, 0, 2]] - band.corner_mm) / self.spacing_mm
        within = np.clip(places, 1.0, np.array(band.distance.shape) - 2.0)
        beyond_mm = (within - places) * self.spacing_mm
        # Above its top the body goes on as it is there.
        beyond_mm[:, 2] = np.maximum(beyond_mm[:, 2], 0.0)
        distance, gradient = interpolated(band.distance, within)
        normal = gradient[:, [1, 0, 2]]
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        # Where the band ends all directions are as good; the gel comes from below.
        normal = np.where(length > 1e-3, normal / np.maximum(length, 1e-3), [0.0, 0.0, -1.0])
        return distance * self.spacing_mm + np.linalg.norm(beyond_mm, axis=1), normal


def grid_under(triangles_mm: Floats) -> tuple[Floats, float]:
    """Return the lowest heights (rows, columns) of triangles (n, 3, 3) around the axis, and their spacing."""
    from gelgap.sim.height_grid import lower_side_mm

    half_mm = np.abs(triangles_mm[..., :2]).max(axis=(0, 1))
    spacing_mm = max(round(2 * half_mm.max() / _MOST_PLACES, 6), _FINEST_MM)
    return lower_side_mm(triangles_mm, (half_mm + spacing_mm).tolist(), spacing_mm), spacing_mm


def _size_mm(name: str, given: float | None, least: float, most: float) -> float:
    """Return a size of a height map, or raise ValueError if it is none."""
    if not isinstance(given, float | int) or not least <= given <= most or given == 0:
        allowed = f"{least} to {most} mm, not 0, as spacing_mm=0.05 step_mm=1e-5"
        raise ValueError(f"{name} = {given!r}: must be {allowed}")
    return given


class _Band(NamedTuple):
    """Signed distance (rows, columns, levels) in grid spacings, and where (y, x, z) its first place is."""

    distance: NDArray[np.float32]
    corner_mm: Floats


class _Cut(NamedTuple):
    """Where a body cuts the undeformed membrane: points (n, 2) of the rim, and the radius of the widest disc within."""

    rim_mm: Floats
    widest_mm: float


def _map_values(path: Path) -> Floats:
    if path.suffix.lower() != ".npy":
        return read_levels(path).astype(float)
    if not path.is_file():
        raise FileNotFoundError(f"height map {path} does not exist")
    try:
        with path.open("rb") as file:
            values = np.lib.format.read_array(file, allow_pickle=False)
    except (ValueError, OSError, EOFError):
        raise ValueError("is not a .npy file of numbers") from None
    if values.dtype.kind not in "iuf":
        raise ValueError(f"holds {values.dtype}: must be numbers")
    return values.astype(float)


def _resampled(heights: Floats, spacing_mm: float) -> tuple[Floats, float]:
    """Return heights on a grid as coarse as is needed, with an odd number of places along each side."""
    from scipy.ndimage import map_coordinates

    sides_mm = (np.array(heights.shape) - 1) * spacing_mm
    coarse_mm = max(sides_mm.max() / _MOST_PLACES, _FINEST_MM)
    if coarse_mm <= 1.01 * spacing_mm and all(side % 2 for side in heights.shape):
        return heights.copy(), spacing_mm
    coarse_mm = round(max(coarse_mm, spacing_mm), 6)
    half = np.floor(sides_mm / 2 / coarse_mm + 1e-6).astype(int)
    places = [
        (np.arange(-n, n + 1) * coarse_mm + side_mm / 2) / spacing_mm
        for n, side_mm in zip(half, sides_mm, strict=True)
    ]
    at = np.meshgrid(*places, indexing="ij")
    solid = np.isfinite(heights)
    filled = np.where(solid, heights, heights[solid].max())
    # Between something and nothing is what is nearer.
    inside = map_coordinates(solid.astype(float), at, order=1, mode="nearest") >= 0.5
    return np.where(inside, map_coordinates(filled, at, order=1, mode="nearest"), np.inf), coarse_mm


def _encoded(heights_mm: Floats, step_mm: float) -> str:
    codes = np.where(np.isfinite(heights_mm), np.round(np.minimum(heights_mm, 1e3) / step_mm), _NOTHING)
    return base64.b64encode(zlib.compress(codes.astype("<u2").tobytes(), 9)).decode()


@lru_cache(maxsize=16)
def _decoded_mm(heights: str, columns: int, step_mm: float) -> Floats:
    """Return heights (rows, columns) in mm, infinite where nothing is."""
    try:
        unpacker = zlib.decompressobj()
        data = unpacker.decompress(base64.b64decode(heights, validate=True), 2 * _MOST_SIDE**2)
        if unpacker.unconsumed_tail or not unpacker.eof:
            raise ValueError("more than allowed")
        codes = np.frombuffer(data, "<u2").reshape(-1, columns)
    except (ValueError, zlib.error):
        raise ValueError(
            f"heights: are not rows of {columns} 16-bit numbers, compressed, in base64"
        ) from None
    if len(codes) < 3 or codes.min() == _NOTHING:
        raise ValueError("heights: must be 3 rows at least, with something in them")
    return np.where(codes == _NOTHING, np.inf, codes * step_mm)


def _grid_of(heights_mm: Floats, spacing_mm: float) -> Floats:
    """Return the points (rows, columns, 3) of an underside, z infinite where nothing is."""
    y, x = ((np.arange(side) - (side - 1) / 2) * spacing_mm for side in heights_mm.shape)
    return np.stack([*np.meshgrid(x, y), heights_mm], axis=-1)


@lru_cache(maxsize=4)
def _points_mm(heights: str, columns: int, spacing_mm: float, step_mm: float) -> Floats:
    points = _grid_of(_decoded_mm(heights, columns, step_mm), spacing_mm).reshape(-1, 3)
    return points[np.isfinite(points[:, 2])]


@lru_cache(maxsize=4)
def _corners_mm(heights: str, columns: int, spacing_mm: float, step_mm: float) -> Floats:
    """Return the corners (n, 3) of the convex hull of an underside and its outline further up."""
    from scipy.spatial import ConvexHull

    points = _points_mm(heights, columns, spacing_mm, step_mm)
    lifted = points + np.array([0.0, 0.0, points[:, 2].max() + spacing_mm])
    points = np.concatenate([points, lifted])
    return points[ConvexHull(points).vertices]


@lru_cache(maxsize=16)
def _symmetry(heights: str, columns: int, spacing_mm: float, step_mm: float) -> Symmetry:
    from scipy.ndimage import map_coordinates

    own = _decoded_mm(heights, columns, step_mm)
    solid = np.isfinite(own)
    filled = np.where(solid, own, own[solid].max())
    # A place's distance from another surface is its height's share along the normal; walls lie between places.
    share = 1 / np.sqrt(1 + sum(part**2 for part in np.gradient(filled, spacing_mm)))
    share[share < _STEEP_SHARE] = 0.0
    found = Symmetry.NONE
    for image, mirror in ((own[:, ::-1], Symmetry.MIRROR_X), (own[::-1], Symmetry.MIRROR_Y)):
        if _is_same(own, image, share):
            found |= mirror
    if found is not Symmetry.MIRROR:
        return found
    y, x = np.meshgrid(*(np.arange(side) - (side - 1) / 2 for side in own.shape), indexing="ij")
    for turn in np.radians(_TURNS_DEG):
        at = [y * math.cos(turn) - x * math.sin(turn), x * math.cos(turn) + y * math.sin(turn)]
        at = [place + (side - 1) / 2 for place, side in zip(at, own.shape, strict=True)]
        turned = map_coordinates(filled, at, order=1, mode="nearest")
        there = map_coordinates(solid.astype(float), at, order=1, cval=0.0) >= 0.5
        if not _is_same(own, np.where(there, turned, np.inf), share):
            return found
    return Symmetry.REVOLUTION


def _is_same(own: Floats, image: Floats, share: Floats) -> bool:
    from scipy.ndimage import binary_erosion

    ours, theirs = np.isfinite(own), np.isfinite(image)
    # An outline lies anywhere between two places.
    apart = (binary_erosion(ours) & ~theirs) | (binary_erosion(theirs) & ~ours)
    both = ours & theirs
    apart[both] = np.abs(own[both] - image[both]) * share[both] > _SAME_MM
    return bool(apart.sum() <= _SAME_SHARE * np.isfinite(own).sum())


@lru_cache(maxsize=4)
def _band(heights: str, columns: int, spacing_mm: float, step_mm: float, reached_mm: float) -> _Band:
    from gelgap.sim.height_grid import signed_distance

    top_mm = reached_mm + _KEPT_ABOVE_MM
    margin = math.ceil(_OUTSIDE_MM / spacing_mm) + 2
    grid = np.pad(_decoded_mm(heights, columns, step_mm), margin, constant_values=np.inf)
    # What is higher than the grid is nothing; a wall leads up there.
    solid = np.minimum(_with_steep_rims(grid, spacing_mm), 10 * top_mm) / spacing_mm
    first = -margin
    levels = math.ceil(top_mm / spacing_mm) - first + 3
    distance = signed_distance(solid, first, levels, _OUTSIDE_MM / spacing_mm, _INSIDE_MM / spacing_mm)
    half_mm = (np.array(solid.shape) - 1) / 2 * spacing_mm
    return _Band(distance, np.array([*-half_mm, first * spacing_mm]))


def _with_steep_rims(heights_mm: Floats, spacing_mm: float) -> Floats:
    """Continue a rounding that ends between two places, so that its wall is not a sharp edge at the first of them."""
    found = heights_mm.copy()
    for axis, side in product((0, 1), (1, -1)):
        last, before = (np.roll(heights_mm, n * side, axis) for n in (1, 2))
        with np.errstate(invalid="ignore"):
            rise = last - before
            is_rim = np.isinf(heights_mm) & np.isfinite(rise) & (rise > _STEEP_RIM * spacing_mm)
            found[is_rim] = np.minimum(found, last + _RIM_GROWTH * rise)[is_rim]
    return found


@lru_cache(maxsize=256)
def _cut(body: Surface, depth_mm: float) -> _Cut:
    """Return where a body, at a depth, cuts the undeformed membrane: between places of its grid, or at its walls."""
    from scipy.spatial import cKDTree

    grid = _grid_of(np.pad(body.heights_mm, 1, constant_values=np.inf), body.spacing_mm)
    solid = np.isfinite(grid[..., 2])
    points = np.where(np.isfinite(grid), grid, 1e6) @ body.axes.T
    above_mm = np.where(solid, points[..., 2] - (depth_mm - body.origin_height_mm), 1e6)
    below = above_mm < 0
    if not below.any():
        lowest = points[np.unravel_index(above_mm.argmin(), above_mm.shape)][:2]
        return _Cut(lowest[None], 0.0)
    flat = np.where(solid[..., None], points, np.nan)
    rims = []
    for first, second in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        crosses = below[first] != below[second]
        a, b = above_mm[first][crosses], above_mm[second][crosses]
        share = (a / (a - b))[:, None]
        start, end = flat[first][crosses][:, :2], flat[second][crosses][:, :2]
        start, end = np.where(np.isnan(start), end, start), np.where(np.isnan(end), start, end)
        rims.append(start + share * (end - start))
    rim = np.concatenate(rims)
    inside = points[below][:, :2]
    return _Cut(rim, float(cKDTree(rim).query(inside[:: 1 + len(inside) // 20_000])[0].max()))


@lru_cache(maxsize=64)
def _curvature(body: Surface, depth_mm: float, axis: int, step_mm: float) -> tuple[Floats, Floats]:
    """Follow the normal half a step to either side of each place along the surface."""
    points = body._points_mm @ body.axes.T
    points = points[points[:, 2] < depth_mm - body.origin_height_mm]
    points = points[:: 1 + len(points) // _CURVED_PLACES]
    found = body.project(points)
    points, normal = found.points_mm, found.outward_normal
    step_mm = max(step_mm, _FINEST_STEP * body.spacing_mm)
    ahead = np.eye(3)[axis] - normal[:, axis : axis + 1] * normal
    length = np.linalg.norm(ahead, axis=1, keepdims=True)
    ahead /= np.maximum(length, 1e-3)
    there, back = (body.project(points + side * step_mm / 2 * ahead).outward_normal for side in (1, -1))
    turn = np.arctan2(((there - back) * ahead).sum(axis=1), 1 + (there * back).sum(axis=1))
    radius = step_mm / 2 / np.maximum(np.tan(np.clip(turn, 0.0, 1.5)), 1e-9)
    # Where it seems sharper than the ball that rolled in it, that is the grid.
    radius = np.maximum(radius, body.edge_radius_mm)
    edges = np.linspace(points[:, axis].min() - 1e-9, points[:, axis].max(), _CURVED_STEPS + 1)
    least = np.full(_CURVED_STEPS, np.inf)
    np.minimum.at(least, np.clip(np.searchsorted(edges, points[:, axis]) - 1, 0, _CURVED_STEPS - 1), radius)
    there_is = np.isfinite(least)
    return (edges[:-1] + edges[1:])[there_is] / 2, least[there_is]
