"""`gelgap calibrate`: fit a sensor's light to pictures of a real one."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import tyro

from gelgap.cli.arguments import Flag, load_sensor, optional
from gelgap.cli.rules import Between, InputFile, OutputFile, OutputFolder, Preset, TaximPackage

if TYPE_CHECKING:
    import numpy as np

    from gelgap.render import PressPicture, Sensor

KNOWN_FIELDS = (
    *("picture", "sphere_diameter_mm", "depth_mm", "radius_px", "marks_off_px"),
    *("point_mm", "center_px"),
)

FEWEST_PRESSES = 3
# A fit from a right start leaves 1 to 2 code values, camera noise included; one from a wrong start ten times as much.
DOUBTFUL_RMS_CODE_VALUES = 5.0


@dataclass(frozen=True)
class Calibrate:
    """Fit LEDs, scattered light and flat field to a reference picture and pictures of pressed spheres.

    PRESSES is a TOML file with one table per picture; give six presses or more, better 24, spread over the view:

      [[presses]]
      picture = "press-1.png"        # beside the TOML file
      sphere_diameter_mm = 3.0
      depth_mm = 0.6                 # or radius_px = 61: how large the imprint is
      point_mm = [1.5, -0.8]         # or center_px = [200, 110]; optional: found in the picture otherwise
      marks_off_px = 20              # how far radius_px and center_px may be off; 3 if left out

    A sphere whose diameter no press has is fitted, if the pictures hold it.
    Prints how presses that a fit has not seen are predicted; one that is worse than the unchanged reference is refused.

    For example:
      gelgap calibrate presses.toml --reference ref.png --sensor start.toml -o fitted.toml
    """

    when_stopped: ClassVar[str] = "nothing was written; run the same command again to start over"

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"]), OutputFile((".toml",))]
    """The sensor TOML to write; its flat field and pictures of held-out presses come to lie beside it."""
    presses: Annotated[tyro.conf.Positional[Path | None], optional("PRESSES"), InputFile("a TOML file")] = (
        None
    )
    """TOML file that lists the pictures of pressed spheres."""
    reference: Annotated[Path | None, optional("PATH"), InputFile("a picture")] = None
    """Picture without contact."""
    sensor: Annotated[str | None, optional("NAME"), Preset("sensors")] = None
    """Where the fit starts: a sensor preset or TOML file with its own LEDs, each within 30° of its direction."""
    from_taxim: Annotated[str | None, optional("NAME"), TaximPackage()] = None
    """Instead of all these: gelsight or gelsight_mini of the package taxim, or a folder with such a dataPack.npz."""
    mm_per_px: Annotated[float | None, optional("MM"), Between(0.001, 1)] = None
    """With --from-taxim: how much of the gel a pixel shows; 0.0295 if left out, as those packages say."""
    sphere_diameter_mm: Annotated[float | None, optional("MM"), Between(0.5, 50)] = None
    """The sphere's diameter in all presses, whatever the list or the package says."""
    pictures: Annotated[Path | None, optional("FOLDER"), OutputFolder()] = None
    """Where the held-out presses are shown: real, predicted, four times their difference; default: NAME-held-out."""
    held_out_parts: Annotated[int, Between(0, 24)] = 3
    """Into how many parts the presses are divided, each predicted by a fit without it; 0: none is held out."""
    keep_camera: Flag = False
    """Leave the camera where the sensor has it; otherwise its distance is fitted, as far as seems parallel."""
    membrane_quality: Literal["draft", "standard", "fine"] = "draft"
    """How finely the membrane around the spheres is solved."""
    leds_only: Flag = False
    """Fit levels and positions of the LEDs alone, each within 6 mm of its place; three presses do."""
    fit_gloss: Flag = False
    """With --leds-only, which it implies: fit the weight of the coat's gloss as well."""

    def run(self, started: float) -> None:
        """Fit and write the sensor."""
        if self.held_out_parts == 1:
            raise ValueError("held_out_parts = 1: must be 0, or 2 to 24")
        sensor, reference, presses = self._inputs()
        if self.leds_only or self.fit_gloss:
            self._fit_leds(sensor, reference, presses)
        else:
            self._fit_light(sensor, reference, presses)

    def _inputs(self) -> "tuple[Sensor, np.ndarray, tuple[PressPicture, ...]]":
        if self.from_taxim is not None:
            from gelgap.domains import taxim_presses

            if self.presses or self.reference:
                raise ValueError(
                    "from_taxim brings its own presses and reference; leave out PRESSES and --reference"
                )
            found = taxim_presses(self.from_taxim, self.mm_per_px)
            start = load_sensor(self.sensor) if self.sensor else found.start
            return start, found.reference, self._with_sphere(found.presses)
        if not (self.presses and self.reference and self.sensor):
            raise ValueError("calibrate needs PRESSES, --reference and --sensor, or --from-taxim instead")
        presses = self._with_sphere(read_presses(self.presses))
        return load_sensor(self.sensor), read_picture(self.reference), presses

    def _with_sphere(self, presses: "tuple[PressPicture, ...]") -> "tuple[PressPicture, ...]":
        """Return the presses with the sphere that was given for all, if one was."""
        if self.sphere_diameter_mm is None:
            return presses
        return tuple(replace(press, sphere_diameter_mm=self.sphere_diameter_mm) for press in presses)

    def _fit_leds(self, sensor, reference, presses) -> None:
        from gelgap.render import calibrate, save_sensor

        if len(presses) < FEWEST_PRESSES:
            raise ValueError(
                f"{self.presses} lists {len(presses)} presses; LED positions need {FEWEST_PRESSES} or more, apart from "
                "each other"
            )
        fit = calibrate(sensor, reference, presses, fit_gloss=self.fit_gloss)
        save_sensor(fit.sensor, self.output)
        points = ", ".join(f"({x:.2f}, {y:.2f})" for x, y in fit.press_points_mm)
        print(
            f"wrote {self.output}; residual {fit.rms_code_values:.2f} code values rms; presses at {points} mm"
        )
        if fit.rms_code_values > DOUBTFUL_RMS_CODE_VALUES:
            print(
                f"gelgap: warning: a residual of {fit.rms_code_values:.2f} code values is not a good fit (above "
                f"{DOUBTFUL_RMS_CODE_VALUES:g}): check where the LEDs of {self.sensor} start, each within 6 mm of its "
                "place, and the depths and points of the presses",
                file=sys.stderr,
            )

    def _fit_light(self, sensor, reference, presses) -> None:
        from gelgap.cli.workflows.calibration_report import described, print_calibration, write_comparisons
        from gelgap.domains import sphere_profiles
        from gelgap.render import calibrate_light, save_calibration

        fit = calibrate_light(
            sensor,
            reference,
            presses,
            lambda diameters, deepest: sphere_profiles(diameters, deepest, self.membrane_quality),
            keep_camera=self.keep_camera,
            folds=self.held_out_parts,
        )
        fit = replace(fit, sensor=described(fit))
        fitted = save_calibration(fit, self.output)
        print(f"wrote {self.output} and {fitted.flat_field.file}")
        print_calibration(fit)
        if fit.rms_code_values > DOUBTFUL_RMS_CODE_VALUES:
            print(
                f"gelgap: warning: a residual of {fit.rms_code_values:.2f} code values is not a good fit (above "
                f"{DOUBTFUL_RMS_CODE_VALUES:g}): check the LEDs' directions, the spheres' diameters and, among few "
                "presses, the picture of each, since one can spoil the fit",
                file=sys.stderr,
            )
        if fit.held_out:
            folder = self.pictures or self.output.with_name(f"{self.output.stem}-held-out")
            write_comparisons(fit, presses, folder)


