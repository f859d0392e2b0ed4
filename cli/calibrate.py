"""`gelgap calibrate`: fit a sensor's light to pictures of a real one."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated

import tyro

from gelgap import render
from gelgap.assets.names import comma_list
from gelgap.cli import options as opt

if TYPE_CHECKING:
    import numpy as np

    from gelgap.calibrate.pictures import PressPicture

LOG = logging.getLogger(__name__)
FOLDS = 3
"""Of the cross-validation: presses of each are predicted by a fit without them."""


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
        from gelgap.calibrate import report
        from gelgap.calibrate.calibrator import calibrate_light
        from gelgap.calibrate.membranes import sphere_profiles
        from gelgap.calibrate.pictures import check_presses
        from gelgap.calibrate.sensor_file import save_calibration
        from gelgap.calibrate.start import lit_from_dents

        if self.predict:
            self._predict()
            return
        sensor, reference, presses = self._inputs()
        if sensor.illumination is None:
            check_presses(reference, presses)
            sensor = lit_from_dents(sensor, reference, presses)
        if doubt := report.doubt_of_scale(sensor.camera, presses):
            LOG.warning(doubt)
        fit = calibrate_light(
            sensor,
            reference,
            presses,
            lambda diameters, deepest: sphere_profiles(diameters, deepest, self.quality),
            folds=FOLDS,
        )
        fitted = save_calibration(report.described(fit), self.out)
        print(f"wrote {self.out} and {fitted.flat_field.file}")
        print("\n".join(report.report_lines(fit)))
        for warning in report.warnings_of(fit):
            LOG.warning(warning)
        folder = self.out.with_name(f"{self.out.stem}-held-out")
        report.write_comparisons(report.held_out_pairs(fit, presses), folder, "held-out")

    def _predict(self) -> None:
        from gelgap.calibrate import report
        from gelgap.calibrate.prediction import predict_presses

        if self.sensor is None:
            raise ValueError("--predict needs --sensor, the fit")
        if self.mm_per_px is not None and not self.presses.is_dir():
            raise ValueError("--predict takes the scale from the fit: leave out --mm-per-px")
        path = self._marked() if self.presses.is_dir() else self.presses
        sensor = render.Sensor.named(self.sensor)
        predicted = predict_presses(sensor, path, self.reference, self.quality)
        print("\n".join(report.prediction_lines(predicted)))
        without = [press.name for press in predicted if not press.has_residual]
        if sensor.ball_residual is not None and without:
            others = comma_list(without)
            print(f"without what the fit left around its ball, as of another body, size or depth: {others}")
        report.write_comparisons(
            [(press.real, press.picture) for press in predicted],
            self.out.with_name(f"{self.out.stem}-predicted"),
            "predicted",
        )

    def _inputs(self) -> "tuple[render.Sensor, np.ndarray, tuple[PressPicture, ...]]":
        from gelgap.calibrate.taxim_sets import NAMES, PACK, taxim_presses

        if str(self.presses) in NAMES or (self.presses / PACK).is_file():
            if self.reference:
                raise ValueError(f"{self.presses} brings its own reference; leave out --reference")
            press_set = taxim_presses(str(self.presses), self.mm_per_px)
            start, reference, presses = press_set.start, press_set.reference, press_set.presses
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
        marked = mark_presses(self.presses, self.ball_mm, self.mm_per_px, self.reference)
        print(f"wrote {marked.path} with {marked.count} presses; look at {self.presses / SHEET}")
        if marked.without_contact:
            print(f"without contact: {comma_list(marked.without_contact)}")
        for doubt in marked.doubts:
            LOG.warning("%s: %s", self.presses, doubt)
        return marked.path

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
