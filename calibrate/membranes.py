"""Presses for a calibration from pictures: sets of the package `taxim` (MIT), and gelgap's own solves of a sphere.

A folder of a set holds `dataPack.npz` with f0 (h, w, 3), imgs (n, h, w, 3), touch_center (n, 2) as x and y in pixels,
and touch_radius (n,), marked by hand. Their channels are blue, green, red: the package's own renderer turns them over.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gelgap import sim
from gelgap.assets.array_file import read_arrays
from gelgap.calibrate.pictures import PressPicture, find_contact_mm, light_azimuths
from gelgap.calibrate.profiles import PressProfiles, SolvedPress
from gelgap.render import Camera, Coating, Illumination, Led, Markers, Sensor

_COLOURS = ("red", "green", "blue")
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

# Depths that are solved, in radii of the sphere.
DEPTHS_IN_RADII = (0.075, 0.15, 0.225, 0.3, 0.375, 0.45, 0.525, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95)
_DEEPEST_IN_THICKNESSES = 0.6
_BEYOND = 1.3
CALIBRATION_GEL = sim.Elastomer(
    young_modulus_mpa=0.3, poisson_ratio=0.48, friction=0.5, thickness_mm=4.0, pad_size_mm=(40.0, 40.0)
)
"""What a gel is taken for; from 4 mm on, pictures of presses hardly depend on it."""


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


def lit_from_dents(sensor: Sensor, reference: np.ndarray, presses: Sequence[PressPicture]) -> Sensor:
    """Return a sensor with a bar for each colour, out of the view, in the direction that dents are lit from.

    Raises
    ------
    ValueError
        If a press without a place hardly differs from the reference.
    """
    camera = sensor.camera
    size_px = reference.shape[1], reference.shape[0]
    mm_per_px = camera.footprint_mm(size_px)[0] / size_px[0]
    centers, radii = [], []
    for press in presses:
        x, y = press.point_mm or (0.0, 0.0)
        if press.point_mm is None and press.center_px is None:
            x, y = find_contact_mm(press.picture, reference, camera)
        centers.append(press.center_px or camera.project_px(np.array([x, y, 0.0]), size_px) - 0.5)
        contact_mm = np.sqrt((press.depth_mm or 0.0) * (press.sphere_diameter_mm or 0.0))
        radii.append(press.radius_px or contact_mm / mm_per_px)
    pictures = [press.picture for press in presses]
    azimuths = light_azimuths(reference, pictures, np.array(centers), np.array(radii))
    light = bars_at(azimuths, camera.footprint_mm(size_px)[0])
    return sensor.model_copy(update={"illumination": light})


def bars_at(azimuths: Sequence[float], view_mm: float) -> Illumination:
    """Return bars that send red, green and blue from azimuths (3,) in radians, from outside a view of some width."""
    leds, unit = [], view_mm / 18.88
    for name, azimuth in zip(_COLOURS, azimuths, strict=True):
        x, y = np.cos(azimuth), np.sin(azimuth)
        leds.append(
            Led(
                name=name,
                position_mm=(14 * unit * x, 14 * unit * y, -4.0 * unit),
                facing=(-x, -y, 0.0),
                length_mm=14.0 * unit,
                height_mm=2.5 * unit,
                spectrum={"rgb": tuple(float(name == own) for own in _COLOURS)},
            )
        )
    return Illumination(leds=tuple(leds))


def sphere_profiles(
    diameters_mm: Iterable[float], deepest_mm: float | None = None, quality: str = "draft"
) -> dict[float, PressProfiles]:
    """Return the membrane around spheres of some diameters, by diameter, down to a depth or as deep as can be.

    Raises
    ------
    ValueError
        If a diameter is not one that can be pressed.
    RuntimeError
        If too few depths were solved.
    """
    found, limit_mm = {}, _DEEPEST_IN_THICKNESSES * CALIBRATION_GEL.thickness_mm
    for diameter_mm in set(diameters_mm):
        radius_mm = diameter_mm / 2
        depths = [share * radius_mm for share in DEPTHS_IN_RADII if share * radius_mm <= limit_mm]
        if deepest_mm is not None:
            needed = sum(depth < _BEYOND * deepest_mm for depth in depths) + 1
            depths = depths[: max(needed, 3)]
        poses = tuple(sim.Pose(depth_mm=depth) for depth in depths)
        states = sim.solve_poses(CALIBRATION_GEL, sim.Sphere(diameter_mm=diameter_mm), poses, quality)
        solves = []
        for depth, state in zip(depths, states, strict=True):
            if state.converged:
                row, first = len(state.y_mm) // 2, len(state.x_mm) // 2
                x, _, z = np.asarray(state.displacement_mm[row, first:], float).T
                solves.append(SolvedPress(depth, state.x_mm[first:] + x, z, state.contact_radius_mm))
        if len(solves) < 3:
            raise RuntimeError(
                f"only {len(solves)} of {len(depths)} depths of a {diameter_mm} mm sphere converged"
            )
        found[diameter_mm] = PressProfiles.from_solves(radius_mm, solves)
    return found
