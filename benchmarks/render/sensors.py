"""A real sensor predicted: even presses of a published calibration set fitted, odd ones rendered and compared.

gelgap's predictions are its own renderer's pictures. `marked` takes a press where it was marked by hand, `corrected`
moves it as the marks of the fitted presses were moved on average; both use nothing of its picture. `refined` moves its
centre and depth in its own picture. Beside them: what else predicts (`rivals`), and presses unlike the fitted ones
(`other_presses`).
"""

import tempfile
import time
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from gelgap.benchmarks.common.tables import print_table, write_json
from gelgap.benchmarks.render import rivals
from gelgap.benchmarks.render.contact_sheet import draw_contact_sheet
from gelgap.benchmarks.render.other_presses import Model, measure_other_presses
from gelgap.benchmarks.render.predictions import METRICS, Prediction, score_presses, table_row
from gelgap.benchmarks.render.taxim_rival import INSTALL, missing_packages
from gelgap.domains import CALIBRATION_GEL, PressSet, sphere_profiles, taxim_presses
from gelgap.render import LightCalibration, MembraneRenderer, Sensor, save_calibration
from gelgap.render.calibration.calibrator import FEWEST_FOR_ORDER_3, LightTask, corrected_poses
from gelgap.render.calibration.fit import LightFit
from gelgap.render.calibration.poses import place_presses

SET = "gelsight"
EXTENT_MM = (10.5, 8.2)
HELD_SIGMA_MM = 1e-4  # so little does a fit move a press that is held where it was marked


@dataclass(frozen=True)
class Variant:
    """One form of the model: what of it is there."""

    name: str
    order: int = 3
    degree: int = 2
    far: bool = True
    shadows: bool = True
    keep_camera: bool = False
    flat_field: bool = True
    refines_fitted: bool = True
    quality: str = "draft"


WHOLE = Variant("whole: + flat field of pressed pictures")
VARIANTS = (
    Variant("LEDs alone, camera kept at 25 mm", order=0, degree=0, far=False, keep_camera=True),
    Variant("+ scattered light, order 2 × (1, x, y)", order=2, degree=1, far=False, keep_camera=True),
    Variant("+ camera's distance fitted", order=2, degree=1, far=False),
    Variant("+ order 3 × quadratics, flat field from the reference alone", far=False),
    Variant("the same, without shadows", far=False, shadows=False),
    WHOLE,
    Variant("whole without scattered light", order=0, degree=0),
    Variant("whole without shadows", shadows=False),
    Variant("whole without flat field, as rendered", flat_field=False),
    Variant("whole, fitted presses as marked", refines_fitted=False),
    Variant("whole, membrane at standard", quality="standard"),
)


CORRECTED = (WHOLE, VARIANTS[-1])


def fitted_renderer(task: LightTask, fit: LightFit, flat_field: bool) -> MembraneRenderer:
    """Return gelgap's renderer of a fit, through the files that a user would have."""
    unknown = np.full((len(fit.light.bars.azimuth), 2), np.nan)
    calibration = LightCalibration(
        **task.result(fit),
        names=(),
        left_out=(),
        held_out=(),
        led_azimuths_deg=unknown,
        led_elevations_deg=unknown,
    )
    with tempfile.TemporaryDirectory() as folder:
        save_calibration(calibration, Path(folder) / "fitted.toml")
        sensor = Sensor.load(Path(folder) / "fitted.toml")
        kept = sensor if flat_field else sensor.model_copy(update={"flat_field": None})
        return MembraneRenderer(kept, sensor.illumination, task.placed.size_px)


def drop_shadows(renderer: MembraneRenderer) -> None:
    """Let the renderer light each membrane as if nothing stood above it."""
    radiance = renderer._radiance
    renderer._radiance = lambda surface: radiance(
        surface._replace(height_mm=np.full_like(surface.height_mm, -EXTENT_MM[0]))
    )


def fitting_task(found: PressSet, variant: Variant) -> LightTask:
    """Return what a form of the model is fitted with."""
    sensor = found.start
    diameters = {press.sphere_diameter_mm for press in found.presses}
    profiles = sphere_profiles(diameters, None, variant.quality, CALIBRATION_GEL)
    placed = place_presses(sensor.camera, found.reference, found.presses, profiles)
    return LightTask(
        sensor, placed, variant.order, variant.degree, variant.far, variant.shadows, variant.keep_camera
    )


