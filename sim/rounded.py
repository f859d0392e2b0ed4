"""Rounded convex bodies that can be turned and tilted: what the shapes are made of.

A shape is a signed distance with its gradient, and how far the body reaches in a direction. Most are the Minkowski sum
of a sharp convex core and a ball: the distance from the core less the ball's radius. All else, such as where the body
cuts the membrane and how curved it is there, follows from these two by one way for all.
"""

import math
from abc import abstractmethod
from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from gelgap.assets.settings import within
from gelgap.sim.indenter import Floats, Indenter, Projection, Symmetry, rotation

LARGEST_TILT_DEG = 15.0
# Where a body is cut is sampled in this many directions, each halved this many times.
_OUTLINE_DIRECTIONS = 96
_WIDTH_DIRECTIONS = 90
_OUTLINE_HALVINGS = 26
_STEPS_ALONG_PROFILE = 2000
_FAR_BELOW_MM = 1e4
_POINTS_AT_A_TIME = 500
# Fields that a rounding may be half of.
_SIZES = ("diameter_mm", "length_mm", "size_mm")

# Fields of a mesh that are not sizes.
UNLISTED = ("hull_mm", "above_mm", "flip")

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

    @model_validator(mode="after")
    def _check_rounding(self) -> Self:
        sizes = [np.min(getattr(self, name)) for name in _SIZES if hasattr(self, name)]
        for name in ("edge_radius_mm", "tip_radius_mm"):
            if sizes and getattr(self, name, 0.0) > min(sizes) / 2:
                text = f"must be at most {min(sizes) / 2:g} mm, half of the smallest size"
                raise ValueError(f"{name} = {getattr(self, name):g}: {text}")
        return self

    @property
    def _upright_symmetry(self) -> Symmetry:
        """The symmetry of the body that is not turned."""
        return Symmetry.MIRROR

    @property
    @abstractmethod
    def _height_mm(self) -> float:
        """How high the body is."""

    @property
    def _rounding_mm(self) -> float:
        """The smallest radius of curvature: of the edge, if the shape has no smaller one."""
        return float(getattr(self, "edge_radius_mm", 0.0))

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
        found = self._upright_symmetry
        if found is not Symmetry.REVOLUTION and self.yaw_deg % 180 == 90:
            exchanged = {Symmetry.MIRROR_X: Symmetry.MIRROR_Y, Symmetry.MIRROR_Y: Symmetry.MIRROR_X}
            found = exchanged.get(found, found)
        elif found is not Symmetry.REVOLUTION and self.yaw_deg % 180:
            return Symmetry.NONE
        x_deg, y_deg = self.tilt_deg
        if x_deg or y_deg:
            found &= Symmetry.MIRROR_Y if not x_deg else Symmetry.MIRROR_X if not y_deg else Symmetry.NONE
        return found

    @property
    def label(self) -> str:
        fields = ((name, value) for name, value in self if name not in UNLISTED and np.any(value))
        words = [
            f"{name.rpartition('_')[0].replace('_', ' ')} {_plain(value)}{'°' * name.endswith('_deg')}"
            for name, value in fields
        ]
        return ", ".join((self.shape, *sorted(words)))

    @property
    def yaw(self) -> float:
        return self.yaw_deg

    @property
    def lean_deg(self) -> float:
        return math.hypot(*self.tilt_deg)

    def yawed(self, yaw_deg: float) -> Self:
        """Return the body turned by so much more about the vertical axis, its tilt with it."""
        cosine, sine = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
        x, y = self.tilt_deg
        tilt = tuple(round(value, 9) + 0.0 for value in (cosine * x - sine * y, sine * x + cosine * y))
        turned = (self.yaw_deg + yaw_deg + 180.0) % 360.0 - 180.0
        return self.model_copy(update={"yaw_deg": round(turned, 9) + 0.0, "tilt_deg": tilt})

    def straightened(self) -> Self:
        upright = self.yawed(-self.yaw_deg)
        x_deg, y_deg = upright.tilt_deg
        turns_deg = (0.0, 90.0, math.degrees(math.atan2(x_deg, y_deg)))
        turned = (upright.yawed(turn) for turn in turns_deg)
        return next((body for body in turned if Symmetry.MIRROR_Y in body.symmetry), upright)

    def turned(self, turn_deg: Sequence[float]) -> Self:
        if not any(turn_deg):
            return self
        from scipy.spatial.transform import Rotation

        whole = Rotation.from_matrix(rotation(np.array(turn_deg)) @ self.axes)
        _, _, z, w = whole.as_quat()
        yaw_deg = math.degrees(2 * math.atan2(z, w))
        tilt = (whole * Rotation.from_euler("z", -yaw_deg, degrees=True)).as_rotvec(degrees=True)
        # How far a body of revolution is turned about its own axis does not show.
        yaw_deg = self.yaw_deg if self._upright_symmetry is Symmetry.REVOLUTION else round(yaw_deg, 9)
        tilt_deg = tuple(round(angle, 9) + 0.0 for angle in tilt[:2].tolist())
        return self.model_copy(update={"yaw_deg": yaw_deg, "tilt_deg": tilt_deg})

    @property
    def axes(self) -> Floats:
        """The rotation (3, 3) from the axes of the body as it is not turned to the sensor's."""
        return _rotation(self.yaw_deg, self.tilt_deg)

    @property
    def origin_height_mm(self) -> float:
        return float(self.reach_mm(np.array([[0.0, 0.0, -1.0]]))[0])

    def reach_mm(self, directions: Floats) -> Floats:
        return self._support_mm(directions @ self.axes)

    @property
    def feature_size_mm(self) -> float:
        return max(self._rounding_mm, 0.25 * self.penetration_radius_mm(0.25 * self.deepest_mm))

    @property
    def deepest_mm(self) -> float:
        return self._height_mm / 2

    @property
    def shallowest_mm(self) -> float:
        return float(np.ptp(self._face_mm @ self.axes[2])) if any(self.tilt_deg) else 0.0

    @property
    def mujoco_geom(self) -> str:
        ends = self._support_mm(np.concatenate([np.eye(3), -np.eye(3)]))
        centre, half = self.axes @ (ends[:3] - ends[3:]) / 2, (ends[:3] + ends[3:]) / 2
        texts = (_text(half), _text(centre), _text(self.axes[:, 0]), _text(self.axes[:, 1]))
        return 'type="box" size="{}" pos="{}" xyaxes="{} {}"'.format(*texts)

    def project(self, points_mm: Floats) -> Projection:
        turn, shape = self.axes, points_mm.shape
        distance_mm, normal = self._nearest(points_mm.reshape(-1, 3) @ turn)
        normal = (normal @ turn.T).reshape(shape)
        distance_mm = distance_mm.reshape(shape[:-1])
        return Projection(points_mm - distance_mm[..., None] * normal, normal, distance_mm)

    def _rim_mm(self, depth_mm: float) -> Floats:
        """Return points (n, 2) on the rim of where the body, at a depth, cuts the undeformed membrane."""
        return _outline_mm(self, depth_mm)

    def penetration_radius_mm(self, depth_mm: float) -> float:
        return float(np.hypot(*self._rim_mm(depth_mm).T).max())

    def cut_mm(self, depth_mm: float) -> Floats:
        rim_mm = self._rim_mm(depth_mm)
        return np.stack([rim_mm.min(axis=0), rim_mm.max(axis=0)], axis=1)

    def contact_radius_mm(self, depth_mm: float) -> float:
        outline = _outline_mm(self, depth_mm)
        angle = np.linspace(0, np.pi, _WIDTH_DIRECTIONS, endpoint=False)
        widths = np.ptp(outline @ np.stack([np.cos(angle), np.sin(angle)]), axis=0)
        return float(widths.min()) / 2

    def curvature(self, depth_mm: float, axis: int, step_mm: float) -> tuple[Floats, Floats]:
        """Follow the underside below a line through the middle of the cut: the turn of its normal over each step."""
        places_mm, turn_per_mm = _turns(self, depth_mm, axis, step_mm)
        return places_mm, 1 / np.maximum(turn_per_mm, 1e-9)

    def check(self, depth_mm: float) -> None:
        if np.abs(self.tilt_deg).max() > LARGEST_TILT_DEG + 1e-9:
            raise ValueError(
                f"roll_deg: tilts the {self.shape} by {np.abs(self.tilt_deg).max():.3g}° about x or y; "
                f"must be at most {LARGEST_TILT_DEG:g}°"
            )
        if self.shallowest_mm > depth_mm:
            raise ValueError(
                f"tilt_deg = {self.tilt_deg[0]:g} {self.tilt_deg[1]:g}: lifts the far side of the {self.shape} by "
                f"{self.shallowest_mm:.3g} mm, off the gel at a depth of {depth_mm:g} mm; tilt less or press deeper"
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
        off_axis = from_axis[:, None] > 1e-12
        # On the axis every direction is as near.
        outward = np.divide(
            points_mm[:, :2], from_axis[:, None], where=off_axis, out=np.full((len(from_axis), 2), [1.0, 0.0])
        )
        return distance_mm - self._rounding_mm, np.column_stack([normal[:, :1] * outward, normal[:, 1]])

    def _support_mm(self, directions: Floats) -> Floats:
        aside = np.hypot(directions[:, 0], directions[:, 1])
        return (np.stack([aside, directions[:, 2]], 1) @ self._core_mm.T).max(axis=1) + self._rounding_mm


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
    triangles, normals, offsets = facets
    heights = points_mm @ normals.T + offsets
    face = heights.argmax(axis=1)
    distance_mm, normal = heights[np.arange(len(face)), face], normals[face]
    outside = np.flatnonzero(distance_mm > 0)
    apart = from_triangles(points_mm[outside], triangles)
    length = np.linalg.norm(apart, axis=1)
    clear = length > 1e-9
    distance_mm[outside[clear]] = length[clear]
    normal[outside[clear]] = apart[clear] / length[clear, None]
    return distance_mm, normal


def from_triangles(points_mm: Floats, triangles_mm: Floats) -> Floats:
    """Return vectors (n, 3) to points (n, 3) from the nearest point of any of the triangles (m, 3, 3)."""
    from scipy.spatial.distance import cdist
    from trimesh.triangles import closest_point

    # No triangle is nearer than its centre less its size; one is as near as the nearest centre.
    centres = triangles_mm.mean(axis=1)
    to_centre = cdist(points_mm, centres)
    size_mm = np.linalg.norm(triangles_mm - centres[:, None], axis=2).max(axis=1)
    at, of = np.nonzero(to_centre - size_mm <= to_centre.min(axis=1, keepdims=True))
    apart = points_mm[at] - closest_point(triangles_mm[of], points_mm[at])
    order = np.lexsort([np.linalg.norm(apart, axis=1), at])
    return apart[order[np.unique(at[order], return_index=True)[1]]]


@lru_cache(maxsize=64)
def _rotation(yaw_deg: float, tilt_deg: tuple[float, float]) -> Floats:
    return rotation(np.array([*tilt_deg, 0.0])) @ rotation(np.array([0.0, 0.0, yaw_deg]))


@lru_cache(maxsize=256)
def _outline_mm(body: Shape, depth_mm: float) -> Floats:
    """Return points (n, 2) on the rim of where the body, at a depth, cuts the undeformed membrane, by bisection."""
    lowest_mm = body.origin_height_mm
    # From far below, the lowest point is nearest; that of a level face is in its middle.
    x, y, _ = body.project(np.array([0.0, 0.0, -_FAR_BELOW_MM])).points_mm
    angle = np.linspace(0, 2 * np.pi, _OUTLINE_DIRECTIONS, endpoint=False)
    direction = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    centre = np.array([x, y, depth_mm - lowest_mm])
    inside = np.zeros(len(angle))
    beyond = np.full(len(angle), 2 * float(body.reach_mm(direction).max()) + 1.0)
    for _ in range(_OUTLINE_HALVINGS):
        middle = (inside + beyond) / 2
        is_inside = body.project(centre + middle[:, None] * direction).distance_mm < 0
        inside, beyond = np.where(is_inside, middle, inside), np.where(is_inside, beyond, middle)
    return (centre + inside[:, None] * direction)[:, :2]


@lru_cache(maxsize=64)
def _turns(body: Shape, depth_mm: float, axis: int, step_mm: float) -> tuple[Floats, Floats]:
    """Return places (n,) along an axis and by how much the underside's normal turns there per mm of its length."""
    ends = body.cut_mm(depth_mm)
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


def _text(values: Floats) -> str:
    return " ".join(f"{value:.12g}" for value in values)


def _plain(value: Any) -> str:
    """Return a field's number or numbers, as `4 × 3`."""
    return " × ".join(f"{part:g}" for part in (value if isinstance(value, tuple) else (value,)))
