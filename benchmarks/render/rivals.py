"""What else predicts a real sensor's presses: nothing, tables without physics, and Taxim's own pipeline.

Si and Yuan, "Taxim: An Example-Based Simulation Model for GelSight Tactile Sensors", RA-L 2022: colour change is looked
up by the normal of the pressed surface, as a quadratic of the pixel's place; a second table attaches shadows. Here the
installed package renders, its table as shipped or filled anew from chosen presses.
"""

import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gelgap.domains import PressSet
from gelgap.render import PressPicture
from gelgap.render.calibration.pictures import PlainTable

Draw = Callable[[int], Callable[[], np.ndarray]]
"""Gives by a press's index what draws its predicted uint8 picture; the drawing alone is a frame's time."""
Fitted = tuple[Draw, float | None]
"""How a model predicts presses, and the processor time of its fit in s (None: it has none)."""
INSTALL = 'pip install "taxim[jax-cpu]==1.4.1"'
BINS = 125
KEPT_SHARE, BLUR_PX = 0.85, 50.0  # Taxim's background: this much of the reference, the rest of it blurred


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


@dataclass(frozen=True)
class TaximForm:
    """How Taxim's pipeline is used; by default its table is filled from the fitted presses and its gel is flat."""

    refitted: bool = True
    domed: bool = False
    deep: bool = False  # the ball as deep as gelgap's solves say; otherwise as its cap cuts the marked circle
    on_reference: bool = False  # its change from its own untouched gel is added to the real reference


REFITTED, DEEP = "Taxim, refitted", "Taxim, refitted, the ball as deep as in gelgap"
TAXIM_FORMS = {
    "Taxim, table as shipped (all presses)": TaximForm(refitted=False),
    REFITTED: TaximForm(),
    "Taxim, refitted, its own domed gel": TaximForm(domed=True),
    DEEP: TaximForm(deep=True),
    "the same, its change added to the reference": TaximForm(deep=True, on_reference=True),
}


def missing_packages() -> tuple[str, ...]:
    """Return what of the package and the backend of its renderer is not installed."""
    return tuple(name for name in ("taxim", "jax") if find_spec(name) is None)


def taxim(
    found: PressSet, calibration: str, depths_mm: np.ndarray, form: TaximForm, fitted: Sequence[int]
) -> Fitted:
    """Predict by Taxim's renderer with the shipped `calibration`; `depths_mm` (presses,) are gelgap's."""
    import taxim

    height, width, _ = found.reference.shape
    table, fit_s = None, None
    if form.refitted:
        started = time.process_time()
        mm_per_px = found.start.camera.footprint_mm((width, height))[0] / width
        table = fit_table(found.reference, [found.presses[k] for k in fitted], mm_per_px)
        fit_s = time.process_time() - started
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(Path(taxim.__file__).parent / "calib" / calibration, folder, dirs_exist_ok=True)
        if table is not None:
            # The package calls the first channel of its pictures, which is blue, red.
            channels = dict(zip(("grad_b", "grad_g", "grad_r"), np.moveaxis(table, 3, 0), strict=True))
            np.savez(Path(folder) / "polycalib.npz", bins=BINS, **channels)
        gel = np.load(Path(folder) / "gelmap.npy")
        if not form.domed:
            gel = np.zeros_like(gel)
            np.save(Path(folder) / "gelmap.npy", gel)
        simulator = taxim.Taxim(Path(folder), backend="jax", device="cpu")
    mm_per_px = simulator.sensor_params.pixmm
    gel_mm = (gel - gel.max()) * mm_per_px
    rows, columns = np.indices(gel_mm.shape)

    def rendered(height_mm: np.ndarray) -> np.ndarray:
        picture = simulator.render(height_mm.astype(np.float32), with_shadow=True)
        return np.clip(np.round(255 * np.asarray(picture)), 0, 255).astype(np.uint8)

    untouched = rendered(np.ones_like(gel_mm))  # tinted by the table

    def picture(index: int) -> np.ndarray:
        press = found.presses[index]
        radius_mm, (x, y) = press.sphere_diameter_mm / 2, press.center_px
        square = mm_per_px**2 * ((columns - x) ** 2 + (rows - y) ** 2)
        contact_mm = min(press.radius_px * mm_per_px, radius_mm)
        cap_mm = radius_mm - np.sqrt(radius_mm**2 - contact_mm**2)
        depth_mm = depths_mm[index] if form.deep else cap_mm
        ball = radius_mm - np.sqrt(np.maximum(radius_mm**2 - square, 0))
        pressed = rendered(ball - depth_mm + gel_mm[round(y), round(x)])
        if not form.on_reference:
            return pressed
        return np.clip(found.reference + (pressed.astype(int) - untouched), 0, 255).astype(np.uint8)

    return lambda press: partial(picture, press), fit_s


def fit_table(reference: np.ndarray, presses: Sequence[PressPicture], mm_per_px: float) -> np.ndarray:
    """Return (BINS, BINS, 6, 3): by inclination and direction of the normal, RGB change as a quadratic of the place."""
    from scipy.ndimage import distance_transform_edt, gaussian_filter

    plain = reference.astype(float)
    background = np.trunc(
        KEPT_SHARE * plain + (1 - KEPT_SHARE) * gaussian_filter(plain, (BLUR_PX, BLUR_PX, 0))
    )
    rows, columns = np.indices(reference.shape[:2])

    def bin_of(angle: np.ndarray, largest: float) -> np.ndarray:
        return (angle / (largest / (BINS - 1))).astype(int)

    filled = []
    for press in presses:
        x, y = np.trunc(press.center_px)
        distance = np.hypot(columns - x, rows - y)
        inside = distance < min(press.radius_px, press.sphere_diameter_mm / 2 / mm_per_px)
        inclination = np.arcsin(distance[inside] * mm_per_px * 2 / press.sphere_diameter_mm)
        direction = np.arctan2(y - rows[inside], x - columns[inside])
        table = np.full((BINS, BINS, 5), np.nan)
        change = press.picture[inside] - background[inside]
        entries = np.column_stack([change, columns[inside], rows[inside]])
        table[bin_of(inclination, np.pi / 2), bin_of(direction + np.pi, 2 * np.pi)] = entries
        nearest = distance_transform_edt(np.isnan(table[..., 0]), return_distances=False, return_indices=True)
        filled.append(table[tuple(nearest)])
    changes, (x, y) = np.array(filled)[..., :3], np.moveaxis(np.array(filled)[..., 3:], (0, 3), (3, 0))
    terms = np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], axis=-1)
    return np.linalg.pinv(terms) @ np.moveaxis(changes, 0, 2)
