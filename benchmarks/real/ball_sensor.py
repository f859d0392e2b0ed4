"""The ball presses' sensor: where a press is seen in its pictures, its light, and synthetic presses in its view."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gelgap.benchmarks.real.published_sets import MM_PER_PX, SERIES
from gelgap.domains import (
    DomainRecipe,
    LabelledFrames,
    Labels,
    PretrainingRanges,
    join_domains,
    open_domain,
    pretraining_recipes,
    sphere_profiles,
    with_labels,
)
from gelgap.domains.calibration_presses import start_sensor
from gelgap.render import (
    Camera,
    Led,
    Markers,
    PressPicture,
    Sensor,
    calibrate_light,
    inpaint_telea,
    light_azimuths,
    save_calibration,
)
from gelgap.sim import Pose, PosePath

SIZE_PX = (240, 320)
VIEW_MM = (SIZE_PX[0] * MM_PER_PX, SIZE_PX[1] * MM_PER_PX)
DOTS = Markers(columns=13, rows=17, pitch_mm=2.0, diameter_mm=0.55, jitter_mm=0.05)
"""Dots as large and as far apart as in the pictures; the real ones end 3 mm from the view's edge."""
FAR_MM = 500.0
"""Marks are places in the picture: a nearly parallel camera shows a contact where it is, however deep."""
FITTED_SERIES, FITTED_PRESSES = "calibration2", 24
"""The light is fitted to as many presses of that series."""
LABELS = Labels.of({"x_mm": (-VIEW_MM[0] / 2, VIEW_MM[0] / 2), "y_mm": (-VIEW_MM[1] / 2, VIEW_MM[1] / 2)})
SYNTHETIC_PX = (120, 160)
MM_PER_SYNTHETIC_PX = VIEW_MM[0] / SYNTHETIC_PX[0]
_MARGIN = 0.05
"""Share of the width: the pad's rim changes, too, when the gel is pressed."""
_BLUR = 0.025
_SHARE = 0.5
_DOT_CONTRAST = 14
_DOT_PX = 13
_ROUNDS = 6
_MOST_STEP_PX = 5.0
# The presses are deep; how deep, and where, the fit looks for in the pictures.
_CONTACT_IN_RADII = 0.95
_MARKS_OFF_PX = 10.0
_POINT_SPREAD_PX = 2.0
_RANGES = {
    "description": "Balls of 4 to 8 mm pressed straight into gels with dots",
    "depths": 3,
    "thickness_mm": (3.0, 5.0),
    "sphere_diameter_mm": (3.9, 8.0),
    "deepest_by_thickness": (0.3, 0.5),
    "travel_by_depth": (0.0, 0.0),
    "view_mm": (VIEW_MM[0], VIEW_MM[0]),
    # A pixel of these small pictures is the mean of four of the sensor's.
    "full_well_electrons": (6e3, 8e4),
    "with_markers": 1.0,
}
# `pretraining_recipes` draws points within 0.7 of the view, and balls were pressed nearer to its edge.
_FARTHER_OUT = 0.95 / 0.7


def center_of_change_px(change: np.ndarray) -> np.ndarray:
    """Return (x, y) px: the centroid of what exceeds half of the largest change (h, w, 3), blurred, where that lies.

    A dent is brighter on the sides that face lights and darker on the others, and seldom as much: this point lies off
    the contact's centre, towards the stronger light.
    """
    import cv2

    height, width, _ = change.shape
    margin = round(_MARGIN * width)
    inside = np.zeros((height, width), np.float32)
    inside[margin:-margin, margin:-margin] = 1
    size = cv2.GaussianBlur(np.abs(change).mean(axis=2, dtype=np.float32) * inside, (0, 0), _BLUR * width)
    _, parts = cv2.connectedComponents((size > _SHARE * size.max()).astype(np.uint8))
    strong = np.where(parts == parts.ravel()[size.argmax()], size, 0)
    rows, columns = np.indices(size.shape)
    return np.array([(strong * columns).sum(), (strong * rows).sum()]) / strong.sum()


def level_point_px(picture: np.ndarray, reference: np.ndarray, radius_px: float) -> np.ndarray:
    """Return (x, y) px: where the change, taken as linear in the place within `radius_px`, vanishes in all colours.

    Where the gel is level its colour is that of the reference: that is the dent's centre, whatever the lights. The
    search begins at the centroid of the change; dots are left out.
    """
    dots = dots_of(picture) | dots_of(reference)
    change = picture.astype(np.float64) - reference
    rows, columns = np.indices(dots.shape)
    point = start = center_of_change_px(change)
    for _ in range(_ROUNDS):
        near = (np.hypot(columns - point[0], rows - point[1]) < radius_px) & ~dots
        away = np.column_stack([np.ones(near.sum()), columns[near] - point[0], rows[near] - point[1]])
        there, *slopes = np.linalg.lstsq(away, change[near], rcond=None)[0]
        step = np.linalg.lstsq(np.transpose(slopes), -there, rcond=None)[0]
        point = point + np.clip(step, -_MOST_STEP_PX, _MOST_STEP_PX)
    return point if np.hypot(*(point - start)) < radius_px else start


