"""The regular rest grid of the membrane, and bringing any state's grid onto it."""

from dataclasses import dataclass
from math import gcd
from typing import NamedTuple

import numpy as np

from gelgap.render.camera import Camera

# What a state covers by convention: the paper's 12×9 mm footprint and a margin of 1 mm for shadows and perspective.
STATE_HALF_EXTENT_MM = (7.0, 5.5)
MARGIN_MM = 1.0
# Extents are rounded up to whole steps of this, so that cameras that differ little share their membranes.
EXTENT_STEP_MM = 0.5
TAPER_MM = 3.0


# numba's cache on disk refers by name to the NamedTuples that kernels take. Who renames or removes one must rename the
# modules of those kernels too: a cache that an older version has left there would fail to load.
class Grid(NamedTuple):
    """Where a lattice's first point lies and how far apart its points are, as kernels take it: float32."""

    x0_mm: np.float32
    y0_mm: np.float32
    spacing_mm: np.float32
    cells_per_mm: np.float32


def view_half_extent_mm(camera: Camera, size_px: tuple[int, int]) -> tuple[float, float]:
    """Return how far a membrane must reach from the sensor's centre along x and y for a picture of this size.

    That is a state's convention, or the camera's footprint with its margin where it is larger.
    """
    half_mm = np.maximum(STATE_HALF_EXTENT_MM, _half_footprint_mm(camera, size_px) + MARGIN_MM)
    return tuple((np.ceil(half_mm / EXTENT_STEP_MM - 1e-3) * EXTENT_STEP_MM).tolist())


def _half_footprint_mm(camera: Camera, size_px: tuple[int, int]) -> np.ndarray:
    return np.asarray(camera.footprint_mm(size_px)) / 2 + np.abs(camera.position_mm[:2])


@dataclass(frozen=True)
class Lattice:
    """A regular grid of points in the plane of the undeformed membrane, row-major, rows along +y."""

    x0_mm: float
    y0_mm: float
    spacing_mm: float
    columns: int
    rows: int

    @classmethod
    def covering(
        cls, camera: Camera, size_px: tuple[int, int], spacing_mm: float, step: int = 1
    ) -> "Lattice":
        """Return the grid that covers a state's convention and the camera's footprint with its margin.

        Every `step`-th of its vertices reach as far.
        """
        half_mm = np.maximum(STATE_HALF_EXTENT_MM, _half_footprint_mm(camera, size_px) + MARGIN_MM)
        unit = step // gcd(step, 2)
        half_cells = unit * np.ceil(half_mm / (unit * spacing_mm) - 1e-3).astype(int)
        return cls(
            x0_mm=-half_cells[0] * spacing_mm,
            y0_mm=-half_cells[1] * spacing_mm,
            spacing_mm=spacing_mm,
            columns=int(2 * half_cells[0] + 1),
            rows=int(2 * half_cells[1] + 1),
        )

    @property
    def x_mm(self) -> np.ndarray:
        return self.x0_mm + self.spacing_mm * np.arange(self.columns)

    @property
    def y_mm(self) -> np.ndarray:
        return self.y0_mm + self.spacing_mm * np.arange(self.rows)

    @property
    def grid(self) -> Grid:
        return Grid(*np.float32([self.x0_mm, self.y0_mm, self.spacing_mm, 1 / self.spacing_mm]))

    def points_mm(self) -> np.ndarray:
        """Return (rows, columns, 2) rest coordinates."""
        return np.stack(np.meshgrid(self.x_mm, self.y_mm), axis=-1)

    def every(self, step: int) -> "Lattice":
        """Return the grid of every `step`-th vertex of this one."""
        return Lattice(
            self.x0_mm,
            self.y0_mm,
            self.spacing_mm * step,
            (self.columns - 1) // step + 1,
            (self.rows - 1) // step + 1,
        )
