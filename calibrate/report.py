"""What is told of a calibration: how it predicts, what it found, what to doubt, and comparisons to look at."""

from collections.abc import Sequence
from dataclasses import replace
from math import atan2, degrees
from pathlib import Path
from statistics import median

import numpy as np

from gelgap.assets.whole_file import write_whole
from gelgap.calibrate.calibrator import DOUBTFUL_RMS
from gelgap.calibrate.pictures import PressPicture, press_names
from gelgap.calibrate.prediction import PredictedPress
from gelgap.calibrate.sensor_file import LightCalibration
from gelgap.data.formats.pictures import encode_png
from gelgap.render.imaging import Camera, difference_picture

HELD_OUT = {
    "unchanged": "unchanged reference",
    "table": "table of normals alone",
    "marked": "predicted, press as marked",
    "refined": "predicted, press refined",
}
ASSUMED = "Sizes and distances of LEDs, whose direction pictures hold; the gel around the presses; noise."
DIFFERENCE_GAIN = 4
# Contacts in balls' diameters: 0.62 to 0.9 in the published sets; 0.33 to 0.53 with a ball or scale off by two.
LEAST_CONTACT = 0.55
NEARLY_PARALLEL_MM = 200


def described(fit: LightCalibration) -> LightCalibration:
    """Return a fit whose sensor says what is known of it and what assumed."""
    known = "; ".join(line.strip().rstrip(":") for line in report_lines(fit))
    update = {"known": f"Fitted to pictures: {known}.", "assumed": ASSUMED}
    return replace(fit, sensor=fit.sensor.model_copy(update=update))


def doubt_of_scale(camera: Camera, presses: Sequence[PressPicture]) -> str | None:
    """Return what to think of where balls touch in small circles for their size, which no fit finds wrong."""
    height_px, width_px, _ = presses[0].picture.shape
    width_mm, height_mm = camera.footprint_mm((width_px, height_px))
    shares = [
        2 * press.radius_px * width_mm / width_px / press.sphere_diameter_mm
        for press in presses
        if press.radius_px and press.sphere_diameter_mm and not press.has_rough_marks
    ]
    if not shares or (share := median(shares)) >= LEAST_CONTACT:
        return None
    return (
        f"the ball touches in circles {share:.2f} times as wide as itself, and a picture shows {width_mm:.1f} × "
        f"{height_mm:.1f} mm of the gel: if that is not so, --ball-mm or --mm-per-px is wrong, which pictures do not "
        f"tell; if it is, press deeper, to {LEAST_CONTACT:g} times or more: light on steeper gel is not seen"
    )


def report_lines(fit: LightCalibration) -> list[str]:
    """Return how well a fit predicts presses that it has not seen, and what it found."""
    lines = [f"residual {fit.rms_code_values:.2f} code values rms over {len(fit.names)} presses"]
    height_px, width_px, _ = fit.maps.ratio.shape
    width_mm, height_mm = fit.sensor.camera.footprint_mm((width_px, height_px))
    lines.append(
        "scale and ball are taken on trust, since pictures of one ball hold neither: "
        f"{width_mm / width_px:.4g} mm per px, {width_mm:.1f} × {height_mm:.1f} mm in view"
    )
    if fit.left_out:
        lines.append(f"left out, since no fit explains them: {', '.join(fit.left_out)}")
    lines.append(
        f"held out, {len(fit.held_out)} presses each predicted by a fit without it; PSNR in dB, median (worst):"
    )
    share = fit.sensor.table_share
    around = "" if fit.sensor.ball_residual is None else ", and what both leave around this ball"
    lines.append(f"  predicts with {1 - share:.0%} modelled light, {share:.0%} table of normals{around}")
    for kind, what in HELD_OUT.items():
        by_region = zip(*(getattr(press, kind) for press in fit.held_out), strict=True)
        inside, ring = (f"{median(levels):.1f} ({min(levels):.1f})" for levels in by_region)
        lines.append(f"  {what:32s} inside the contact {inside}, from one to two radii {ring}")
    lines.append(f"  the press that gains least: {_worst(fit)[1]}")
    if len(fit.levels):
        low, high = fit.levels.min(), fit.levels.max()
        lines.append(f"brightness far from the contacts {low:.2f}…{high:.2f} of the reference's, taken out")
    if fit.has_dots:
        lines.append("dots are left out of the fit and of these figures; predictions move them with the gel")
    places = [(led.name or "?", *led.position_mm[:2]) for led in fit.sensor.illumination.leds]
    sides = ", ".join(f"{name} {round(degrees(atan2(y, x)), -1) % 360:.0f}°" for name, x, y in places)
    lines.append(
        f"light from about {sides} (0° right, 90° down); pictures hold an LED's direction to 8 to 20°, its size and "
        "distance hardly"
    )
    distance_mm = -fit.sensor.camera.position_mm[2]
    parallel = ", nearly parallel" if distance_mm > NEARLY_PARALLEL_MM else ""
    blur_px = fit.sensor.camera.point_spread_px
    blur = f"point spread {blur_px:.1f} px of a picture 320 px wide" if blur_px else "sharp"
    lines.append(f"camera about {distance_mm:.0f} mm from the gel{parallel}, {blur}")
    depths = fit.poses_mm[:, 2]
    if fit.at_limits:
        lines.append(f"at an end of the range searched, so it may lie beyond: {', '.join(fit.at_limits)}")
    lines.append(f"presses {depths.min():.2f}…{depths.max():.2f} mm deep, mean {depths.mean():.2f} mm")
    return lines


