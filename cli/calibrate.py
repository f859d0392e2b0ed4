"""`gelgap calibrate`: fit a sensor's LEDs to pictures of a real one."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from gelgap.cli.arguments import Flag, SensorName, load_sensor
from gelgap.cli.rules import InputFile, OutputFile

if TYPE_CHECKING:
    import numpy as np

    from gelgap.render import PressPicture

FEWEST_PRESSES = 3
# A fit from a right start leaves 1 to 2 code values, camera noise included; one from a wrong start ten times as much.
DOUBTFUL_RMS_CODE_VALUES = 5.0


@dataclass(frozen=True)
class Calibrate:
    """Fit LED levels and positions, optionally the gloss, to a reference picture and pictures of pressed spheres.

    PRESSES is a TOML file with one table per picture; give three or more presses, apart from each other:

      [[presses]]
      picture = "press-1.png"        # beside the TOML file
      sphere_diameter_mm = 3.0
      depth_mm = 0.6
      point_mm = [1.5, -0.8]         # optional: found in the picture otherwise

    For example:
      gelgap calibrate presses.toml --reference ref.png --sensor start.toml -o fitted.toml
    """

    presses: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="PRESSES"), InputFile("a TOML file")]
    """TOML file that lists the pictures of pressed spheres."""
    reference: Annotated[Path, InputFile("a picture")]
    """Picture without contact."""
    sensor: SensorName
    """Where the fit starts: a sensor preset or TOML file with its own LEDs, each within 6 mm of its place."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"]), OutputFile((".toml",))]
    """The sensor TOML to write."""
    fit_gloss: Flag = False
    """Fit the weight of the coat's gloss as well."""

    def run(self, started: float) -> None:
        """Fit and write the sensor."""
        from gelgap.render import calibrate, save_sensor

        sensor, presses = load_sensor(self.sensor), read_presses(self.presses)
        if len(presses) < FEWEST_PRESSES:
            raise ValueError(
                f"{self.presses} lists {len(presses)} presses; LED positions need {FEWEST_PRESSES} or more, apart from "
                "each other"
            )
        fit = calibrate(sensor, read_picture(self.reference), presses, fit_gloss=self.fit_gloss)
        save_sensor(fit.sensor, self.output)
        points = ", ".join(f"({x:.2f}, {y:.2f})" for x, y in fit.press_points_mm)
        print(
            f"wrote {self.output}; residual {fit.rms_code_values:.2f} code values rms; presses at {points} mm"
        )
        if fit.rms_code_values > DOUBTFUL_RMS_CODE_VALUES:
            print(
                f"gelgap: warning: a residual of {fit.rms_code_values:.2f} code values is no good fit (above "
                f"{DOUBTFUL_RMS_CODE_VALUES:g}): check where the LEDs of {self.sensor} start, each within 6 mm of its "
                "place, and the depths and points of the presses",
                file=sys.stderr,
            )


def read_presses(path: Path) -> "tuple[PressPicture, ...]":
    """Read the list of presses and their pictures.

    Raises
    ------
    FileNotFoundError
        If the list or a picture does not exist.
    ValueError
        If the list is not valid TOML, or a table lacks a field or has an unknown one.
    """
    from gelgap.assets.toml_file import read_toml
    from gelgap.render import PressPicture

    presses = []
    for number, table in enumerate(read_toml(path).get("presses", []), start=1):
        known = {"picture", "sphere_diameter_mm", "depth_mm", "point_mm"}
        wrong = (known - {"point_mm"} - table.keys()) | (table.keys() - known)
        if wrong:
            raise ValueError(
                f"{path}, press {number}: {', '.join(sorted(wrong))} missing or unknown; a press has picture, "
                "sphere_diameter_mm, depth_mm and, if known, point_mm"
            )
        point = tuple(table["point_mm"]) if "point_mm" in table else None
        picture = read_picture(path.parent / table["picture"])
        presses.append(PressPicture(picture, table["sphere_diameter_mm"], table["depth_mm"], point))
    return tuple(presses)


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
