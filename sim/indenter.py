"""The rigid bodies that can be pressed into the gel: what each must answer, and the sphere."""

import math
from abc import ABC, abstractmethod
from enum import Enum
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gelgap.assets.settings import Settings, within

Floats = NDArray[np.float64]


class Symmetry(Enum):
    """Which motions of the sensor's plane leave a shape unchanged, and so which contacts can share a solution."""

    REVOLUTION = "about the vertical axis"
    MIRROR = "in the planes x = 0 and y = 0"
    NONE = "none"


class Projection(NamedTuple):
    """Where the surface of a body is nearest to points: `points_mm` (…, 3) and unit `outward_normal` (…, 3) of it.

    `distance_mm` (…) is the points' signed distance from there, negative inside the body.
    """

    points_mm: Floats
    outward_normal: Floats
    distance_mm: Floats


class Indenter(Settings, ABC):
    """A convex rigid body that is moved without being turned.

    Points (…, 3) are mm from the body's origin, with axes parallel to the sensor's. A shape is a subclass and a part of
    `AnyIndenter`; the names of its fields tell it from other shapes in a recipe.
    """

    shape: ClassVar[str]
    symmetry: ClassVar[Symmetry]

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
    @abstractmethod
    def mujoco_geom(self) -> str:
        """Attributes of MuJoCo's geom, in mm."""

    @abstractmethod
    def penetration_radius_mm(self, depth_mm: float) -> float:
        """Return the largest distance from the axis of where the body, at a depth, cuts the undeformed membrane."""

    @abstractmethod
    def project(self, points_mm: Floats) -> Projection:
        """Project points (…, 3) onto the surface."""


class Sphere(Indenter):
    """A rigid sphere; its origin is its centre."""

    shape: ClassVar[str] = "sphere"
    symmetry: ClassVar[Symmetry] = Symmetry.REVOLUTION

    diameter_mm: Annotated[float, within(0.5, 50.0, "mm")] = Field(
        default=3.0, description="Diameter, mm, 0.5 to 50."
    )

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

    def project(self, points_mm: Floats) -> Projection:
        from_centre = np.maximum(np.linalg.norm(points_mm, axis=-1), 1e-9)
        return Projection(
            points_mm * (self.radius_mm / from_centre)[..., None],
            points_mm / from_centre[..., None],
            from_centre - self.radius_mm,
        )


AnyIndenter = Sphere
"""Type of a field that holds any shape, `Sphere | …`; pydantic tells shapes apart by the names of their fields."""
