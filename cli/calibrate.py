"""`gelgap calibrate`: fit a sensor's light to pictures of a real one."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import atan2, degrees
from pathlib import Path
from statistics import median
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated

import tyro

from gelgap import render
from gelgap.assets.names import comma_list
from gelgap.assets.whole_file import write_whole
from gelgap.cli import options as opt

if TYPE_CHECKING:
    import numpy as np

    from gelgap.calibrate.calibrator import LightCalibration
    from gelgap.calibrate.pictures import PressPicture
    from gelgap.calibrate.prediction import PredictedPress

LOG = logging.getLogger(__name__)
HELD_OUT = {
    "unchanged": "unchanged reference",
    "table": "table of normals alone",
    "marked": "predicted, press as marked",
    "refined": "predicted, press refined",
}
ASSUMED = "Sizes and distances of LEDs, whose direction pictures hold; the gel around the presses; noise."
FOLDS = 3
"""Of the cross-validation: presses of each are predicted by a fit without them."""
DIFFERENCE_GAIN = 4
# Contacts in balls' diameters: 0.62 to 0.9 in the published sets; 0.33 to 0.53 with a ball or scale off by two.
LEAST_CONTACT = 0.55
NEARLY_PARALLEL_MM = 200


def check_mm_per_px(value: float) -> None:
    """Raise ValueError for a scale that is none; pixels per mm, which other programs ask for, are more than 1."""
    if value > 1:
        raise ValueError(f"must lie in [0.001, 1]; {value:g} pixels per mm are {1 / value:.3g} mm per pixel")
    opt.between(0.001, 1, "mm per pixel")(value)


@dataclass(frozen=True)
class Calibrate(opt.Command):
    """Fit LEDs, scattered light and flat field to a reference picture and pictures of pressed spheres.

    PRESSES is a folder of pictures, or videos, of a pressed ball and of the gel at rest: the presses are marked,
    and written to presses.toml there, with presses-sheet.png to check them. Or it is such a TOML file, with one table
    per picture; give six presses or more, better 24, spread over the view:

      [[presses]]
      picture = "press-1.png"        # beside the TOML file
      sphere_diameter_mm = 3.0
      depth_mm = 0.6                 # or radius_px = 61: how large the imprint is
      point_mm = [1.5, -0.8]         # or center_px = [200, 110]; optional: found in the picture otherwise
      marks_off_px = 20              # how far radius_px and center_px may be off; 3 if left out

    depth_mm is how far the sphere was pressed in after it touched. radius_px is the circle in which gel touches it;
    what depth that takes is solved, since gel sinks in around a sphere: the depth by geometry is too small.

    Measure ball and scale: pictures hold neither. LEDs are found in the dents and fitted
    together with all else. Prints how presses that a fit has not seen are predicted as marked; a fit that is worse than
    the unchanged reference, inside or around the contact, is refused.

    For example:
      gelgap calibrate ball-pictures --ball-mm 4 --mm-per-px 0.12 -o fitted.toml
      gelgap calibrate presses.toml --reference ref.png --mm-per-px 0.03 -o fitted.toml
      gelgap calibrate boxes.toml --predict --sensor fitted.toml -o boxes.toml

    With --predict a press may be of another body: indenter = "box.toml", a file beside the list, or a preset, instead
    of sphere_diameter_mm, with depth_mm, a place, and perhaps turn_deg = [0, 0, 30] and shear_mm = [0.3, 0]; and it
    needs no picture.
    """

    former = MappingProxyType(
        {
            "--sphere-diameter-mm": opt.Former("0.3.0", "write --ball-mm, which is a diameter, too"),
            "--keep-camera": opt.Former("0.3.0", "in Python, calibrate_light(keep_camera=True)"),
            "--held-out-parts": opt.Former("0.3.0", "presses are always held out in three parts"),
        }
    )

    presses: tyro.conf.Positional[Path]
    """Folder of pictures or videos; or a TOML file that lists pictures of pressed spheres; or gelsight or
    gelsight_mini, calibration pictures of the package taxim, or a folder with such a dataPack.npz."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"]), opt.OutputFile(".toml")] = Path("fitted.toml")
    """The sensor TOML to write; its flat field and pictures of held-out presses come to lie beside it. With --predict
    only pictures are written, to a folder of its name with -predicted."""
    reference: Annotated[Path | None, opt.optional("PATH", "the list's, folder's or package's")] = None
    """Picture without contact."""
    sensor: Annotated[str | None, opt.optional("NAME")] = None
    """Where the fit starts, instead of --mm-per-px: a sensor preset or TOML file; its LEDs within 30°, or none. With
    --predict, the fit."""
    mm_per_px: Annotated[float | None, opt.optional("MM"), check_mm_per_px] = None
    """How much of the gel a pixel shows. Left out, as the list says; of taxim 0.0295, as it says."""
    ball_mm: Annotated[float | None, opt.optional("MM"), opt.between(0.5, 50)] = None
    """The ball's diameter in all presses, whatever the list or the package says; a folder needs it."""
    predict: opt.Flag = False
    """Fit nothing: draw the presses with --sensor, a fit, and compare them with their pictures, if they have any."""
    quality: opt.Quality = "draft"
    """How finely the membrane around the spheres is solved."""

    def run(self, started: float) -> None:
        """Fit and write the sensor."""
        from gelgap.calibrate.calibrator import calibrate_light, save_calibration
        from gelgap.calibrate.membranes import lit_from_dents, sphere_profiles
        from gelgap.calibrate.pictures import check_presses

        if self.predict:
            self._predict()
            return
        sensor, reference, presses = self._inputs()
        if sensor.illumination is None:
            check_presses(reference, presses)
            sensor = lit_from_dents(sensor, reference, presses)
        if doubt := doubt_of_scale(sensor.camera, presses):
            LOG.warning(doubt)
        fit = calibrate_light(
            sensor,
            reference,
            presses,
            lambda diameters, deepest: sphere_profiles(diameters, deepest, self.quality),
            folds=FOLDS,
        )
        report = report_lines(fit)
        known = "; ".join(line.strip().rstrip(":") for line in report)
        named = fit.sensor.model_copy(update={"known": f"Fitted to pictures: {known}.", "assumed": ASSUMED})
        fitted = save_calibration(replace(fit, sensor=named), self.out)
        print(f"wrote {self.out} and {fitted.flat_field.file}")
        print("\n".join(report))
        for warning in warnings_of(fit):
            LOG.warning(warning)
        folder = self.out.with_name(f"{self.out.stem}-held-out")
        write_comparisons(held_out_pairs(fit, presses), folder, "held-out")

    def _predict(self) -> None:
        from gelgap.calibrate.prediction import predict_presses

        if self.sensor is None:
            raise ValueError("--predict needs --sensor, the fit")
        if self.mm_per_px is not None and not self.presses.is_dir():
            raise ValueError("--predict takes the scale from the fit: leave out --mm-per-px")
        path = self._marked() if self.presses.is_dir() else self.presses
        sensor = render.Sensor.named(self.sensor)
        found = predict_presses(sensor, path, self.reference, self.quality)
        print("\n".join(prediction_lines(found)))
        without = [press.name for press in found if not press.has_residual]
        if sensor.ball_residual is not None and without:
            others = comma_list(without)
            print(f"without what the fit left around its ball, as of another body, size or depth: {others}")
        write_comparisons(
            [(press.real, press.picture) for press in found],
            self.out.with_name(f"{self.out.stem}-predicted"),
            "predicted",
        )

    def _inputs(self) -> "tuple[render.Sensor, np.ndarray, tuple[PressPicture, ...]]":
        from gelgap.calibrate.membranes import NAMES, PACK, taxim_presses

        if str(self.presses) in NAMES or (self.presses / PACK).is_file():
            if self.reference:
                raise ValueError(f"{self.presses} brings its own reference; leave out --reference")
            found = taxim_presses(str(self.presses), self.mm_per_px)
            start, reference, presses = found.start, found.reference, found.presses
        else:
            start, reference, presses = self._listed(
                self._marked() if self.presses.is_dir() else self.presses
            )
        if self.sensor is not None:
            start = render.Sensor.named(self.sensor)
        if self.ball_mm is not None:
            presses = tuple(replace(press, sphere_diameter_mm=self.ball_mm) for press in presses)
        return start, reference, presses

    def _marked(self) -> Path:
        """Return the list of the presses that are found in a folder."""
        from gelgap.assets.image_file import SHEET
        from gelgap.calibrate.press_folder import mark_presses

        if self.ball_mm is None or self.mm_per_px is None:
            raise ValueError(
                f"{self.presses} is a folder: to mark its presses, calibrate needs --ball-mm, the ball's diameter, and "
                "--mm-per-px"
            )
        opt.output_folder(self.presses)
        found = mark_presses(self.presses, self.ball_mm, self.mm_per_px, self.reference)
        print(f"wrote {found.path} with {found.count} presses; look at {self.presses / SHEET}")
        if found.without_contact:
            print(f"without contact: {comma_list(found.without_contact)}")
        for doubt in found.doubts:
            LOG.warning("%s: %s", self.presses, doubt)
        return found.path

    def _listed(self, path: Path) -> "tuple[render.Sensor, np.ndarray, tuple[PressPicture, ...]]":
        from gelgap.assets.image_file import read_image
        from gelgap.calibrate.pictures import read_press_list

        listed = read_press_list(path)
        reference = self.reference or (path.parent / listed.reference if listed.reference else None)
        mm_per_px = self.mm_per_px or (listed.mm_per_px if self.sensor is None else None)
        if reference is None or (self.sensor is None) == (mm_per_px is None):
            raise ValueError(f"{path}: a press list needs --reference, and either --mm-per-px or --sensor")
        presses, picture = listed.pictures(path.parent), read_image(reference)
        camera = render.Camera.showing(picture.shape[1] * mm_per_px) if mm_per_px else render.Camera()
        start = render.Sensor(name=self.out.stem, camera=camera, markers=render.Markers(layout="none"))
        return start, picture, presses