def read_presses(path: Path) -> "tuple[PressPicture, ...]":
    """Read the list of presses and their pictures.

    Raises
    ------
    FileNotFoundError
        If the list or a picture does not exist.
    ValueError
        If the list is not valid TOML, or a table lacks a field or has an unknown one.
    """
    from gelgap.assets.names import stays_inside
    from gelgap.assets.toml_file import read_toml
    from gelgap.render import PressPicture

    presses = []
    tables = read_toml(path).get("presses", [])
    if not isinstance(tables, list):
        raise ValueError(f"{path}: presses must be tables [[presses]]")
    for number, table in enumerate(tables, start=1):
        if not isinstance(table, dict):
            raise ValueError(f"{path}, press {number}: must be a table [[presses]]")
        needed = {"picture"} | (set() if "radius_px" in table else {"depth_mm", "sphere_diameter_mm"})
        wrong = (needed - table.keys()) | (table.keys() - set(KNOWN_FIELDS))
        if wrong:
            raise ValueError(
                f"{path}, press {number}: {', '.join(sorted(wrong))} missing or unknown; a press has picture, "
                "sphere_diameter_mm, depth_mm or radius_px and, if known, point_mm or center_px and marks_off_px"
            )
        if not isinstance(table["picture"], str) or not stays_inside(table["picture"]):
            raise ValueError(
                f"{path}, press {number}: picture = {table['picture']!r} must lie in the folder of the list"
            )
        for field in set(table) - {"picture"}:
            _check_numbers(
                f"{path}, press {number}: {field}", table[field], 2 if field in KNOWN_FIELDS[5:] else 1
            )
        places = {field: tuple(table[field]) for field in ("point_mm", "center_px") if field in table}
        sizes = {f: table[f] for f in ("depth_mm", "radius_px", "marks_off_px") if f in table}
        picture = read_picture(path.parent / table["picture"])
        name = f"press {number} ({table['picture']})"
        presses.append(PressPicture(picture, table.get("sphere_diameter_mm"), name=name, **sizes, **places))
    return tuple(presses)


def _check_numbers(what: str, value: object, count: int) -> None:
    values = value if isinstance(value, list) else [value]
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) and abs(v) < 1e6 for v in values)
    if not numbers or len(values) != count or isinstance(value, list) != (count > 1):
        raise ValueError(
            f"{what} is {value!r}; it must be {'a finite number' if count == 1 else 'two finite numbers'}"
        )


def read_picture(path: Path) -> "np.ndarray":
    """Return a picture as uint8 (h, w, 3) RGB.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a picture.
    """
    import cv2

    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist or is not a file; a picture is needed")
    picture = cv2.imread(str(path))
    if picture is None:
        raise ValueError(f"{path} is not a picture that OpenCV can read")
    return picture[..., ::-1].copy()