def predict(
    task: LightTask,
    variant: Variant,
    fitted: np.ndarray,
    predicted: np.ndarray,
    ways: tuple[str, ...] = ("marked", "refined"),
) -> list[Prediction]:
    """Fit presses and render others, for each way of placing these: marked, corrected, refined."""
    placed = task.placed
    held = replace(task, placed=replace(placed, sigma_mm=np.full_like(placed.sigma_mm, HELD_SIGMA_MM)))
    started = time.process_time()
    fit = (task if variant.refines_fitted else held).fit(fitted)
    fit_s = time.process_time() - started
    renderer = fitted_renderer(task, fit, variant.flat_field)
    placed = task.placed.seen_from(fit.distance_mm)
    if not variant.shadows:
        drop_shadows(renderer)
    corrected_mm = corrected_poses(placed.poses_mm, fitted, fit.presses)
    pose_of = {
        "marked": lambda press: placed.poses_mm[press],
        "corrected": lambda press: corrected_mm[press],
        "refined": lambda press: fit.refined(placed, int(press)).presses[0],
    }
    predictions = []
    for way in ways:
        pictures, times = [], []
        for press in predicted:
            pose = pose_of[way](press)
            membrane = placed.profiles[press].membrane(pose[:2], pose[2], EXTENT_MM)
            started = time.process_time()
            pictures.append(renderer.picture(*membrane, markers=False))
            times.append(time.process_time() - started)
        predictions.append(Prediction(variant.name, way, pictures, fit_s, 1e3 * float(np.median(times))))
    return predictions


def predict_unseen(task: LightTask, way: str, fitted: np.ndarray, predicted: np.ndarray) -> Prediction:
    """Fit the whole model, or its small form where presses are few, and predict others."""
    few = len(fitted) < FEWEST_FOR_ORDER_3
    task = replace(task, order=2, degree=1) if few else task
    return predict(task, replace(WHOLE, name=f"gelgap, {way}"), fitted, predicted, (way,))[0]


def plain_frame_ms(found: PressSet) -> float:
    """Return the time of a frame under the same LEDs without what real sensors need."""
    sensor = found.start
    renderer = MembraneRenderer(
        sensor, sensor.illumination, (found.reference.shape[1], found.reference.shape[0])
    )
    profiles = sphere_profiles({found.presses[0].sphere_diameter_mm}, None, "draft")
    own = next(iter(profiles.values()))
    times = []
    for depth in np.linspace(1.6, 1.7, 24):
        membrane = own.membrane((0.0, 0.0), float(depth), EXTENT_MM)
        started = time.process_time()
        renderer.picture(*membrane, markers=False)
        times.append(time.process_time() - started)
    return 1e3 * float(np.median(times))


def rival_models(found: PressSet, depths_mm: np.ndarray, forms: tuple[rivals.TaximForm, ...]) -> list[Model]:
    """Return the tables without physics, and Taxim's forms if it is installed."""
    tables = [partial(rivals.plain_table, found, degree) for degree in (0, 2)]
    if missing_packages():
        return tables
    return tables + [partial(rivals.taxim, found, SET, depths_mm, form) for form in forms]


def run(quick: bool, out_dir: Path) -> None:
    """Print how presses are predicted; write JSON and a contact sheet. Quick: fewer presses and models."""
    found = taxim_presses(SET)
    even, predicted = np.arange(0, len(found.presses), 2), np.arange(1, len(found.presses), 8 if quick else 2)
    presses = [found.presses[k] for k in predicted]
    whole = fitting_task(found, WHOLE)
    depths_mm = whole.placed.poses_mm[:, 2]
    reference = rivals.unchanged(found, predicted)
    unchanged = score_presses(reference, presses)
    rows, of_rivals, of_variants, shown = [table_row(reference, unchanged)], [], [], {}
    for model in rival_models(found, depths_mm, (rivals.REFITTED,) if quick else rivals.TAXIM_FORMS):
        prediction = model(even, predicted)
        values = score_presses(prediction, presses)
        rows.append(table_row(prediction, values))
        of_rivals.append({**asdict(replace(prediction, pictures=[])), "scores": values})
        if prediction.name == rivals.REFITTED.name:
            shown["Taxim, refitted"] = prediction
    for variant in (WHOLE,) if quick else VARIANTS:
        task = whole if variant is WHOLE else fitting_task(found, variant)
        ways = ("marked", "corrected", "refined") if variant in CORRECTED else ("marked", "refined")
        placed_ways = predict(task, variant, even, predicted, ways)
        metrics = {prediction.pose: score_presses(prediction, presses) for prediction in placed_ways}
        rows += [table_row(prediction, metrics[prediction.pose]) for prediction in placed_ways]
        times = {"fit_s": placed_ways[0].fit_s, "frame_ms": placed_ways[0].frame_ms}
        of_variants.append({"variant": variant, **times, "scores": metrics})
        if variant is WHOLE:
            shown = {"gelgap": placed_ways[0], **shown}
    without = f" Taxim's own pipeline is left out; install it: {INSTALL}." if missing_packages() else ""
    print_table(
        f"{SET}: even presses fitted, {len(predicted)} odd ones predicted; PSNR in dB, median (worst)",
        ["model", "press", *METRICS, "fit, s", "ms per frame"],
        rows,
        note=f"LEDs without scattered light and flat field: {plain_frame_ms(found):.1f} ms per frame.{without}",
    )
    draw_contact_sheet(out_dir / "sensors.jpg", presses, shown)
    models = [partial(predict_unseen, whole, way) for way in ("marked", "corrected")]
    models += rival_models(found, depths_mm, (rivals.DEEP,))
    others = {} if quick else measure_other_presses(whole, found.presses, models)
    write_json(
        out_dir / "sensors.json",
        {"unchanged": unchanged, "variants": of_variants, "rivals": of_rivals, "other_presses": others},
    )
