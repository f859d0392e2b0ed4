"""Indenters beside the sphere: rounded bodies of revolution, boxes, ellipsoids and convex meshes, turned and tilted.

A shape is a signed distance with its gradient, and how far the body reaches in a direction. Most are the Minkowski sum
of a sharp convex core and a ball: the distance from the core less the ball's radius. All else, such as where the body
cuts the membrane and how curved it is there, follows from these two by one way for all.
"""

import math
from abc import abstractmethod
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from gelgap.assets import list_presets, load_preset
from gelgap.assets.names import unknown_name
from gelgap.assets.settings import within
from gelgap.assets.toml_file import named_in_errors, read_toml
from gelgap.sim.indenter import Floats, Indenter, Projection, Sphere, Symmetry

LARGEST_TILT_DEG = 15.0
MOST_HULL_POINTS = 4000
# Where a body is cut is sampled in this many directions, each halved this many times.
_OUTLINE_DIRECTIONS = 96
_OUTLINE_HALVINGS = 26
_STEPS_ALONG_PROFILE = 2000
_FAR_BELOW_MM = 1e4
_POINTS_AT_A_TIME = 500
# Bodies whose height no field says are as high as they are wide, and at least this high.
_SMALLEST_HEIGHT_MM = 10.0
# A tilt is taken for none below this.
_SMALLEST_TILT_DEG = 1e-9
# A mesh is convex if its volume is this share of its hull's.
_CONVEX_VOLUME_SHARE = 0.995

Size = Annotated[float, within(0.5, 50.0, "mm")]
Rounding = Annotated[float, within(0.01, 25.0, "mm")]
Angle = Annotated[float, within(-180.0, 180.0, "°")]
Tilt = Annotated[float, within(-LARGEST_TILT_DEG, LARGEST_TILT_DEG, "°")]