def doubt_of_scale(camera: "render.Camera", presses: "Sequence[PressPicture]") -> str | None:
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


def report_lines(fit: "LightCalibration") -> list[str]:
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


def prediction_lines(presses: "Sequence[PredictedPress]") -> list[str]:
    """Return a table of presses that a fit predicts, with the median and the worst beside the unchanged reference."""
    import numpy as np

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


def warnings_of(fit: "LightCalibration") -> list[str]:
    """Return what to think of before such a fit is used."""
    from gelgap.calibrate.calibrator import DOUBTFUL_RMS

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


def _worst(fit: "LightCalibration") -> tuple[float, str]:
    """Return by how many dB the worst held-out press is better than the unchanged reference, and in words which."""
    found = []
    for press in fit.held_out:
        for where, marked, unchanged in zip(("inside", "around"), press.marked, press.unchanged, strict=True):
            said = f"{press.name}, {where} its contact {marked:.1f} dB (unchanged reference {unchanged:.1f})"
            found.append((marked - unchanged, said))
    return min(found)


def held_out_pairs(
    fit: "LightCalibration", presses: "Sequence[PressPicture]"
) -> "list[tuple[np.ndarray, np.ndarray]]":
    """Return each held-out press's picture, and what was predicted of it."""
    from gelgap.calibrate.pictures import press_names

    pictures = {name: press.picture for name, press in zip(press_names(presses), presses, strict=True)}
    return [(pictures[press.name], press.picture) for press in fit.held_out]


def write_comparisons(
    pairs: "Sequence[tuple[np.ndarray | None, np.ndarray]]", folder: Path, kind: str
) -> None:
    """Write a picture of each press: real, predicted, and 128 plus four times the difference; or predicted alone."""
    import numpy as np

    from gelgap.data.formats.pictures import encode_png
    from gelgap.render.imaging import difference_picture

    for number, (real, predicted) in enumerate(pairs, start=1):
        shown = predicted
        if real is not None:
            shown = np.hstack([real, predicted, difference_picture(predicted, real, DIFFERENCE_GAIN)])
        write_whole(folder / f"{kind}-{number:02d}.png", encode_png(shown))
    print(f"wrote {len(pairs)} comparisons to {folder}")