def dots_of(picture: np.ndarray) -> np.ndarray:
    """Return the mask (h, w) of dots. These are too pale in the median of many pictures for gelgap's own rule."""
    import cv2

    brightest = picture.max(axis=2)
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_DOT_PX, _DOT_PX))
    hollow = cv2.morphologyEx(brightest, cv2.MORPH_BLACKHAT, around)
    return cv2.dilate((hollow > _DOT_CONTRAST).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)


def fitted_sensor(frames: LabelledFrames, path: Path) -> Sensor:
    """Return the sensor of a file, or fit its light to pictures of ball presses and write it; no label is looked at.

    Raises
    ------
    ValueError
        If presses that the fit has not seen are predicted worse than by the unchanged reference.
    """
    if path.is_file():
        return Sensor.load(path)
    series = frames.take(np.flatnonzero(frames.columns["session"] == FITTED_SERIES))
    ball_radius_mm, with_dots = SERIES[FITTED_SERIES][1], series.references_at()[series.reference_id[0]]
    radius_px = _CONTACT_IN_RADII * ball_radius_mm / MM_PER_PX
    chosen = np.unique(np.linspace(0, len(series) - 1, FITTED_PRESSES).astype(int))
    pictures = [series.picture(number) for number in chosen]
    centers = np.array([level_point_px(picture, with_dots, radius_px) for picture in pictures])
    azimuths = light_azimuths(with_dots, pictures, centers, np.full(len(chosen), radius_px))
    listed = [
        PressPicture(
            inpaint_telea(picture, dots_of(picture)),
            2 * ball_radius_mm,
            radius_px=radius_px,
            center_px=tuple(center),
            marks_off_px=_MARKS_OFF_PX,
            name=f"press {number}",
        )
        for number, picture, center in zip(chosen, pictures, centers, strict=True)
    ]
    reference = inpaint_telea(with_dots, dots_of(with_dots))
    start = start_sensor(SIZE_PX[0], azimuths, MM_PER_PX)
    camera = start.camera.seen_from(FAR_MM, SIZE_PX).model_copy(update={"point_spread_px": _POINT_SPREAD_PX})
    start = start.model_copy(update={"camera": camera})
    fit = calibrate_light(start, reference, listed, sphere_profiles, keep_camera=True)
    save_calibration(replace(fit, sensor=fit.sensor.model_copy(update={"markers": DOTS})), path)
    unchanged, predicted = (
        np.median([getattr(press, kind)[0] for press in fit.held_out]) for kind in ("unchanged", "refined")
    )
    print(
        f"light fitted to {len(fit.names)} presses without their marks: {fit.rms_code_values:.1f} code values rms; "
        f"inside held-out contacts the unchanged reference has {unchanged:.1f} dB, the prediction {predicted:.1f} dB"
    )
    return Sensor.load(path)


def _farther(led: Led, factor: float) -> Led:
    """Return an LED that is as far out of a larger view as it was of its own sensor's, and as much larger."""
    sizes = {name: getattr(led, name) for name in ("length_mm", "height_mm", "diameter_mm")}
    larger = {name: factor * value for name, value in sizes.items() if value is not None}
    return led.model_copy(update={**larger, "position_mm": tuple(factor * side for side in led.position_mm)})


def contact_points(folders: Sequence[Path]) -> LabelledFrames:
    """Return the frames of data sets, with the contact point as their label."""
    return with_labels(join_domains([open_domain(folder) for folder in folders]), LABELS)


def press_recipes(
    domains: int, frames: int, presses: int, fitted: Sensor | None = None
) -> tuple[DomainRecipe, ...]:
    """Return `domains` domains of `frames` frames, from `presses` gels × balls, in drawn light or that of a sensor.

    They differ in nothing but the light from those in another light.
    """
    ranges = PretrainingRanges(**{**PretrainingRanges.default().model_dump(), **_RANGES, "presses": presses})
    recipes = pretraining_recipes(domains, frames, ranges, size_px=SYNTHETIC_PX)
    return tuple(_on_the_ball_sensor(recipe, fitted) for recipe in recipes)


def _on_the_ball_sensor(recipe: DomainRecipe, fitted: Sensor | None) -> DomainRecipe:
    drawn, light = recipe.sensor, recipe.illumination
    if fitted is None:
        factor = VIEW_MM[1] / Sensor.preset(drawn.name).camera.footprint_mm((4, 3))[0]
        light = light.model_copy(update={"leds": tuple(_farther(led, factor) for led in light.leds)})
        sensor = drawn.model_copy(update={"camera": drawn.camera.seen_from(FAR_MM, SYNTHETIC_PX)})
    else:
        light = fitted.illumination
        noise = {
            name: getattr(drawn.camera, name)
            for name in ("point_spread_px", "full_well_electrons", "read_noise_electrons")
        }
        camera = Camera(**{**fitted.camera.model_dump(), **noise})
        sensor = fitted.model_copy(update={"camera": camera, "illumination": None})
    dots = DOTS.model_copy(update={"seed": int(recipe.name.rpartition("-")[2])})
    path = PosePath(recipe.path.name, tuple(map(_farther_out, recipe.path.poses)))
    changed = {"sensor": sensor.model_copy(update={"markers": dots}), "illumination": light, "path": path}
    return recipe.model_copy(update=changed)


def _farther_out(pose: Pose) -> Pose:
    if not pose.depth_mm:
        return pose
    x, y = (round(_FARTHER_OUT * value, 4) for value in (pose.point_x_mm, pose.point_y_mm))
    return replace(pose, point_x_mm=x, point_y_mm=y)