class Shape(Indenter):
    """A body that can be turned and tilted; its origin is the lowest point of its axis as it stands upright.

    It is turned by `yaw_deg` about its axis, and then tilted: by the length of the vector `tilt_deg`, about it.
    """

    yaw_deg: Angle = Field(default=0.0, description="Turn about the vertical axis, degrees, −180 to 180.")
    tilt_deg: tuple[Tilt, Tilt] = Field(
        default=(0.0, 0.0), description="Tilt about x and about y, degrees, −15 to 15 each."
    )

    @property
    @abstractmethod
    def _upright_symmetry(self) -> Symmetry:
        """The symmetry of the body that is not turned."""

    @property
    @abstractmethod
    def _height_mm(self) -> float:
        """How high the body is."""

    @property
    @abstractmethod
    def _rounding_mm(self) -> float:
        """The smallest radius of curvature."""

    @abstractmethod
    def _nearest(self, points_mm: Floats) -> tuple[Floats, Floats]:
        """Return signed distance (n,) and its gradient (n, 3) at points (n, 3), of the body that is not turned."""

    @abstractmethod
    def _support_mm(self, directions: Floats) -> Floats:
        """Return how far (n,) the body that is not turned reaches from its origin in directions (n, 3)."""

    @property
    def _face_mm(self) -> Floats:
        """Corners (n, 3) of the flat part of what touches the gel first, if there is one."""
        return np.zeros((1, 3))

    @property
    def symmetry(self) -> Symmetry:
        upright = self._upright_symmetry
        if any(self.tilt_deg):
            return Symmetry.NONE
        straight = self.yaw_deg % 90 == 0
        return upright if upright is not Symmetry.MIRROR or straight else Symmetry.NONE

    @property
    def label(self) -> str:
        turned = f", yaw {self.yaw_deg:g}°" if self.yaw_deg else ""
        tilted = f", tilt {self.tilt_deg[0]:g}° {self.tilt_deg[1]:g}°" if any(self.tilt_deg) else ""
        return f"{self.shape} {self._sizes}{turned}{tilted}"

    @property
    @abstractmethod
    def _sizes(self) -> str:
        """The sizes, for lists."""

    @property
    def yaw(self) -> float:
        return self.yaw_deg

    def yawed(self, yaw_deg: float) -> Self:
        """Return the body turned by so much more about the vertical axis, its tilt with it."""
        cosine, sine = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
        x, y = self.tilt_deg
        tilt = tuple(round(value, 9) + 0.0 for value in (cosine * x - sine * y, sine * x + cosine * y))
        turned = (self.yaw_deg + yaw_deg + 180.0) % 360.0 - 180.0
        return self.model_copy(update={"yaw_deg": round(turned, 9) + 0.0, "tilt_deg": tilt})

    @property
    def _turn(self) -> Floats:
        """The rotation (3, 3) from the upright body's axes to the sensor's."""
        return _rotation(self.yaw_deg, self.tilt_deg)

    @property
    def origin_height_mm(self) -> float:
        return float(self.reach_mm(np.array([[0.0, 0.0, -1.0]]))[0])

    def reach_mm(self, directions: Floats) -> Floats:
        """Return how far (n,) the body reaches from its origin in directions (n, 3)."""
        return self._support_mm(directions @ self._turn)

    @property
    def feature_size_mm(self) -> float:
        return max(self._rounding_mm, 0.25 * self.penetration_radius_mm(0.25 * self.deepest_mm))

    @property
    def deepest_mm(self) -> float:
        return self._height_mm / 2

    @property
    def mujoco_geom(self) -> str:
        ends = self._support_mm(np.concatenate([np.eye(3), -np.eye(3)]))
        centre, half = self._turn @ (ends[:3] - ends[3:]) / 2, (ends[:3] + ends[3:]) / 2
        texts = (_text(half), _text(centre), _text(self._turn[:, 0]), _text(self._turn[:, 1]))
        return 'type="box" size="{}" pos="{}" xyaxes="{} {}"'.format(*texts)

    def project(self, points_mm: Floats) -> Projection:
        turn, shape = self._turn, points_mm.shape
        distance_mm, normal = self._nearest(points_mm.reshape(-1, 3) @ turn)
        normal = (normal @ turn.T).reshape(shape)
        distance_mm = distance_mm.reshape(shape[:-1])
        return Projection(points_mm - distance_mm[..., None] * normal, normal, distance_mm)

    def penetration_radius_mm(self, depth_mm: float) -> float:
        return float(np.hypot(*_outline_mm(self, depth_mm).T).max())

    def cut_mm(self, depth_mm: float) -> tuple[float, float, float, float]:
        outline = _outline_mm(self, depth_mm)
        (x_min, y_min), (x_max, y_max) = outline.min(axis=0).tolist(), outline.max(axis=0).tolist()
        return x_min, x_max, y_min, y_max

    def curvature(self, depth_mm: float, axis: int, step_mm: float) -> tuple[Floats, Floats]:
        """Follow the underside below a line through the middle of the cut: the turn of its normal over each step."""
        places_mm, turn_per_mm = _turns(self, depth_mm, axis, step_mm)
        return places_mm, 1 / np.maximum(turn_per_mm, 1e-9)

    def check(self, depth_mm: float) -> None:
        lifted_mm = float((self._face_mm @ self._turn[2]).max()) - float(
            (self._face_mm @ self._turn[2]).min()
        )
        if any(self.tilt_deg) and lifted_mm > depth_mm:
            raise ValueError(
                f"tilt_deg = {self.tilt_deg[0]:g} {self.tilt_deg[1]:g}: lifts the far side of the {self.shape} by "
                f"{lifted_mm:.3g} mm, off the gel at a depth of {depth_mm:g} mm; tilt less or press deeper"
            )


class RoundedProfile(Shape):
    """A convex polygon in the plane of the distance from an axis and the height along it, rounded, turned about it."""

    @property
    @abstractmethod
    def _core_mm(self) -> Floats:
        """Corners (n, 2) of the polygon, without the rounding, counterclockwise from the axis."""

    @property
    def _upright_symmetry(self) -> Symmetry:
        return Symmetry.REVOLUTION

    def _nearest(self, points_mm: Floats) -> tuple[Floats, Floats]:
        from_axis = np.hypot(points_mm[:, 0], points_mm[:, 1])
        distance_mm, normal = _onto_polygon(np.stack([from_axis, points_mm[:, 2]], 1), self._core_mm)
        outward = points_mm[:, :2] / np.maximum(from_axis, 1e-12)[:, None]
        return distance_mm - self._rounding_mm, np.column_stack([normal[:, :1] * outward, normal[:, 1]])

    def _support_mm(self, directions: Floats) -> Floats:
        aside = np.hypot(directions[:, 0], directions[:, 1])
        return (np.stack([aside, directions[:, 2]], 1) @ self._core_mm.T).max(axis=1) + self._rounding_mm


