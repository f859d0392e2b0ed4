"""What else predicts a real sensor's presses: nothing, tables without physics, and Taxim's own pipeline.

Si and Yuan, "Taxim: An Example-Based Simulation Model for GelSight Tactile Sensors", RA-L 2022: colour change is looked
up by the normal of the pressed surface, as a quadratic of the pixel's place; a second table attaches shadows. Here the
installed package renders.
"""

import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gelgap.domains import PressSet
from gelgap.render.calibration.pictures import PlainTable

Draw = Callable[[int], Callable[[], np.ndarray]]
"""Gives by a press's index what draws its predicted uint8 picture; the drawing alone is a frame's time."""
Fitted = tuple[Draw, float | None]
"""How a model predicts presses, and the processor time of its fit in s (None: it has none)."""
INSTALL = 'pip install "taxim[jax-cpu]==1.4.1"'


def unchanged(found: PressSet, fitted: Sequence[int]) -> Fitted:
    """Predict that nothing happens."""
    return lambda press: lambda: found.reference, None


def plain_table(found: PressSet, degree: int, fitted: Sequence[int]) -> Fitted:
    """Predict by a `PlainTable` of the fitted presses; of a predicted press the marked centre is used."""
    started = time.process_time()
    presses = [found.presses[k] for k in fitted]
    marks = np.array([press.center_px for press in presses]), np.array([press.radius_px for press in presses])
    table = PlainTable.of(found.reference, [press.picture for press in presses], *marks, degree)
    fit_s = time.process_time() - started
    return lambda press: partial(table.picture, found.presses[press].center_px), fit_s


def missing_packages() -> tuple[str, ...]:
    """Return what of the package and the backend of its renderer is not installed."""
    return tuple(name for name in ("taxim", "jax") if find_spec(name) is None)


def taxim(found: PressSet, calibration: str, depths_mm: np.ndarray | None, fitted: Sequence[int]) -> Fitted:
    """Predict by Taxim's renderer with the `calibration` that is shipped, which is of all presses, on flat gel.

    The ball is as deep as `depths_mm` (presses,) say, or without them as its cap cuts the marked circle.
    """
    import taxim

    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(Path(taxim.__file__).parent / "calib" / calibration, folder, dirs_exist_ok=True)
        np.save(Path(folder) / "gelmap.npy", np.zeros_like(np.load(Path(folder) / "gelmap.npy")))
        simulator = taxim.Taxim(Path(folder), backend="jax", device="cpu")
    mm_per_px = simulator.sensor_params.pixmm
    rows, columns = np.indices(found.reference.shape[:2])

    def picture(index: int) -> np.ndarray:
        press = found.presses[index]
        radius_mm, (x, y) = press.sphere_diameter_mm / 2, press.center_px
        square = mm_per_px**2 * ((columns - x) ** 2 + (rows - y) ** 2)
        contact_mm = min(press.radius_px * mm_per_px, radius_mm)
        cap_mm = radius_mm - np.sqrt(radius_mm**2 - contact_mm**2)
        depth_mm = cap_mm if depths_mm is None else depths_mm[index]
        height_mm = radius_mm - np.sqrt(np.maximum(radius_mm**2 - square, 0)) - depth_mm
        shown = simulator.render(height_mm.astype(np.float32), with_shadow=True)
        return np.clip(np.round(255 * np.asarray(shown)), 0, 255).astype(np.uint8)

    return lambda press: partial(picture, press), None
