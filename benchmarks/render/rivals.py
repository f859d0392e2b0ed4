"""What else predicts a real sensor's presses: tables without physics, and Taxim's own pipeline."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gelgap.benchmarks.render.plain_table import PlainTable
from gelgap.benchmarks.render.predictions import Prediction
from gelgap.benchmarks.render.taxim_rival import TaximRenderer, fit_table
from gelgap.domains import PressSet


@dataclass(frozen=True)
class TaximForm:
    """How Taxim's pipeline is used; by default its table is filled from the fitted presses and its gel is flat."""

    name: str
    refitted: bool = True
    domed: bool = False
    deep: bool = (
        False  # the ball as deep as gelgap's solves say, not as deep as its cap cuts the marked circle
    )
    on_reference: bool = False  # its change from its own untouched gel is added to the real reference


AS_SHIPPED = TaximForm("Taxim, table as shipped (all presses)", refitted=False)
REFITTED = TaximForm("Taxim, refitted")
DEEP = TaximForm("Taxim, refitted, the ball as deep as in gelgap", deep=True)
TAXIM_FORMS = (
    AS_SHIPPED,
    REFITTED,
    TaximForm("Taxim, refitted, its own domed gel", domed=True),
    DEEP,
    TaximForm("the same, its change added to the reference", deep=True, on_reference=True),
)


def unchanged(found: PressSet, predicted: np.ndarray) -> Prediction:
    """Predict that nothing happens."""
    return Prediction("the reference, unchanged", "", [found.reference] * len(predicted))


def plain_table(found: PressSet, degree: int, fitted: np.ndarray, predicted: np.ndarray) -> Prediction:
    """Predict by a table without physics, constant (`degree` 0) or quadratic (2) in the press's place."""
    started = time.process_time()
    table = PlainTable(found.reference, [found.presses[k] for k in fitted], degree)
    fit_s = time.process_time() - started
    name = "table without physics" + (", quadratic in the place" if degree else "")
    return _timed(name, lambda k: table.picture(found.presses[k]), predicted, fit_s)


def taxim(
    found: PressSet,
    calibration: str,
    depths_mm: np.ndarray,
    form: TaximForm,
    fitted: np.ndarray,
    predicted: np.ndarray,
) -> Prediction:
    """Predict by Taxim's renderer with the shipped `calibration`; `depths_mm` (presses,) are gelgap's."""
    height, width, _ = found.reference.shape
    table, fit_s = None, None
    if form.refitted:
        started = time.process_time()
        mm_per_px = found.start.camera.footprint_mm((width, height))[0] / width
        table = fit_table(found.reference, [found.presses[k] for k in fitted], mm_per_px)
        fit_s = time.process_time() - started
    renderer = TaximRenderer(calibration, table, form.domed)
    untouched = renderer.untouched()

    def picture(press: int) -> np.ndarray:
        rendered = renderer.picture(found.presses[press], depths_mm[press] if form.deep else None)
        if not form.on_reference:
            return rendered
        change = rendered.astype(int) - untouched
        return np.clip(found.reference + change, 0, 255).astype(np.uint8)

    return _timed(form.name, picture, predicted, fit_s)


def _timed(
    name: str, picture: Callable[[int], np.ndarray], predicted: np.ndarray, fit_s: float | None
) -> Prediction:
    pictures, times = [], []
    for press in predicted:
        started = time.process_time()
        pictures.append(picture(press))
        times.append(time.process_time() - started)
    return Prediction(name, "marked", pictures, fit_s, 1e3 * float(np.median(times)))
