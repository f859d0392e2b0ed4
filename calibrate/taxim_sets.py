"""Published presses: sets of the package `taxim` (MIT), and folders of the same form.

A folder of a set holds `dataPack.npz` with f0 (h, w, 3), imgs (n, h, w, 3), touch_center (n, 2) as x and y in pixels,
and touch_radius (n,), marked by hand. Their channels are blue, green, red: the package's own renderer turns them over.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gelgap.assets.array_file import read_arrays
from gelgap.calibrate.pictures import PressPicture
from gelgap.calibrate.start import bars_at, light_azimuths
from gelgap.render import Camera, Coating, Markers, Sensor

NAMES = ("gelsight", "gelsight_mini")
PACK = "dataPack.npz"
MM_PER_PX = 0.0295
BALL_DIAMETER_MM = 4.0
# Marks of the Mini's set are off by up to 20 px and go round the whole dent; what its ball was is not said, and 1.4 mm
# assumed, as in the preset.
ROUGH_SETS, ROUGH_BALL_DIAMETER_MM = ("gelsight_mini",), 1.4
ROUGH_MARKS_OFF_PX = 20.0
# Their pictures are blurred: by how much was chosen by presses held out among the even ones.
ROUGH_POINT_SPREAD_PX = 1.7
INSTALL = "pip install --no-deps taxim==1.4.1"


@dataclass(frozen=True)
class PressSet:
    """A reference picture (h, w, 3) uint8 RGB, presses of one ball, and a sensor to start a calibration from."""

    reference: np.ndarray
    presses: tuple[PressPicture, ...]
    start: Sensor


def taxim_presses(name: str, mm_per_px: float | None = None) -> PressSet:
    """Read a set by its name in the installed package, or by its folder; its scale is 0.0295 mm per px if not given.

    Raises
    ------
    FileNotFoundError
        If the package is not installed, or there is no such folder.
    ValueError
        If `dataPack.npz` is not what it should be; nothing in it is executed.
    """
    folder = Path(name)
    package = find_spec("taxim") if name in NAMES else None  # looks it up without running any of it
    if package is not None and package.submodule_search_locations:
        folder = Path(package.submodule_search_locations[0]) / "calib" / name
    path = folder / PACK
    if not path.is_file():
        raise FileNotFoundError(
            f"{path} does not exist; give a folder with a dataPack.npz, or {' or '.join(NAMES)} where taxim is "
            f"installed ({INSTALL})"
        )
    try:
        arrays = read_arrays(path, ("f0", "imgs", "touch_center", "touch_radius"))
        f0, pictures = arrays["f0"], arrays["imgs"]
        centers, radii = arrays["touch_center"].astype(float), arrays["touch_radius"].astype(float)
    except (KeyError, ValueError) as error:
        raise ValueError(f"{path} is not a calibration set: {error}") from None
    n = len(pictures)
    shapes = f0.ndim == 3 and f0.shape[2] == 3 and pictures.shape == (n, *f0.shape)
    if not shapes or centers.shape != (n, 2) or radii.shape != (n,) or f0.dtype != np.uint8:
        raise ValueError(
            f"{path} is not a calibration set: f0 {f0.shape}, imgs {pictures.shape}, touch_center {centers.shape} and "
            f"touch_radius {radii.shape} do not belong together"
        )
    rough = Path(name).name in ROUGH_SETS
    marks = {"marks_off_px": ROUGH_MARKS_OFF_PX} if rough else {}
    presses = tuple(
        PressPicture(
            picture[..., ::-1].copy(),
            ROUGH_BALL_DIAMETER_MM if rough else BALL_DIAMETER_MM,
            radius_px=float(radius),
            center_px=(float(x), float(y)),
            name=f"press {number}",
            **marks,
        )
        for number, (picture, (x, y), radius) in enumerate(zip(pictures, centers, radii, strict=True))
    )
    reference = f0[..., ::-1].copy()
    azimuths = light_azimuths(reference, [press.picture for press in presses], centers, radii)
    start = start_sensor(f0.shape[1], azimuths, mm_per_px or MM_PER_PX)
    if rough:
        blurred = start.camera.model_copy(update={"point_spread_px": ROUGH_POINT_SPREAD_PX})
        start = start.model_copy(update={"camera": blurred})
    return PressSet(reference, presses, start)


def start_sensor(width_px: int, azimuths: Sequence[float], mm_per_px: float) -> Sensor:
    """Return what a calibration of these sets starts from: a camera 25 mm away, no markers, a bar for each channel.

    `azimuths` (3,) are where red, green and blue come from, in radians from +x towards +y.
    """
    view_mm = width_px * mm_per_px
    return Sensor(
        name="taxim",
        camera=Camera.showing(view_mm),
        coating=Coating(),
        markers=Markers(layout="none"),
        illumination=bars_at(azimuths, view_mm),
    )
