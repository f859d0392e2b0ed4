"""The rigid body that is pressed into the gel."""

from typing import Annotated

from pydantic import Field

from gelgap.assets.settings import Settings, within


class Sphere(Settings):
    """A rigid sphere."""

    diameter_mm: Annotated[float, within(0.5, 50.0, "mm")] = Field(
        default=3.0, description="Diameter, mm, 0.5 to 50."
    )

    @property
    def radius_mm(self) -> float:
        return self.diameter_mm / 2
