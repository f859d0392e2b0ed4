"""`gelgap calibrate`: fit a sensor's LEDs to pictures of a real one."""

import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

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

    when_stopped: ClassVar[str] = "nothing was written; run the same command again to start over"

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
    from gelgap.assets.plain_name import stays_inside
    from gelgap.assets.toml_file import read_toml
    from gelgap.render import PressPicture

    presses = []
    tables = read_toml(path).get("presses", [])
    if not isinstance(tables, list):
        raise ValueError(f"{path}: presses must be tables [[presses]]")
    for number, table in enumerate(tables, start=1):
        if not isinstance(table, dict):
            raise ValueError(f"{path}, press {number}: must be a table [[presses]]")
        known = {"picture", "sphere_diameter_mm", "depth_mm", "point_mm"}
        wrong = (known - {"point_mm"} - table.keys()) | (table.keys() - known)
        if wrong:
            raise ValueError(
                f"{path}, press {number}: {', '.join(sorted(wrong))} missing or unknown; a press has picture, "
                "sphere_diameter_mm, depth_mm and, if known, point_mm"
            )
        for field, length in {"sphere_diameter_mm": None, "depth_mm": None, "point_mm": 2}.items():
            if field in table and not _is_numeric(table[field], length):
                raise ValueError(
                    f"{path}, press {number}: {field} = {table[field]!r}: must be a number of mm"
                )
        point = tuple(table["point_mm"]) if "point_mm" in table else None
        if not isinstance(table["picture"], str) or not stays_inside(table["picture"]):
            raise ValueError(
                f"{path}, press {number}: picture = {table['picture']!r} must lie in the folder of the list"
            )
        picture = read_picture(path.parent / table["picture"])
        presses.append(PressPicture(picture, table["sphere_diameter_mm"], table["depth_mm"], point))
    return tuple(presses)


def _is_numeric(value: object, length: int | None) -> bool:
    """Return whether a value is a finite number, or a list of `length` of them."""
    if length is not None:
        return (
            isinstance(value, list) and len(value) == length and all(_is_numeric(one, None) for one in value)
        )
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


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
