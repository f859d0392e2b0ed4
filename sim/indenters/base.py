"""What a rigid body must answer to be pressed into the gel."""

from abc import ABC, abstractmethod
from enum import Enum
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelgap.assets.settings import Settings

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

    Points (…, 3) are mm from the body's origin, with axes parallel to the sensor's. A shape is a subclass in a file of
    its own and a name in `registry.py`; the names of its fields tell it from other shapes in a recipe.
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