def prediction_lines(presses: Sequence[PredictedPress]) -> list[str]:
    """Return a table of presses that a fit predicts, with the median and the worst beside the unchanged reference."""
    scored = [press for press in presses if press.real is not None]
    if not scored:
        return [f"{len(presses)} presses drawn; none has a picture to be compared with"]
    gains = [np.subtract(press.predicted, press.unchanged) for press in scored]
    of_what = {"predicted": "predicted", "table": "table of normals", "unchanged": "unchanged reference"}
    kinds = [kind for kind in of_what if getattr(scored[0], kind) is not None]
    rows = [(press.name, *(level for kind in kinds for level in getattr(press, kind))) for press in scored]
    levels = np.array([row[1:] for row in rows])
    medians = np.median(levels, axis=0)
    rows += [("median", *medians), ("lowest", *levels.min(axis=0))]
    what = "PSNR in dB: inside, around"
    width = max(len(what), *(len(name) for name, *_ in rows))
    lines = [f"{what:{width + 2}s}" + "".join(f"{of_what[kind]:>22s}" for kind in kinds)]
    for name, *values in rows:
        pairs = zip(values[::2], values[1::2], strict=True)
        lines.append(f"  {name:{width}s}" + "".join(f"{inside:14.1f}{ring:8.1f}" for inside, ring in pairs))
    worst = min(range(len(scored)), key=lambda number: gains[number].min())
    where = ("inside", "around")[int(gains[worst].argmin())]
    lines.append(
        f"the press that gains least: {scored[worst].name}, {gains[worst].min():+.1f} dB {where} its contact"
    )
    if (medians[:2] < medians[-2:]).any():
        lines.append("in the median worse than doing nothing (unchanged): is it this sensor's fit?")
    return lines


def warnings_of(fit: LightCalibration) -> list[str]:
    """Return what to think of before such a fit is used."""
    warnings = []
    if fit.rms_code_values > DOUBTFUL_RMS:
        warnings.append(
            f"a residual of {fit.rms_code_values:.2f} code values is not a good fit (above {DOUBTFUL_RMS:g}): check "
            "that no pictures are mirrored or have red and blue exchanged, diameters, scale and, among few presses, "
            "the picture of each, since one can spoil the fit"
        )
    if _worst(fit)[0] < 0:
        warnings.append(
            f"a press is predicted worse than by the unchanged reference: {_worst(fit)[1]}; look at its picture among "
            "those of the held-out presses, and mark it anew or leave it out of the list"
        )
    return warnings


def _worst(fit: LightCalibration) -> tuple[float, str]:
    """Return by how many dB the worst held-out press is better than the unchanged reference, and in words which."""
    gains = []
    for press in fit.held_out:
        for where, marked, unchanged in zip(("inside", "around"), press.marked, press.unchanged, strict=True):
            said = f"{press.name}, {where} its contact {marked:.1f} dB (unchanged reference {unchanged:.1f})"
            gains.append((marked - unchanged, said))
    return min(gains)


def held_out_pairs(
    fit: LightCalibration, presses: Sequence[PressPicture]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return each held-out press's picture, and what was predicted of it."""
    pictures = {name: press.picture for name, press in zip(press_names(presses), presses, strict=True)}
    return [(pictures[press.name], press.picture) for press in fit.held_out]


def write_comparisons(pairs: Sequence[tuple[np.ndarray | None, np.ndarray]], folder: Path, kind: str) -> None:
    """Write a picture of each press: real, predicted, and 128 plus four times the difference; or predicted alone."""
    for number, (real, predicted) in enumerate(pairs, start=1):
        shown = predicted
        if real is not None:
            shown = np.hstack([real, predicted, difference_picture(predicted, real, DIFFERENCE_GAIN)])
        write_whole(folder / f"{kind}-{number:02d}.png", encode_png(shown))
    print(f"wrote {len(pairs)} comparisons to {folder}")
