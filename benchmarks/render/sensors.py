"""A real sensor predicted: even presses of a published calibration set fitted, odd ones rendered and compared.

Every prediction is gelgap's own renderer's picture. `marked` takes a press where it was marked by hand and uses nothing
of its picture; `refined` moves its centre and depth in its own picture. Taxim's own pipeline is not run here: it needs
torch-scatter or jax.
"""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gelgap.benchmarks.common.tables import print_table, write_json
from gelgap.domains import CALIBRATION_GEL, PressSet, sphere_profiles, taxim_presses
from gelgap.render import LightCalibration, MembraneRenderer, Sensor, save_calibration
from gelgap.render.light_calibration import LightTask, flat_field_maps
from gelgap.render.light_fit import LightFit
from gelgap.render.press_poses import place_presses

SET = "gelsight"
EXTENT_MM = (10.5, 8.2)
METRICS = ("inside", "ring", "within", "whole", "SSIM", "mean abs")


@dataclass(frozen=True)
class Variant:
    """One form of the model: what of it is there."""

    name: str
    order: int = 3
    degree: int = 2
    far: bool = True
    shadows: bool = True
    keep_camera: bool = False
    quality: str = "draft"


VARIANTS = (
    Variant("LEDs alone, camera kept at 25 mm", order=0, degree=0, far=False, keep_camera=True),
    Variant("+ scattered light, order 2 × (1, x, y)", order=2, degree=1, far=False, keep_camera=True),
    Variant("+ camera's distance fitted", order=2, degree=1, far=False),
    Variant("+ order 3 × quadratics, flat field from the reference alone", far=False),
    Variant("the same, without shadows", far=False, shadows=False),
    Variant("whole: + flat field of pressed pictures"),
    Variant("whole, membrane at standard", quality="standard"),
)
QUICK_VARIANTS = VARIANTS[5:6]


def scores(
    predicted: np.ndarray, real: np.ndarray, center_px: tuple[float, float], radius_px: float
) -> list[float]:
    """Return the metrics of one picture, PSNR in dB by region."""
    from skimage.metrics import structural_similarity

    rows, columns = np.indices(real.shape[:2])
    share = np.hypot(columns - center_px[0], rows - center_px[1]) / radius_px
    error = predicted.astype(float) - real
    regions = (share < 1, (share >= 1) & (share < 2), share < 2, np.ones_like(share, bool))
    levels = [float(10 * np.log10(255**2 / max(np.mean(error[r] ** 2), 1e-9))) for r in regions]
    ssim = float(structural_similarity(predicted, real, channel_axis=2))
    return [*levels, ssim, float(np.abs(error).mean())]


def fitted_renderer(task: LightTask, fit: LightFit, field, used: np.ndarray) -> MembraneRenderer:
    """Return gelgap's renderer of a fit, through the files that a user would have."""
    lit = task.lit_sensor(fit)
    placed = task.placed
    volumes = [placed.profiles[k].volume_mm3(pose[2]) for k, pose in zip(used, fit.presses, strict=True)]
    unknown = np.full((len(lit.illumination.leds), 2), np.nan)
    calibration = LightCalibration(
        lit,
        flat_field_maps(lit, placed, field),
        tuple(map(tuple, field.gain.T.tolist())),
        float(np.median(volumes)),
        fit.presses,
        (),
        (),
        fit.rms_code_values,
        (),
        unknown,
        unknown,
    )
    with tempfile.TemporaryDirectory() as folder:
        save_calibration(calibration, Path(folder) / "fitted.toml")
        sensor = Sensor.load(Path(folder) / "fitted.toml")
        return MembraneRenderer(sensor, sensor.illumination, placed.size_px)


def drop_shadows(renderer: MembraneRenderer) -> None:
    """Let the renderer light each membrane as if nothing stood above it."""
    radiance = renderer._radiance
    renderer._radiance = lambda surface: radiance(
        surface._replace(height_mm=np.full_like(surface.height_mm, -EXTENT_MM[0]))
    )


def measure(found: PressSet, variant: Variant, predicted: np.ndarray) -> dict[str, object]:
    """Fit the even presses and predict the given odd ones."""
    sensor = found.start
    diameters = {press.sphere_diameter_mm for press in found.presses}
    placed = place_presses(
        sensor.camera,
        found.reference,
        found.presses,
        sphere_profiles(diameters, None, variant.quality, CALIBRATION_GEL),
    )
    task = LightTask(
        sensor, placed, variant.order, variant.degree, variant.far, variant.shadows, variant.keep_camera
    )
    even = np.arange(0, len(found.presses), 2)
    started = time.process_time()
    fit, field = task.fit(even)
    fit_s = time.process_time() - started
    renderer = fitted_renderer(task, fit, field, even)
    task = task.seen_as(fit)
    placed = task.placed
    if not variant.shadows:
        drop_shadows(renderer)
    rows: dict[str, list[list[float]]] = {"marked": [], "refined": []}
    frame_s = []
    for press in predicted:
        poses = placed.poses_mm[press], task.refined_pose(fit, field, int(press))
        for way, pose in zip(rows, poses, strict=True):
            membrane = placed.profiles[press].membrane(pose[:2], pose[2], EXTENT_MM)
            started = time.process_time()
            picture = renderer.picture(*membrane, markers=False)
            frame_s.append(time.process_time() - started)
            marks = tuple(placed.centers_px[press]), float(placed.radii_px[press])
            rows[way].append(scores(picture, placed.pictures[press], *marks))
    return {"variant": variant, "fit_s": fit_s, "frame_ms": 1e3 * float(np.median(frame_s)), "scores": rows}


def unchanged(found: PressSet, predicted: np.ndarray) -> list[list[float]]:
    """Return the scores of the reference itself."""
    presses = [found.presses[k] for k in predicted]
    return [scores(found.reference, press.picture, press.center_px, press.radius_px) for press in presses]


def table_row(
    name: str, pose: str, values: list[list[float]], fit_s: float | str, frame_ms: float | str
) -> list:
    """Return a row of medians, in brackets the worst."""
    medians, worst = np.median(values, axis=0), np.min(values, axis=0)
    levels = [f"{m:.1f} ({w:.1f})" for m, w in zip(medians[:4], worst[:4], strict=True)]
    return [name, pose, *levels, f"{medians[4]:.3f}", f"{medians[5]:.2f}", fit_s, frame_ms]


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


def run(quick: bool, out_dir: Path) -> None:
    """Print how the odd presses are predicted; write JSON to `out_dir`. Quick: one variant, every fourth odd press."""
    found = taxim_presses(SET)
    predicted = np.arange(1, len(found.presses), 8 if quick else 2)
    reference = unchanged(found, predicted)
    rows = [table_row("the reference, unchanged", "", reference, "", "")]
    results = []
    for variant in QUICK_VARIANTS if quick else VARIANTS:
        result = measure(found, variant, predicted)
        results.append(result)
        for way, values in result["scores"].items():
            times = (round(result["fit_s"], 1), round(result["frame_ms"], 1))
            rows.append(table_row(variant.name, way, values, *times))
    print_table(
        f"{SET}: even presses fitted, {len(predicted)} odd ones predicted; PSNR in dB, median (worst)",
        ["model", "press", *METRICS, "fit, s", "ms per frame"],
        rows,
        note=f"LEDs without scattered light and flat field: {plain_frame_ms(found):.1f} ms per frame. Taxim's "
        "own pipeline is not run: it needs torch-scatter or jax. The Mini's set is not measured: neither its ball nor "
        "its scale is known",
    )
    write_json(out_dir / "sensors.json", {"unchanged": reference, "variants": results})
