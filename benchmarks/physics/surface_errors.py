"""Errors of a membrane against a reference: displacement, normals, and the picture."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

SURFACE_REACH_MM = 5.0
NORMALS_REACH_MM = 3.0  # from the contact


@dataclass(frozen=True)
class SurfaceErrors:
    """Errors over the rest grid within 5 mm of the contact point, and of normals within 3 mm of the contact."""

    uz_rms_um: float
    in_plane_rms_um: float
    peak_um: float
    normal_rms_deg: float
    normal_worst_deg: float

    @property
    def values(self) -> tuple[float, ...]:
        """All of them, in their order."""
        return astuple(self)


def combined(errors: Sequence[SurfaceErrors]) -> SurfaceErrors:
    """Return the root mean squares of the rms errors and the largest of the peaks."""
    uz, in_plane, peak, normal, worst = zip(*(e.values for e in errors), strict=True)
    return SurfaceErrors(rms(uz), rms(in_plane), max(peak), rms(normal), max(worst))


def surface_errors(
    x_mm: Floats, y_mm: Floats, displacement_mm: Floats, expected_mm: Floats, contact_radius_mm: float
) -> SurfaceErrors:
    """Compare displacements (ny, nx, 3) on the same rest grid, centred on the contact."""
    radius = np.hypot(*np.meshgrid(x_mm, y_mm))
    error = 1e3 * (displacement_mm - expected_mm)[radius <= SURFACE_REACH_MM]
    in_plane = np.hypot(error[:, 0], error[:, 1])
    cosine = (normals(x_mm, y_mm, displacement_mm) * normals(x_mm, y_mm, expected_mm)).sum(-1)
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))[radius <= contact_radius_mm + NORMALS_REACH_MM]
    return SurfaceErrors(
        uz_rms_um=rms(error[:, 2]),
        in_plane_rms_um=rms(in_plane),
        peak_um=float(max(np.abs(error[:, 2]).max(), in_plane.max())),
        normal_rms_deg=rms(angle),
        normal_worst_deg=float(angle.max()),
    )


def normals(x_mm: Floats, y_mm: Floats, displacement_mm: Floats) -> Floats:
    """Return unit normals (ny, nx, 3) of the deformed membrane by central differences, pointing to +z at rest."""
    position = displacement_mm.astype(float)
    position[..., 0] += x_mm
    position[..., 1] += y_mm[:, None]
    along_y, along_x = np.gradient(position, y_mm, x_mm, axis=(0, 1))
    normal = np.cross(along_x, along_y)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def picture_psnr_db(picture: NDArray[np.uint8], expected: NDArray[np.uint8]) -> float:
    """Return the peak signal-to-noise ratio of two 8-bit pictures, dB; infinite if they are the same."""
    square = ((picture.astype(float) - expected) ** 2).mean()
    return float(10 * np.log10(255**2 / square)) if square else float("inf")


def rms(values: ArrayLike) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.square(values).mean()))