class Cylinder(RoundedProfile):
    """A flat-ended cylinder that stands on the gel; the edge of its face is rounded."""

    shape: ClassVar[str] = "cylinder"

    diameter_mm: Size = Field(default=3.0, description="Diameter, mm, 0.5 to 50.")
    edge_radius_mm: Rounding = Field(
        default=0.2, description="Radius of the face's edge, mm, 0.01 to half the diameter."
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        return _checked(self, "edge_radius_mm", self.edge_radius_mm, self.diameter_mm / 2)

    @property
    def _sizes(self) -> str:
        return f"{self.diameter_mm:g} mm, edge {self.edge_radius_mm:g} mm"

    @property
    def _height_mm(self) -> float:
        return max(self.diameter_mm, _SMALLEST_HEIGHT_MM)

    @property
    def _rounding_mm(self) -> float:
        return self.edge_radius_mm

    @property
    def _core_mm(self) -> Floats:
        f, r, top = self.edge_radius_mm, self.diameter_mm / 2 - self.edge_radius_mm, self._height_mm
        return np.array([[0.0, f], [r, f], [r, top - f], [0.0, top - f]])

    @property
    def _face_mm(self) -> Floats:
        angle, r = np.linspace(0, 2 * np.pi, 33), self.diameter_mm / 2 - self.edge_radius_mm
        return np.stack([r * np.cos(angle), r * np.sin(angle), 0 * angle], 1)


class Cone(RoundedProfile):
    """A cone that stands on its rounded tip."""

    shape: ClassVar[str] = "cone"

    diameter_mm: Size = Field(default=6.0, description="Diameter where it is widest, mm, 0.5 to 50.")
    half_angle_deg: Annotated[float, within(20.0, 85.0, "°")] = Field(
        default=60.0, description="Angle between axis and flank, degrees, 20 to 85."
    )
    tip_radius_mm: Rounding = Field(
        default=0.3, description="Radius of the tip, mm, 0.01 to half the diameter."
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        return _checked(self, "tip_radius_mm", self.tip_radius_mm, self.diameter_mm / 2)

    @property
    def _sizes(self) -> str:
        return f"{self.diameter_mm:g} mm, {self.half_angle_deg:g}°, tip {self.tip_radius_mm:g} mm"

    @property
    def _flank_mm(self) -> float:
        """Height of the flank, without the rounding."""
        return (self.diameter_mm / 2 - self.tip_radius_mm) / math.tan(math.radians(self.half_angle_deg))

    @property
    def _height_mm(self) -> float:
        return max(2 * (self._flank_mm + self.tip_radius_mm), _SMALLEST_HEIGHT_MM)

    @property
    def deepest_mm(self) -> float:
        return self._flank_mm + self.tip_radius_mm

    @property
    def _rounding_mm(self) -> float:
        return self.tip_radius_mm

    @property
    def _core_mm(self) -> Floats:
        t, r = self.tip_radius_mm, self.diameter_mm / 2 - self.tip_radius_mm
        top = self._height_mm - t
        return np.array([[0.0, t], [r, t + self._flank_mm], [r, top], [0.0, top]])


class Edge(RoundedProfile):
    """A cylinder that lies on the gel, along x as long as it is not turned; the edges of its ends are rounded."""

    shape: ClassVar[str] = "edge"

    diameter_mm: Size = Field(default=3.0, description="Diameter, mm, 0.5 to 50.")
    length_mm: Size = Field(default=6.0, description="Length, mm, 0.5 to 50.")
    edge_radius_mm: Rounding = Field(
        default=0.3, description="Radius of the ends' edges, mm, 0.01 to half of diameter and length."
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        largest = min(self.diameter_mm, self.length_mm) / 2
        return _checked(self, "edge_radius_mm", self.edge_radius_mm, largest)

    @property
    def _upright_symmetry(self) -> Symmetry:
        return Symmetry.MIRROR

    @property
    def _sizes(self) -> str:
        return f"{self.diameter_mm:g} × {self.length_mm:g} mm, ends {self.edge_radius_mm:g} mm"

    @property
    def _height_mm(self) -> float:
        return self.diameter_mm

    @property
    def _rounding_mm(self) -> float:
        return self.edge_radius_mm

    @property
    def _core_mm(self) -> Floats:
        r, end = self.diameter_mm / 2 - self.edge_radius_mm, self.length_mm / 2 - self.edge_radius_mm
        return np.array([[0.0, -end], [r, -end], [r, end], [0.0, end]])

    @property
    def _face_mm(self) -> Floats:
        end = self.length_mm / 2 - self.edge_radius_mm
        return np.array([[-end, 0.0, 0.0], [end, 0.0, 0.0]])

    def _nearest(self, points_mm: Floats) -> tuple[Floats, Floats]:
        """Have the axis lie along x, a radius above the gel."""
        from_axis = points_mm - [0.0, 0.0, self.diameter_mm / 2]
        distance_mm, normal = super()._nearest(from_axis[:, [1, 2, 0]])
        return distance_mm, normal[:, [2, 0, 1]]

    def _support_mm(self, directions: Floats) -> Floats:
        return super()._support_mm(directions[:, [1, 2, 0]]) + self.diameter_mm / 2 * directions[:, 2]


class Ellipsoid(Shape):
    """An ellipsoid whose axes are x, y and z as long as it is not turned."""

    shape: ClassVar[str] = "ellipsoid"

    diameters_mm: tuple[Size, Size, Size] = Field(
        default=(4.0, 3.0, 3.0), description="Diameters along x, y and z, mm, 0.5 to 50 each."
    )

    @property
    def _half_mm(self) -> Floats:
        return np.array(self.diameters_mm) / 2

    @property
    def _upright_symmetry(self) -> Symmetry:
        x, y, _ = self.diameters_mm
        return Symmetry.REVOLUTION if x == y else Symmetry.MIRROR

    @property
    def _sizes(self) -> str:
        return " × ".join(f"{size:g}" for size in self.diameters_mm) + " mm"

    @property
    def _height_mm(self) -> float:
        return self.diameters_mm[2]

    @property
    def _rounding_mm(self) -> float:
        half = self._half_mm
        return float(half.min() ** 2 / half.max())

    def _nearest(self, points_mm: Floats) -> tuple[Floats, Floats]:
        """Newton's method on Eberly's equation, Σ (a p / (t + a²))² = 1, from its left, where it is convex."""
        square = self._half_mm**2
        point = points_mm - [0.0, 0.0, self._half_mm[2]]
        scaled = self._half_mm * np.maximum(np.abs(point), 1e-9)
        t = (scaled - square).max(axis=1)
        for _ in range(60):
            term = (scaled / (t[:, None] + square)) ** 2
            step = (term.sum(axis=1) - 1) / (2 * (term / (t[:, None] + square)).sum(axis=1))
            t = t + step
            if np.abs(step).max(initial=0.0) < 1e-13:
                break
        nearest = square * point / (t[:, None] + square)
        normal = nearest / square
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return ((point - nearest) * normal).sum(axis=1), normal

    def _support_mm(self, directions: Floats) -> Floats:
        return np.linalg.norm(directions * self._half_mm, axis=1) + self._half_mm[2] * directions[:, 2]


class RoundedHull(Shape):
    """The convex hull of points, rounded."""

    @property
    @abstractmethod
    def _corners_mm(self) -> Floats:
        """The points (n, 3)."""

    def _nearest(self, points_mm: Floats) -> tuple[Floats, Floats]:
        parts = np.array_split(points_mm, 1 + len(points_mm) // _POINTS_AT_A_TIME)
        distance_mm, normal = zip(*(_onto_hull(part, _facets(self)) for part in parts), strict=True)
        return np.concatenate(distance_mm) - self._rounding_mm, np.concatenate(normal)

    def _support_mm(self, directions: Floats) -> Floats:
        return (directions @ self._corners_mm.T).max(axis=1) + self._rounding_mm

    @property
    def _face_mm(self) -> Floats:
        corners = self._corners_mm
        return corners[corners[:, 2] < corners[:, 2].min() + 1e-6]


class Box(RoundedHull):
    """A box that stands on the gel; all of its edges are rounded."""

    shape: ClassVar[str] = "box"

    size_mm: tuple[Size, Size] = Field(
        default=(4.0, 3.0), description="Size along x and y, mm, 0.5 to 50 each."
    )
    edge_radius_mm: Rounding = Field(
        default=0.3, description="Radius of the edges, mm, 0.01 to half the size."
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        return _checked(self, "edge_radius_mm", self.edge_radius_mm, min(self.size_mm) / 2)

    @property
    def _upright_symmetry(self) -> Symmetry:
        return Symmetry.MIRROR

    @property
    def _sizes(self) -> str:
        return f"{self.size_mm[0]:g} × {self.size_mm[1]:g} mm, edges {self.edge_radius_mm:g} mm"

    @property
    def _height_mm(self) -> float:
        return max(*self.size_mm, _SMALLEST_HEIGHT_MM)

    @property
    def _rounding_mm(self) -> float:
        return self.edge_radius_mm

    @property
    def _corners_mm(self) -> Floats:
        f, (x, y) = self.edge_radius_mm, self.size_mm
        # A core without width has no facets.
        half = np.maximum([x / 2 - f, y / 2 - f], 1e-6)
        ends = [(-half[0], half[0]), (-half[1], half[1]), (f, self._height_mm - f)]
        return np.array(np.meshgrid(*ends)).reshape(3, -1).T


class ConvexMesh(RoundedHull):
    """A convex body of any shape, by its corners, which stands on the gel as it is in its file."""

    shape: ClassVar[str] = "mesh"

    hull_mm: tuple[tuple[float, float, float], ...] = Field(
        description="Corners of the convex hull, mm; the lowest is moved to z = 0."
    )
    edge_radius_mm: Annotated[float, within(0.0, 25.0, "mm")] = Field(
        default=0.0, description="Radius of the ball that rolls around the hull and rounds it, mm, 0 to 25."
    )

    @classmethod
    def load(cls, path: str | Path, **fields: Any) -> Self:
        """Read a mesh file (STL, PLY, OBJ, …) in mm, centred over its lowest point's face.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is no mesh, or one that is open or not convex, or has too many corners.
        """
        import trimesh

        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"mesh {path} does not exist")
        try:
            mesh = trimesh.load_mesh(path)
            mesh.merge_vertices()
            watertight, volume, hull = mesh.is_watertight, abs(mesh.volume), mesh.convex_hull
        except Exception as error:  # readers of other people's formats raise whatever they like
            raise ValueError(f"indenter = {str(path)!r}: is not a mesh that can be read ({error})") from None
        if not watertight:
            raise ValueError(f"indenter = {str(path)!r}: the mesh is open; close it")
        if volume < _CONVEX_VOLUME_SHARE * hull.volume:
            share = 100 * volume / hull.volume
            raise ValueError(
                f"indenter = {str(path)!r}: must be convex; it fills {share:.1f} % of its convex hull"
            )
        corners = np.array(hull.vertices)
        if len(corners) > MOST_HULL_POINTS:
            raise ValueError(f"indenter = {str(path)!r}: has {len(corners)} corners, of {MOST_HULL_POINTS}")
        lowest = corners[corners[:, 2] < corners[:, 2].min() + 1e-6]
        corners -= [*lowest[:, :2].mean(axis=0), corners[:, 2].min()]
        return cls(hull_mm=tuple(map(tuple, np.round(corners, 6).tolist())), **fields)

    @property
    def _upright_symmetry(self) -> Symmetry:
        return Symmetry.NONE

    @property
    def _sizes(self) -> str:
        return (
            f"{len(self.hull_mm)} corners, "
            + " × ".join(f"{size:.3g}" for size in np.ptp(self._corners_mm, axis=0) + 2 * self.edge_radius_mm)
            + " mm"
        )

    @property
    def _height_mm(self) -> float:
        return float(np.ptp(self._corners_mm[:, 2])) + 2 * self.edge_radius_mm

    @property
    def _rounding_mm(self) -> float:
        return self.edge_radius_mm

    @property
    def _corners_mm(self) -> Floats:
        return _hull_mm(self.hull_mm) + np.array([0.0, 0.0, self.edge_radius_mm])


AnyIndenter = Sphere | Cylinder | Cone | Edge | Box | Ellipsoid | ConvexMesh
"""Type of a field that holds any shape; pydantic tells shapes apart by the names of their fields."""
SHAPES: dict[str, type[Indenter]] = {
    shape.shape: shape for shape in (Sphere, Cylinder, Cone, Edge, Box, Ellipsoid)
}


def load_indenter(name: str, **fields: Any) -> AnyIndenter:
    """Return the indenter of a shape's name, a preset, a TOML file or a mesh file, with some fields given anew.

    A TOML file has `shape`, or `mesh` as a path beside it, and the shape's fields.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If there is no such shape or preset, it has no such field, a value is out of range, or a mesh is not served.
    """
    if name in SHAPES:
        return _made(SHAPES[name], fields)
    if name.endswith(".toml"):
        with named_in_errors(name):
            return _from_table(read_toml(name), Path(name).parent, fields)
    if "." in name:
        return _made(ConvexMesh, fields, Path(name))
    known = (*SHAPES, *list_presets("indenters"))
    if name not in known:
        hint = "known ones, or name a .toml or a mesh file"
        raise ValueError(unknown_name("indenter", name, known, hint))
    return _from_table(load_preset("indenters", name), Path(), fields)


def _from_table(values: dict[str, Any], folder: Path, fields: dict[str, Any]) -> AnyIndenter:
    values.pop("description", None)
    mesh, shape = values.pop("mesh", None), values.pop("shape", None)
    if mesh is not None and shape is None:
        return _made(ConvexMesh, values | fields, folder / str(mesh))
    if shape not in SHAPES:
        raise ValueError(unknown_name("shape", str(shape), tuple(SHAPES), "known shapes"))
    return _made(SHAPES[shape], values | fields)


def _made(shape: type[Any], fields: dict[str, Any], mesh: Path | None = None) -> Any:
    for name in fields:
        if name not in shape.model_fields:
            known = ", ".join(field for field in shape.model_fields if field != "hull_mm")
            raise ValueError(f"{name}: a {shape.shape} has none; it has {known}")
    return shape(**fields) if mesh is None else shape.load(mesh, **fields)


class _Facets(NamedTuple):
    """Triangles (n, 3, 3) of a hull, and the planes normal · x + offset = 0 that they lie in."""

    triangles_mm: Floats
    normals: Floats
    offsets_mm: Floats


@lru_cache(maxsize=8)
def _facets(body: RoundedHull) -> _Facets:
    from scipy.spatial import ConvexHull

    corners = body._corners_mm
    hull = ConvexHull(corners)
    return _Facets(corners[hull.simplices], hull.equations[:, :3], hull.equations[:, 3])


def _onto_hull(points_mm: Floats, facets: _Facets) -> tuple[Floats, Floats]:
    """Return signed distance (n,) and gradient (n, 3) at points (n, 3) of a convex hull."""
    from scipy.spatial.distance import cdist
    from trimesh.triangles import closest_point

    triangles, normals, offsets = facets
    heights = points_mm @ normals.T + offsets
    face = heights.argmax(axis=1)
    distance_mm, normal = heights[np.arange(len(face)), face], normals[face]
    outside = np.flatnonzero(distance_mm > 0)
    # No triangle is nearer than its centre less its size; one is as near as the nearest centre.
    to_centre = cdist(points_mm[outside], triangles.mean(axis=1))
    size_mm = np.linalg.norm(triangles - triangles.mean(axis=1, keepdims=True), axis=2).max(axis=1)
    pairs = np.argwhere(to_centre - size_mm <= to_centre.min(axis=1, keepdims=True))
    at, of = outside[pairs[:, 0]], pairs[:, 1]
    apart = points_mm[at] - closest_point(triangles[of], points_mm[at])
    length = np.linalg.norm(apart, axis=1)
    order = np.lexsort([length, at])
    first = order[np.unique(at[order], return_index=True)[1]]
    clear = first[length[first] > 1e-9]
    distance_mm[at[clear]] = length[clear]
    normal[at[clear]] = apart[clear] / length[clear, None]
    return distance_mm, normal


@lru_cache(maxsize=8)
def _hull_mm(points: tuple[tuple[float, float, float], ...]) -> Floats:
    return np.array(points)


@lru_cache(maxsize=64)
def _rotation(yaw_deg: float, tilt_deg: tuple[float, float]) -> Floats:
    from scipy.spatial.transform import Rotation

    yaw = Rotation.from_euler("z", yaw_deg, degrees=True)
    return (Rotation.from_rotvec([*tilt_deg, 0.0], degrees=True) * yaw).as_matrix()


@lru_cache(maxsize=256)
def _outline_mm(body: Shape, depth_mm: float) -> Floats:
    """Return points (n, 2) on the rim of where the body, at a depth, cuts the undeformed membrane, by bisection."""
    lowest_mm = body.origin_height_mm
    # From far below, the lowest point is nearest; that of a level face is in its middle.
    x, y, _ = body.project(np.array([0.0, 0.0, -_FAR_BELOW_MM])).points_mm
    angle = np.linspace(0, 2 * np.pi, _OUTLINE_DIRECTIONS, endpoint=False)
    direction = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    centre = np.array([x, y, depth_mm - lowest_mm])
    inside, beyond = (
        np.zeros(len(angle)),
        np.full(len(angle), 2 * float(body.reach_mm(direction).max()) + 1.0),
    )
    for _ in range(_OUTLINE_HALVINGS):
        middle = (inside + beyond) / 2
        is_inside = body.project(centre + middle[:, None] * direction).distance_mm < 0
        inside, beyond = np.where(is_inside, middle, inside), np.where(is_inside, beyond, middle)
    return (centre + inside[:, None] * direction)[:, :2]


@lru_cache(maxsize=64)
def _turns(body: Shape, depth_mm: float, axis: int, step_mm: float) -> tuple[Floats, Floats]:
    """Return places (n,) along an axis and by how much the underside's normal turns there per mm of its length."""
    ends = np.reshape(body.cut_mm(depth_mm), (2, 2))
    reach_mm = np.ptp(ends[axis])
    below = np.zeros((_STEPS_ALONG_PROFILE, 3))
    below[:, :2] = ends.mean(axis=1)
    below[:, axis] += np.linspace(-2, 2, _STEPS_ALONG_PROFILE) * reach_mm
    below[:, 2] = -body.origin_height_mm - 1e-3
    found = body.project(below)
    point, normal = found.points_mm, found.outward_normal
    length = np.cumsum([0.0, *np.linalg.norm(np.diff(point, axis=0), axis=1)])
    turned = np.cumsum([0.0, *np.linalg.norm(np.diff(normal, axis=0), axis=1)])
    ahead, behind = (np.interp(length + side * step_mm / 2, length, turned) for side in (1, -1))
    reached = point[:, 2] <= depth_mm - body.origin_height_mm
    return point[reached, axis], (ahead - behind)[reached] / step_mm


def _onto_polygon(points_mm: Floats, corners_mm: Floats) -> tuple[Floats, Floats]:
    """Return signed distance (n,) and gradient (n, 2) at points (n, 2) of a convex open polygon (c, 2), inside left."""
    start, along = corners_mm[:-1], np.diff(corners_mm, axis=0)
    length = np.linalg.norm(along, axis=1)
    start, along, length = (part[length > 1e-9] for part in (start, along, length))
    normals = np.stack([along[:, 1], -along[:, 0]], 1) / length[:, None]
    from_start = points_mm[:, None] - start
    heights = (from_start * normals).sum(axis=-1)
    edge = heights.argmax(axis=1)
    distance_mm, normal = heights[np.arange(len(edge)), edge], normals[edge]
    share = np.clip((from_start * along).sum(axis=-1) / length**2, 0, 1)
    apart = from_start - share[..., None] * along
    nearest = (apart**2).sum(axis=-1).argmin(axis=1)
    apart = apart[np.arange(len(edge)), nearest]
    away = np.linalg.norm(apart, axis=1)
    clear = (distance_mm > 0) & (away > 1e-9)
    distance_mm[clear], normal[clear] = away[clear], apart[clear] / away[clear, None]
    return distance_mm, normal


def _checked(body: Any, field: str, value: float, largest: float) -> Any:
    if value > largest:
        raise ValueError(f"{field} = {value:g}: must be at most {largest:g} mm, half the {body.shape}'s size")
    return body


def _text(values: Floats) -> str:
    return " ".join(f"{value:.12g}" for value in values)
