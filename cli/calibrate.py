"""`gelgap calibrate`: fit a sensor's LEDs to pictures of a real one."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from gelgap.cli.arguments import Flag, load_sensor

if TYPE_CHECKING:
    import numpy as np

    from gelgap.render import PressPicture


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

    presses: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="PRESSES")]
    """TOML file that lists the pictures of pressed spheres."""
    reference: Path
    """Picture without contact."""
    sensor: str
    """Where the fit starts: a sensor preset or TOML file with its own LEDs, each within 6 mm of its place."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The sensor TOML to write."""
    fit_gloss: Flag = False
    """Fit the weight of the coat's gloss as well."""

    def run(self, started: float) -> None:
        """Fit and write the sensor."""
        from gelgap.render import calibrate, save_sensor

        if not self.output.parent.is_dir():
            raise FileNotFoundError(f"the folder of {self.output} does not exist; create it first")
        sensor = load_sensor(self.sensor)
        fit = calibrate(
            sensor, read_picture(self.reference), read_presses(self.presses), fit_gloss=self.fit_gloss
        )
        save_sensor(fit.sensor, self.output)
        points = ", ".join(f"({x:.2f}, {y:.2f})" for x, y in fit.press_points_mm)
        print(
            f"wrote {self.output}; residual {fit.rms_code_values:.2f} code values rms; presses at {points} mm"
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
        If there is no picture at the path.
    """
    import cv2

    picture = cv2.imread(str(path)) if path.is_file() else None
    if picture is None:
        raise FileNotFoundError(f"{path} does not exist or is not a picture")
    return picture[..., ::-1].copy()
