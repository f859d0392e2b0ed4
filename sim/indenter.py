"""What a rigid body that is pressed into the gel must answer, and the sphere; other shapes are in `shapes.py`."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from enum import Flag
from typing import Annotated, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gelgap.assets.settings import Settings, within

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Symmetry(Flag):
    """Which motions of the sensor's plane leave a shape unchanged, and so which contacts can share a solution.

    `MIRROR_X` turns x into −x, `MIRROR_Y` y into −y; `REVOLUTION` is all turns about the vertical axis, and these too.
    """

    NONE = 0
    MIRROR_X = 1
    MIRROR_Y = 2
    MIRROR = 3
    REVOLUTION = 7


class Projection(NamedTuple):
    """Where the surface of a body is nearest to points: `points_mm` (…, 3) and unit `outward_normal` (…, 3) of it.

    `distance_mm` (…) is the points' signed distance from there, negative inside the body.
    """

    points_mm: Floats
    outward_normal: Floats
    distance_mm: Floats


class Indenter(Settings, ABC):
    """A rigid body, `convex` unless its class says otherwise.

    Points (…, 3) are mm from the body's origin, with axes parallel to the sensor's. A shape is a subclass and a part of
    `AnyIndenter`; the names of its fields tell it from other shapes in a recipe.
    """

    shape: ClassVar[str]
    convex: ClassVar[bool] = True

    @property
    @abstractmethod
    def symmetry(self) -> Symmetry:
        """Which contacts of the body can share a solution."""

    @property
    @abstractmethod
    def label(self) -> str:
        """Shape and size in a few words, for lists."""

    @property
    @abstractmethod
    def origin_height_mm(self) -> float:
        """Height of the origin above the lowest point, which touches the gel first."""

    @property
    @abstractmethod
    def feature_size_mm(self) -> float:
        """Radius of the sphere whose contact needs a mesh as fine as this body's."""

    @property
    def deepest_mm(self) -> float:
        """Largest depth to which the body may be pressed: up to its origin, where it is widest."""
        return self.origin_height_mm

    @property
    def shallowest_mm(self) -> float:
        """Depth that the body must at least be pressed to, so that all of its face touches."""
        return 0.0

    @property
    @abstractmethod
    def mujoco_geom(self) -> str:
        """Attributes of MuJoCo's geom, in mm: the body, or a box around it; near it, MuJoCo looks for contacts."""

    @abstractmethod
    def penetration_radius_mm(self, depth_mm: float) -> float:
        """Return the largest distance from the axis of where the body, at a depth, cuts the undeformed membrane."""

    @abstractmethod
    def reach_mm(self, directions: Floats) -> Floats:
        """Return how far (n,) the body reaches from its origin in unit directions (n, 3)."""

    @abstractmethod
    def project(self, points_mm: Floats) -> Projection:
        """Project points (…, 3) onto the surface."""

    def cut_mm(self, depth_mm: float) -> Floats:
        """Return x and y, from and to (2, 2), of where the body, at a depth, cuts the undeformed membrane."""
        radius_mm = self.penetration_radius_mm(depth_mm)
        return np.array([[-radius_mm, radius_mm], [-radius_mm, radius_mm]])

    def contact_radius_mm(self, depth_mm: float) -> float:
        """Return the radius of the widest disc in what the body, at a depth, cuts of the membrane; about, if convex."""
        return float(np.ptp(self.cut_mm(depth_mm), axis=1).min()) / 2

    def curvature(self, depth_mm: float, axis: int, step_mm: float) -> tuple[Floats, Floats]:
        """Return where along x or y (axis 0, 1) the surface that a press reaches is more curved than a sphere's.

        The places (n,) in mm, and the radius of curvature (n,) there, taken over a step; none for a sphere.
        """
        return np.zeros(0), np.zeros(0)

    def check(self, depth_mm: float) -> None:
        """Raise ValueError if the body cannot be pressed to a depth as it is turned."""

    @property
    def yaw(self) -> float:
        """How far the body is turned about the vertical axis, degrees from +x towards +y."""
        return 0.0

    @property
    def lean_deg(self) -> float:
        """How far the body's axis is from the vertical, degrees."""
        return 0.0

    def yawed(self, yaw_deg: float) -> Self:
        """Return the body turned about the vertical axis by so much more."""
        return self

    def straightened(self) -> Self:
        """Return the body turned about the vertical axis as it is solved: mirrored in y = 0 if any turn does that."""
        return self

    def turned(self, turn_deg: Sequence[float]) -> Self:
        """Return the body turned about its origin by a rotation vector (x, y, z): as it was, if that looks the same."""
        return self


def rotation(turn_deg: Floats) -> Floats:
    """Return the matrix (3, 3) that turns by the length of a vector (3,), about it."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(turn_deg, degrees=True).as_matrix()


class Sphere(Indenter):
    """A rigid sphere; its origin is its centre."""

    shape: ClassVar[str] = "sphere"

    diameter_mm: Annotated[float, within(0.5, 50.0, "mm")] = Field(
        default=3.0, description="Diameter, mm, 0.5 to 50."
    )

    @property
    def symmetry(self) -> Symmetry:
        return Symmetry.REVOLUTION

    @property
    def radius_mm(self) -> float:
        return self.diameter_mm / 2

    @property
    def label(self) -> str:
        return f"sphere {self.diameter_mm:g} mm"

    @property
    def origin_height_mm(self) -> float:
        return self.radius_mm

    @property
    def feature_size_mm(self) -> float:
        return self.radius_mm

    @property
    def mujoco_geom(self) -> str:
        return f'type="sphere" size="{self.radius_mm:.12g}"'

    def penetration_radius_mm(self, depth_mm: float) -> float:
        below_mm = max(self.radius_mm - depth_mm, 0.0)
        return math.sqrt(max(self.radius_mm**2 - below_mm**2, 0.0))

    def reach_mm(self, directions: Floats) -> Floats:
        return np.full(len(directions), self.radius_mm)

    def project(self, points_mm: Floats) -> Projection:
        from_centre = np.maximum(np.linalg.norm(points_mm, axis=-1), 1e-9)
        return Projection(
            points_mm * (self.radius_mm / from_centre)[..., None],
            points_mm / from_centre[..., None],
            from_centre - self.radius_mm,
        )
