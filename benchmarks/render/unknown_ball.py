"""A sensor whose ball, scale and marks are hardly known: how well it is predicted, and what not knowing them costs.

The published marks go round whole dents, so every press is placed in its own picture (`refined`), and besides the
marked circles there is the contact as the whole model finds it. Even presses are fitted, the ball's size too.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gelgap.benchmarks.common.tables import print_table, write_json
from gelgap.benchmarks.render import rivals
from gelgap.benchmarks.render.predictions import METRICS, Prediction, score_presses, table_row
from gelgap.benchmarks.render.sensors import WHOLE, Variant, predict
from gelgap.domains import PressSet, sphere_profiles, taxim_presses
from gelgap.render import PressPicture, PressProfiles
from gelgap.render.calibration.calibrator import LightTask, unknown_sphere_size
from gelgap.render.calibration.poses import place_presses

SET = "gelsight_mini"
VARIANTS = (
    Variant("LEDs alone", order=0, degree=0, far=False),
    Variant("+ scattered light", far=False),
    WHOLE,
)
# What may be assumed instead: the ball's diameter, in fitted ones, and the scale, in those of the package.
OTHER_DIAMETERS = (0.8, 1.25, 1.6)
OTHER_SCALES = (0.8, 1.25)


def task_of(found: PressSet, profiles: PressProfiles, variant: Variant = WHOLE) -> LightTask:
    """Return what a form of the model is fitted with, for the ball around which the membrane is known."""
    diameter = 2 * profiles.sphere_radius_mm
    presses = [replace(press, sphere_diameter_mm=diameter) for press in found.presses]
    placed = place_presses(found.start.camera, found.reference, presses, {diameter: profiles})
    return LightTask(found.start, placed, variant.order, variant.degree, variant.far, variant.shadows)


def sharp(found: PressSet) -> PressSet:
    """Return the set with a camera that does not blur."""
    camera = found.start.camera.model_copy(update={"point_spread_px": 0.0})
    return replace(found, start=found.start.model_copy(update={"camera": camera}))


def found_contacts(task: LightTask, fitted: np.ndarray, predicted: np.ndarray) -> list[PressPicture]:
    """Return the presses marked by their contacts as the fit finds them."""
    fit = task.fit(fitted)
    placed, presses = task.placed, []
    mm_per_px = 2 * placed.half_view_mm / placed.size_px[0]
    for press in predicted:
        x, y, depth = fit.refined(placed, int(press)).presses[0]
        column, row = placed.camera.project_px(np.array([x, y, -depth]), placed.size_px) - 0.5
        profiles = placed.profiles[press]
        presses.append(
            PressPicture(
                placed.presses[press].picture,
                2 * profiles.sphere_radius_mm,
                radius_px=profiles.contact_radius_mm(depth) / mm_per_px,
                center_px=(float(column), float(row)),
            )
        )
    return presses


def contact_levels(prediction: Prediction, contacts: list[PressPicture]) -> np.ndarray:
    """Return PSNR in dB inside each found contact."""
    levels = []
    for picture, press in zip(prediction.pictures, contacts, strict=True):
        rows, columns = np.indices(picture.shape[:2])
        inside = np.hypot(columns - press.center_px[0], rows - press.center_px[1]) < press.radius_px
        error = picture[inside].astype(float) - press.picture[inside]
        levels.append(10 * np.log10(255**2 / max(np.mean(error**2), 1e-9)))
    return np.array(levels)


def run(quick: bool, out_dir: Path) -> None:
    """Print how odd presses are predicted; write JSON. Quick: two presses, the whole model alone."""
    found = taxim_presses(SET)
    even, odd = np.arange(0, len(found.presses), 2), np.arange(1, len(found.presses), 2)
    odd = odd[: 2 if quick else None]
    marked = [found.presses[k] for k in odd]
    fitted = [found.presses[k] for k in even]
    size = unknown_sphere_size(found.start, found.reference, fitted, sphere_profiles)
    profiles = sphere_profiles({size.diameter_mm})[size.diameter_mm]
    contacts = found_contacts(task_of(found, profiles), even, odd)

    predictions = [rivals.unchanged(found, odd)]
    for variant in (WHOLE,) if quick else VARIANTS:
        predictions += predict(task_of(found, profiles, variant), variant, even, odd, ("refined",))
    if not quick:
        variant = replace(WHOLE, name="whole, camera taken for sharp")
        predictions += predict(task_of(sharp(found), profiles), variant, even, odd, ("refined",))
    rows, results = [], []
    for prediction in predictions:
        levels, values = contact_levels(prediction, contacts), score_presses(prediction, marked)
        name, _, *others = table_row(prediction, values)
        rows.append([name, f"{np.median(levels):.1f} ({levels.min():.1f})", *others])
        results.append({"name": name, "contact": levels, "scores": values})
    radii = [press.radius_px for press in contacts]
    print_table(
        f"{SET}: even presses fitted, {len(odd)} odd ones predicted; PSNR in dB, median (worst)",
        ["model", "contact", *METRICS, "fit, s", "ms per frame"],
        rows,
        note=f"contact: as found, radius {np.median(radii):.0f} px; the other regions are the marked circles'. "
        f"Ball fitted to the even presses: {size.diameter_mm:.2f} mm, between {size.interval_mm[0]:.2f} and "
        f"{size.interval_mm[1]:.2f} mm",
    )
    assumptions = [] if quick else assumed(found, profiles, even, odd)
    write_json(
        out_dir / "unknown-ball.json", {"size": size, "predictions": results, "assumptions": assumptions}
    )


def assumed(found: PressSet, profiles: PressProfiles, even: np.ndarray, odd: np.ndarray) -> list[dict]:
    """Print how odd presses are predicted if the ball or the scale is another than was found."""
    diameter_mm, mm_per_px = 2 * profiles.sphere_radius_mm, 2 * task_of(found, profiles).placed.half_view_mm
    mm_per_px /= found.reference.shape[1]
    cases = [(found, mm_per_px, profiles.scaled(factor)) for factor in (1.0, *OTHER_DIAMETERS)]
    for factor in OTHER_SCALES:
        scaled_mm = factor * diameter_mm
        solved = sphere_profiles({scaled_mm})[scaled_mm]
        cases.append((taxim_presses(SET, factor * mm_per_px), factor * mm_per_px, solved))
    rows, results = [], []
    for assumed_set, scale, own in cases:
        task = task_of(assumed_set, own)
        (prediction,) = predict(task, WHOLE, even, odd, ("refined",))
        values = score_presses(prediction, [found.presses[k] for k in odd])
        diameter = 2 * own.sphere_radius_mm
        rows.append([f"{diameter:.2f}", f"{scale:.4f}", *table_row(prediction, values)[2:6]])
        results.append({"diameter_mm": diameter, "mm_per_px": scale, "scores": values})
    print_table(
        "what the assumed ball and scale cost; PSNR in dB, median (worst)",
        ["diameter, mm", "mm per px", *METRICS[:4]],
        rows,
    )
    return results
