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
from gelgap.benchmarks.render.sensors import WHOLE, Variant, fitting_task, predict
from gelgap.domains import PressSet, sphere_profiles, taxim_presses
from gelgap.render import PressPicture
from gelgap.render.light_calibration import LightTask, unknown_sphere_size

SET = "gelsight_mini"
VARIANTS = (
    Variant("LEDs alone", order=0, degree=0, far=False),
    Variant("+ scattered light", far=False),
    WHOLE,
)
# What may be assumed instead: the ball's diameter, in fitted ones, and the scale, in those of the package.
OTHER_DIAMETERS = (0.8, 1.25, 1.6)
OTHER_SCALES = (0.8, 1.25)


def with_ball(found: PressSet, diameter_mm: float) -> PressSet:
    """Return the set with a ball of known size."""
    presses = tuple(replace(press, sphere_diameter_mm=diameter_mm) for press in found.presses)
    return replace(found, presses=presses)


def sharp(found: PressSet) -> PressSet:
    """Return the set with a camera that does not blur."""
    camera = found.start.camera.model_copy(update={"point_spread_px": 0.0})
    return replace(found, start=found.start.model_copy(update={"camera": camera}))


def found_contacts(task: LightTask, fitted: np.ndarray, predicted: np.ndarray) -> list[PressPicture]:
    """Return the presses marked by their contacts as the fit finds them."""
    fit, field = task.fit(fitted)
    placed, presses = task.placed, []
    mm_per_px = 2 * task.half_view_mm / placed.size_px[0]
    for press in predicted:
        x, y, depth = task.refined_pose(fit, field, int(press))
        column, row = placed.camera.project_px(np.array([x, y, -depth]), placed.size_px) - 0.5
        profiles = placed.profiles[press]
        presses.append(
            PressPicture(
                placed.pictures[press],
                2 * profiles.sphere_radius_mm,
                radius_px=profiles.contact_radius_mm(depth) / mm_per_px,
                center_px=(float(column), float(row)),
            )
        )
    return presses


def contact_levels(prediction: Prediction, contacts: list[PressPicture]) -> np.ndarray:
    """Return PSNR in dB inside each found contact."""
    return np.array(score_presses(prediction, contacts))[:, 0]


def run(quick: bool, out_dir: Path) -> None:
    """Print how odd presses are predicted; write JSON. Quick: two presses, the whole model alone."""
    unknown = taxim_presses(SET)
    even, odd = np.arange(0, len(unknown.presses), 2), np.arange(1, len(unknown.presses), 2)
    odd = odd[: 2 if quick else None]
    marked = [unknown.presses[k] for k in odd]
    fitted = [unknown.presses[k] for k in even]
    size = unknown_sphere_size(unknown.start, unknown.reference, fitted, sphere_profiles)
    found = with_ball(unknown, size.diameter_mm)
    contacts = found_contacts(fitting_task(found, WHOLE), even, odd)

    predictions = [rivals.unchanged(found, odd)]
    for variant in (WHOLE,) if quick else VARIANTS:
        predictions += predict(fitting_task(found, variant), variant, even, odd, ("refined",))
    if not quick:
        variant = replace(WHOLE, name="whole, camera taken for sharp")
        predictions += predict(fitting_task(sharp(found), variant), variant, even, odd, ("refined",))
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
    assumptions = [] if quick else assumed(found, size.diameter_mm, even, odd)
    write_json(
        out_dir / "unknown-ball.json", {"size": size, "predictions": results, "assumptions": assumptions}
    )


def assumed(found: PressSet, diameter_mm: float, even: np.ndarray, odd: np.ndarray) -> list[dict]:
    """Print how odd presses are predicted if the ball or the scale is another than was found."""
    cases = [(found, factor * diameter_mm) for factor in (1.0, *OTHER_DIAMETERS)]
    plain_mm_per_px = found.start.camera.footprint_mm((1, 1))[0] / found.reference.shape[1]
    for factor in OTHER_SCALES:
        cases.append((taxim_presses(SET, factor * plain_mm_per_px), factor * diameter_mm))
    rows, results = [], []
    for assumed_set, diameter in cases:
        assumed_set = with_ball(assumed_set, diameter)
        task = fitting_task(assumed_set, WHOLE)
        (prediction,) = predict(task, WHOLE, even, odd, ("refined",))
        values = score_presses(prediction, [found.presses[k] for k in odd])
        depths_mm = task.fit(even)[0].presses[:, 2]
        mm_per_px = 2 * task.half_view_mm / task.placed.size_px[0]
        depth = f"{depths_mm.min():.2f}…{depths_mm.max():.2f}"
        rows.append(
            [f"{diameter:.2f}", f"{mm_per_px:.4f}", depth, *table_row(prediction, values)[2:6]],
        )
        results.append({"diameter_mm": diameter, "mm_per_px": mm_per_px, "scores": values})
    print_table(
        "what the assumed ball and scale cost; PSNR in dB, median (worst)",
        ["diameter, mm", "mm per px", "depths, mm", *METRICS[:4]],
        rows,
    )
    return results
