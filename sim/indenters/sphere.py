"""A rigid sphere."""

import math
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from gelgap.assets.settings import within
from gelgap.sim.indenters.base import Floats, Indenter, Projection, Symmetry


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
