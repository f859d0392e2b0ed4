"""What a calibration says of itself: held-out error, the LEDs' directions with their uncertainty, and pictures."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from gelgap.render import HeldOut, LightCalibration, PressPicture, Sensor, SphereSize

DIFFERENCE_GAIN = 4
NEARLY_PARALLEL_MM = 200


def print_calibration(fit: LightCalibration) -> None:
    """Print how well the fit predicts presses that it has not seen, and what it found."""
    print(f"residual {fit.rms_code_values:.2f} code values rms over {len(fit.names)} presses")
    if fit.sphere_size is not None:
        _print_sphere_size(fit.sphere_size)
    if fit.left_out:
        print(f"left out, since no fit explains them: {', '.join(fit.left_out)}")
    if fit.held_out:
        print(
            f"held out, {len(fit.held_out)} presses each predicted by a fit without it; PSNR in dB, median (worst):"
        )
        print(f"  {'unchanged reference':32s} {_scores(fit.held_out, 'unchanged')}")
        print(f"  {'predicted, press as marked':32s} {_scores(fit.held_out, 'marked')}")
        print(f"  {'predicted, marks corrected':32s} {_scores(fit.held_out, 'corrected')}")
        print(f"  {'predicted, press refined':32s} {_scores(fit.held_out, 'refined')}")
    for line in _found(fit):
        print(line)


def described(fit: LightCalibration) -> Sensor:
    """Return the fitted sensor with what the fit says of itself as `known`, and what it cannot say as `assumed`."""
    known = [f"Fitted to pictures of {len(fit.names)} presses, {fit.rms_code_values:.2f} code values rms"]
    if fit.held_out:
        known += [
            f"held out, PSNR in dB, median (worst), as marked {_scores(fit.held_out, 'marked')}",
            f"marks corrected {_scores(fit.held_out, 'corrected')}",
            f"refined {_scores(fit.held_out, 'refined')}",
        ]
    assumed = "Sizes and distances of LEDs, of which pictures hold the direction; the gel around the presses; noise."
    return fit.sensor.model_copy(
        update={"known": "; ".join([*known, *_found(fit)]) + ".", "assumed": assumed}
    )


def _found(fit: LightCalibration) -> list[str]:
    """Return a line for each thing that was fitted, with its standard error where that is known."""
    leds = zip(fit.sensor.illumination.leds, fit.led_azimuths_deg, fit.led_elevations_deg, strict=True)
    lines = [
        f"LED {led.name or '?'}: azimuth {_with_error(azimuth)}°, elevation {_with_error(elevation)}°"
        for led, azimuth, elevation in leds
    ]
    distance_mm = -fit.sensor.camera.position_mm[2]
    error_mm = distance_mm**2 * fit.nearness_error_per_mm
    parallel = ", nearly parallel" if distance_mm > NEARLY_PARALLEL_MM else ""
    lines.append(f"camera {_with_error(np.array([distance_mm, error_mm]))} mm from the gel{parallel}")
    depths = fit.poses_mm[:, 2]
    lines.append(f"presses {depths.min():.2f}…{depths.max():.2f} mm deep, mean {depths.mean():.2f} mm")
    return lines


def _print_sphere_size(size: SphereSize) -> None:
    tried = zip(size.tried_mm, size.rms_code_values, strict=True)
    print(
        f"sphere of {size.diameter_mm:.2f} mm, between {size.interval_mm[0]:.2f} and {size.interval_mm[1]:.2f} mm; "
        "code values rms by diameter: " + ", ".join(f"{diameter:.2f}: {rms:.1f}" for diameter, rms in tried)
    )


def _scores(held_out: Sequence[HeldOut], kind: str) -> str:
    values = np.array([getattr(press, kind) for press in held_out])
    inside, ring = (f"{np.median(v):.1f} ({v.min():.1f})" for v in values.T)
    return f"inside the contact {inside}, from one to two radii {ring}"


def _with_error(value: np.ndarray) -> str:
    return f"{value[0]:.0f}" if np.isnan(value[1]) else f"{value[0]:.0f} ± {value[1]:.0f}"


def write_comparisons(fit: LightCalibration, presses: Sequence[PressPicture], folder: Path) -> None:
    """Write a picture of each held-out press: real, predicted, and 128 plus four times the difference."""
    folder.mkdir(parents=True, exist_ok=True)
    by_name = {press.name or f"press {number}": press for number, press in enumerate(presses, start=1)}
    for number, held_out in enumerate(fit.held_out, start=1):
        real = by_name[held_out.name].picture
        difference = 128 + DIFFERENCE_GAIN * (held_out.picture.astype(float) - real)
        row = np.hstack([real, held_out.picture, np.clip(difference, 0, 255).astype(np.uint8)])
        path = folder / f"held-out-{number:02d}.png"
        if not cv2.imwrite(str(path), row[..., ::-1]):
            raise RuntimeError(f"{path} could not be written")
    print(f"wrote {len(fit.held_out)} comparisons to {folder}")
