"""Taxim's own pipeline: the installed package renders, its table as shipped or filled anew from chosen presses.

Si and Yuan, "Taxim: An Example-Based Simulation Model for GelSight Tactile Sensors", RA-L 2022: colour change is looked
up by the normal of the pressed surface, as a quadratic of the pixel's place; a second table attaches shadows.
"""

import shutil
import tempfile
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gelgap.render import PressPicture

INSTALL = 'pip install "taxim[jax-cpu]==1.4.1"'
BINS = 125
KEPT_SHARE, BLUR_PX = 0.85, 50.0  # Taxim's background: this much of the reference, the rest of it blurred


def missing_packages() -> tuple[str, ...]:
    """Return what of the package and the backend of its renderer is not installed."""
    return tuple(name for name in ("taxim", "jax") if find_spec(name) is None)


def fit_table(reference: np.ndarray, presses: Sequence[PressPicture], mm_per_px: float) -> np.ndarray:
    """Return (BINS, BINS, 6, 3): by inclination and direction of the normal, RGB change as a quadratic of the place."""
    from scipy.ndimage import distance_transform_edt, gaussian_filter

    plain = reference.astype(float)
    background = np.trunc(
        KEPT_SHARE * plain + (1 - KEPT_SHARE) * gaussian_filter(plain, (BLUR_PX, BLUR_PX, 0))
    )
    rows, columns = np.indices(reference.shape[:2])
    changes, places = [], []
    for press in presses:
        x, y = np.trunc(press.center_px)
        distance = np.hypot(columns - x, rows - y)
        inside = distance < min(press.radius_px, press.sphere_diameter_mm / 2 / mm_per_px)
        inclination = np.arcsin(distance[inside] * mm_per_px * 2 / press.sphere_diameter_mm)
        direction = np.arctan2(y - rows[inside], x - columns[inside])
        bins = _bin(inclination, np.pi / 2), _bin(direction + np.pi, 2 * np.pi)
        table = np.full((BINS, BINS, 5), np.nan)
        change = press.picture[inside] - background[inside]
        table[bins] = np.column_stack([change, columns[inside], rows[inside]])
        nearest = distance_transform_edt(np.isnan(table[..., 0]), return_distances=False, return_indices=True)
        filled = table[tuple(nearest)]
        changes.append(filled[..., :3])
        places.append(filled[..., 3:])
    x, y = np.moveaxis(np.array(places), (0, 3), (3, 0))
    terms = np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], axis=-1)
    return np.linalg.pinv(terms) @ np.moveaxis(np.array(changes), 0, 2)


def _bin(angle: np.ndarray, largest: float) -> np.ndarray:
    return (angle / (largest / (BINS - 1))).astype(int)


class TaximRenderer:
    """The package's renderer of balls, on a flat gel or on the package's own domed one.

    Parameters
    ----------
    calibration
        Which of the package's calibrations: `gelsight` or `gelsight_mini`.
    table
        (BINS, BINS, 6, 3) as `fit_table` returns it, in place of the package's.
    domed
        Whether the gel is as the package has it, and not flat.
    """

    def __init__(self, calibration: str, table: np.ndarray | None = None, domed: bool = False) -> None:
        import taxim

        with tempfile.TemporaryDirectory() as folder:
            shutil.copytree(Path(taxim.__file__).parent / "calib" / calibration, folder, dirs_exist_ok=True)
            if table is not None:
                # The package calls the first channel of its pictures, which is blue, red.
                channels = dict(zip(("grad_b", "grad_g", "grad_r"), np.moveaxis(table, 3, 0), strict=True))
                np.savez(Path(folder) / "polycalib.npz", bins=BINS, **channels)
            gel = np.load(Path(folder) / "gelmap.npy")
            if not domed:
                gel = np.zeros_like(gel)
                np.save(Path(folder) / "gelmap.npy", gel)
            self.simulator = taxim.Taxim(Path(folder), backend="jax", device="cpu")
        self.mm_per_px = self.simulator.sensor_params.pixmm
        self.gel_mm = (gel - gel.max()) * self.mm_per_px

    def untouched(self) -> np.ndarray:
        """Return the uint8 RGB picture of the gel that nothing touches, which its table tints."""
        return self._rendered(np.ones_like(self.gel_mm))

    def picture(self, press: PressPicture, depth_mm: float | None = None) -> np.ndarray:
        """Return the uint8 RGB picture of a ball, by default as deep as its cap cuts the marked circle."""
        radius_mm, (x, y) = press.sphere_diameter_mm / 2, press.center_px
        rows, columns = np.indices(self.gel_mm.shape)
        square = self.mm_per_px**2 * ((columns - x) ** 2 + (rows - y) ** 2)
        if depth_mm is None:
            contact_mm = min(press.radius_px * self.mm_per_px, radius_mm)
            depth_mm = radius_mm - np.sqrt(radius_mm**2 - contact_mm**2)
        ball = radius_mm - np.sqrt(np.maximum(radius_mm**2 - square, 0))
        return self._rendered(ball - depth_mm + self.gel_mm[round(y), round(x)])

    def _rendered(self, height_mm: np.ndarray) -> np.ndarray:
        picture = self.simulator.render(height_mm.astype(np.float32), with_shadow=True)
        return np.clip(np.round(255 * np.asarray(picture)), 0, 255).astype(np.uint8)
