"""A sensor whose ball, scale and marks are hardly known: how well it is predicted.

The published marks go round whole dents, so every press is placed in its own picture (`refined`), and besides the
marked circles there is the contact as the whole model finds it. Even presses are fitted, the ball's size too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gelgap.benchmarks.common import write_json
from gelgap.benchmarks.render import rivals
from gelgap.benchmarks.render.sensors import VARIANTS, WHOLE, Study, light_models, light_task, show_scores
from gelgap.domains import PressSet, sphere_profiles, taxim_presses
from gelgap.render import PressPicture, PressProfiles
from gelgap.render.calibration.calibrator import LightTask, unknown_sphere_size

SET = "gelsight_mini"
SHARP = "whole, camera taken for sharp"
FORMS = {
    "LEDs alone": {"order": 0, "degree": 0, "far": False},
    "+ scattered light": VARIANTS[WHOLE] | {"far": False},
    WHOLE: VARIANTS[WHOLE],
    SHARP: VARIANTS[WHOLE],
}


def run(quick: bool, out_dir: Path) -> None:
    """Print how odd presses are predicted; write JSON. Quick: two presses, the whole model alone."""
    found = taxim_presses(SET)
    count = len(found.presses)
    even, odd = range(0, count, 2), range(1, 5 if quick else count, 2)
    presses = [found.presses[k] for k in even]
    size = unknown_sphere_size(found.start, found.reference, presses, sphere_profiles)
    profiles = sphere_profiles({size.diameter_mm})[size.diameter_mm]
    contacts = found_contacts(ball_task(found, profiles, FORMS[WHOLE]), even, odd)

    models = {("the reference, unchanged", ""): partial(rivals.unchanged, found)}
    for name in (WHOLE,) if quick else FORMS:
        own = sharp(found) if name == SHARP else found
        task = partial(ball_task, own, profiles, FORMS[name])
        models |= light_models(name, task, ("refined",))
    split = {f"{len(odd)} odd presses": (even, odd)}
    kept = out_dir / "unknown-ball.jsonl"
    records = Study(found.presses, models, split, contacts).records(kept)

    radius_px = np.median([press.radius_px for press in contacts.values()])
    show_scores(
        f"{SET}: even presses fitted, {len(odd)} odd ones predicted; PSNR in dB, median (worst)",
        records,
        ("model", "fit, s", "ms per frame"),
        f"contact: as found, radius {radius_px:.0f} px; the other regions are the marked circles'. Ball fitted to the "
        f"even presses: {size.diameter_mm:.2f} mm, between {size.interval_mm[0]:.2f} and {size.interval_mm[1]:.2f} mm",
    )
    write_json(out_dir / "unknown-ball.json", {"size": size, "predictions": records})
    kept.unlink()


def ball_task(found: PressSet, profiles: PressProfiles, form: Mapping[str, Any]) -> LightTask:
    """Return what a form of the model is fitted with, for the ball around which the membrane is known."""
    diameter = 2 * profiles.sphere_radius_mm
    presses = tuple(replace(press, sphere_diameter_mm=diameter) for press in found.presses)
    return light_task(replace(found, presses=presses), form, {diameter: profiles})


def sharp(found: PressSet) -> PressSet:
    """Return the set with a camera that does not blur."""
    camera = found.start.camera.model_copy(update={"point_spread_px": 0.0})
    return replace(found, start=found.start.model_copy(update={"camera": camera}))


def found_contacts(
    task: LightTask, fitted: Sequence[int], predicted: Sequence[int]
) -> dict[int, PressPicture]:
    """Return the presses marked by their contacts as the fit finds them."""
    fit, placed, contacts = task.fit(np.array(fitted)), task.placed, {}
    mm_per_px = 2 * placed.half_view_mm / placed.size_px[0]
    for press in predicted:
        x, y, depth = fit.refined(placed, press).presses[0]
        column, row = placed.camera.project_px(np.array([x, y, -depth]), placed.size_px) - 0.5
        radius_px = placed.profiles[press].contact_radius_mm(depth) / mm_per_px
        mark = {"radius_px": radius_px, "center_px": (float(column), float(row))}
        contacts[press] = replace(placed.presses[press], **mark)
    return contacts
