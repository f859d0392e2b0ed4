"""A camera's geometry: where its pinhole is, how much it sees, and how its lens bends."""

from math import atan, degrees, hypot, radians, tan
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field

from gelgap.assets.settings import Settings

FARTHEST_MM = 500.0
_NEAR_MM = 25.0
OF_LIGHT = frozenset(
    {
        "vignetting",
        "point_spread_px",
        "full_well_electrons",
        "read_noise_electrons",
        "exposure",
        "sensitivity",
        "white_balance_cct_k",
    }
)
"""What a sensor file's table [camera] has besides geometry (`gelgap.render.Camera`)."""


class Pinhole(Settings):
    """A camera that looks along +z at the membrane; its optical axis meets the picture's centre."""

    position_mm: tuple[float, float, Annotated[float, Field(lt=-2.5, ge=-FARTHEST_MM)]] = Field(
        default=(0.0, 0.0, -25.0), description="pinhole in the sensor frame; z < -2.5 mm, inside the sensor"
    )
    horizontal_field_of_view_deg: float = Field(
        default=26.991467, gt=1, lt=150, description="full angle across the picture's width, degrees"
    )
    radial_distortion: tuple[float, float] = Field(
        default=(0.0, 0.0), description="k1, k2 of OpenCV's model on normalised image coordinates"
    )

    @classmethod
    def of_camera(cls, table: dict[str, Any]) -> Self:
        """Return the geometry in a sensor file's table [camera]; a ValueError names a field that no camera has."""
        return cls(**{name: value for name, value in table.items() if name not in OF_LIGHT})

    def focal_length_px(self, width_px: int) -> float:
        """Return the focal length in pixels of a picture `width_px` wide (square pixels)."""
        return 0.5 * width_px / tan(radians(0.5 * self.horizontal_field_of_view_deg))

    def footprint_mm(self, size_px: tuple[int, int]) -> tuple[float, float]:
        """Return the width and height in mm that the picture shows of the undeformed membrane, without distortion."""
        width_mm = -2 * self.position_mm[2] * tan(radians(0.5 * self.horizontal_field_of_view_deg))
        return width_mm, width_mm * size_px[1] / size_px[0]

    @classmethod
    def showing(cls, width_mm: float) -> Self:
        """Return the camera, 25 mm away, that shows 0.5 to 150 mm of the undeformed membrane, or raise ValueError."""
        if not 0.5 <= width_mm <= 150:
            raise ValueError(
                f"images would show {width_mm:.3g} mm of the gel, allowed are 0.5 to 150 mm: check the mm per pixel"
            )
        fov_deg = 2 * degrees(atan(width_mm / 2 / _NEAR_MM))
        return cls(position_mm=(0.0, 0.0, -_NEAR_MM), horizontal_field_of_view_deg=fov_deg)

    def farthest_mm(self, size_px: tuple[int, int]) -> float:
        """Return the distance from which the view is nearly parallel: 500 mm, or where a small view fills 1.2°."""
        return min(FARTHEST_MM, self.footprint_mm(size_px)[0] / 2 / tan(radians(0.6)))

    def seen_from(self, distance_mm: float, size_px: tuple[int, int]) -> Self:
        """Return the camera at another distance that shows the same of the undeformed membrane."""
        half_mm = self.footprint_mm(size_px)[0] / 2
        k1, k2 = self.radial_distortion
        # Distortion is a matter of the slope of rays, which is less from afar.
        steeper = (distance_mm / -self.position_mm[2]) ** 2
        return self.model_copy(
            update={
                "position_mm": (*self.position_mm[:2], -distance_mm),
                "horizontal_field_of_view_deg": 2 * degrees(atan(half_mm / distance_mm)),
                "radial_distortion": (k1 * steeper, k2 * steeper**2),
            }
        )

    def plane_points_mm(self, columns: np.ndarray, rows: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
        """Return (n, 2): where the rays through pixels' centres meet the plane of the undeformed membrane."""
        pixels = np.stack([columns + 0.5, rows + 0.5], axis=1)
        distorted = (pixels - np.asarray(size_px) / 2) / self.focal_length_px(size_px[0])
        slope = self._undistorted(np.linalg.norm(distorted, axis=1, keepdims=True))
        return np.asarray(self.position_mm[:2]) - self.position_mm[2] * distorted / self._stretch(slope**2)

    def _stretch(self, r2: np.ndarray) -> np.ndarray:
        """Return by how much the lens stretches slopes of rays against the optical axis, given their squares."""
        k1, k2 = self.radial_distortion
        return 1 + r2 * (k1 + r2 * k2)

    def _undistorted(self, distorted: np.ndarray) -> np.ndarray:
        """Return the slopes that the lens shows as these, by Newton's method."""
        k1, k2 = self.radial_distortion
        slope = distorted
        for _ in range(20):
            r2 = slope**2
            slope = slope - (slope * self._stretch(r2) - distorted) / (1 + r2 * (3 * k1 + 5 * r2 * k2))
        return slope

    def farthest_slope(self, size_px: tuple[int, int]) -> float:
        """Return the slope of the ray through the picture's corner.

        Raises
        ------
        ValueError
            If the lens shows no ray there: what lies farther out would come to lie nearer to the picture's middle.
        """
        corner = 0.5 * hypot(*size_px) / self.focal_length_px(size_px[0])
        with np.errstate(all="ignore"):
            slope = float(self._undistorted(np.float64(corner)))
        nearer = np.linspace(0, slope, 100)
        if slope > 0 and (np.diff(nearer * self._stretch(nearer**2)) > 0).all():
            return slope
        raise ValueError(
            f"camera.radial_distortion = {self.radial_distortion}: folds the picture over before its corner; at this "
            f"field of view k1 must be at least {-4 / 27 / corner**2:.3g} if k2 is 0"
        )

    def plane_of_picture_mm(self, size_px: tuple[int, int]) -> np.ndarray:
        """Return (h w, 2): which place of the undeformed membrane each pixel of a picture sees, row by row."""
        rows, columns = np.indices(size_px[::-1])
        return self.plane_points_mm(columns.ravel(), rows.ravel(), size_px)

    def project_px(self, points_mm: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
        """Return (…, 2) picture coordinates of (…, 3) points; pixel (column, row) has its centre at +0.5."""
        relative = np.asarray(points_mm, float) - self.position_mm
        slope = relative[..., :2] / relative[..., 2:]
        # Out of the picture the lens may fold: from its corner on, slopes are stretched alike.
        r2 = np.minimum((slope**2).sum(-1, keepdims=True), self.farthest_slope(size_px) ** 2)
        return slope * self._stretch(r2) * self.focal_length_px(size_px[0]) + np.asarray(size_px) / 2
