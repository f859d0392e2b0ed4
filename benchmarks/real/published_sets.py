"""Real recordings of two public repositories, as picture folders and as presses. Nothing of them comes with gelgap.

GelSight-lab/EstimateModulus: videos of a GelSight Wedge and the force of the gripper. A clone holds
`example_data/<session>/<clip>.avi` with `<clip>_forces.pkl`, one number a picture in N, positive in compression, and
`wedge_config/config_100.csv`, the corners of the pad in the pictures.

yanglh14/gelsight: a ball on a gel with dots, its centre marked by hand. A clone holds `data/calibration{,2,3}/*.jpg`
with `ball_position/*.txt`: x, y and a radius in pixels of the rectified picture. The radii are limited to the ball's
own and are not used.
"""

import pickle
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from gelgap.domains import ConvertedClip
from gelgap.domains.formats.convert import (
    Clip,
    Writer,
    mean_rgb,
    video_pictures,
    write_clips,
    write_picture,
    write_picture_table,
)
from gelgap.domains.formats.pictures import decode_picture
from gelgap.domains.frames.folders import read_table

WEDGE_CLONE = "git clone https://github.com/GelSight-lab/EstimateModulus"
PICTURES_PER_S = 30.0
GLITCH_N = -1.5
"""A force below this, by the repository's sign, is an error of the gauge."""
_CORNERS = Path("wedge_config", "config_100.csv")
_CORNER_NAMES = ("topleft", "topright", "bottomleft", "bottomright")
_WEDGE_PX = (320, 240)
_WEDGE_LAGS = range(6)
_MOST_PICKLE_BYTES = 2**28

BALL_CLONE = "git clone https://github.com/yanglh14/gelsight"
MM_PER_PX = 0.1
# The corners by which the repository rectifies its pictures.
_BALL_CORNERS_PX, _BALL_PX = ((33, 58), (208, 61), (56, 250), (185, 250)), (240, 320)
_LEAST_CONTRAST = 2.0
_PRESSES_PER_CLIP = 20


def rectified(
    picture: np.ndarray, corners_px: tuple[tuple[float, float], ...], size_px: tuple[int, int]
) -> np.ndarray:
    """Return a quadrilateral of a picture (h, w, 3) warped to an upright one of this width and height.

    The corners are (x, y) of the top left, top right, bottom left and bottom right one.

    Raises
    ------
    ValueError
        If they are not inside the picture.
    """
    import cv2

    corners = np.float32(corners_px)
    if corners.min() < 0 or (corners > picture.shape[1::-1]).any():
        raise ValueError(
            f"the corners {corners.tolist()} lie outside of a picture of {picture.shape[1]}×{picture.shape[0]} px"
        )
    width, height = size_px
    upright = np.float32([(0, 0), (width, 0), (0, height), (width, height)])
    return cv2.warpPerspective(picture, cv2.getPerspectiveTransform(corners, upright), size_px)


def _write_wedge(clone: Path, out_dir: Path, every: int) -> list[ConvertedClip]:
    """Write the clips of a clone of EstimateModulus, their pads rectified to 320×240 px."""
    corners = _pad_corners(clone)
    videos = sorted((clone / "example_data").glob("*/*.avi"))
    if not videos:
        raise ValueError(f"{clone / 'example_data'} holds no videos; get the whole repository: {WEDGE_CLONE}")
    return write_clips((_wedge_clip(video, corners) for video in videos), out_dir, every)


def _pad_corners(clone: Path) -> tuple[tuple[float, float], ...]:
    table = clone / _CORNERS
    if not table.is_file():
        raise ValueError(
            f"{clone} is no clone of EstimateModulus: it has no {_CORNERS}; get one: {WEDGE_CLONE}"
        )
    found = {row.get("Name"): (row.get("x"), row.get("y")) for row in read_table(table)}
    try:
        return tuple((float(x), float(y)) for x, y in (found[name] for name in _CORNER_NAMES))
    except (KeyError, TypeError, ValueError):
        raise ValueError(
            f"{table} must have a row with Name, x, y for each of {', '.join(_CORNER_NAMES)}"
        ) from None


def _wedge_clip(video: Path, corners_px: tuple[tuple[float, float], ...]) -> Clip:
    forces = video.with_name(f"{video.stem}_forces.pkl")
    if not forces.is_file():
        raise ValueError(f"{forces} is missing; {video.name} has its forces there")
    force_n = read_pickled_array(forces)
    if force_n.ndim != 1:
        raise ValueError(f"{forces} holds an array of shape {force_n.shape}; expected one number a picture")
    time_s = np.arange(len(force_n)) / PICTURES_PER_S
    labels = {"fz_n": np.where(force_n < GLITCH_N, np.nan, -force_n)}
    pictures = partial(_pad_pictures, video, corners_px)
    return Clip(video.stem, video.parent.name, pictures, time_s, time_s, labels, _WEDGE_LAGS)


def _pad_pictures(video: Path, corners_px: tuple[tuple[float, float], ...]) -> Iterator[np.ndarray]:
    return (rectified(picture, corners_px, _WEDGE_PX) for picture in video_pictures(video))


class _PickledDtype:
    """Stands for `numpy.dtype`: takes plain numbers alone."""

    def __init__(self, code: str, *_: Any):
        if not re.fullmatch("[iuf][1248]", code):
            raise ValueError(f"it has the type {str(code)[:20]!r}")
        self.code, self.order = code, "="

    def __setstate__(self, state: tuple) -> None:
        self.order = state[1].replace("|", "=")


class _PickledArray:
    """Stands for `numpy.ndarray`; `values` are made of the bytes that the pickle states."""

    values: np.ndarray

    def __setstate__(self, state: tuple) -> None:
        _, shape, dtype, by_columns, data = state
        if not all(isinstance(side, int) and side >= 0 for side in shape):
            raise ValueError("the array's shape is none")
        kind = np.dtype(dtype.order + dtype.code)
        if prod(shape) * kind.itemsize != len(data):
            raise ValueError(f"it states shape {shape} and {len(data)} bytes")
        self.values = np.frombuffer(data, kind).reshape(shape, order="F" if by_columns else "C")


class _ArrayUnpickler(pickle.Unpickler):
    """Resolves the names by which NumPy writes an array of numbers, to stand-ins that call nothing, and no other."""

    def find_class(self, module: str, name: str) -> Any:
        match f"{module}.{name}":
            case "numpy.core.multiarray._reconstruct" | "numpy._core.multiarray._reconstruct":
                return lambda *_: _PickledArray()
            case "numpy.ndarray":
                return _PickledArray
            case "numpy.dtype":
                return _PickledDtype
        raise ValueError(f"it names '{module}.{name}'")


def read_pickled_array(path: Path) -> np.ndarray:
    """Return the array of numbers that is all that a pickle holds, as float64.

    Raises
    ------
    ValueError
        If the file is no pickle, or holds anything else; nothing in it is run.
    """
    if path.stat().st_size > _MOST_PICKLE_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size} bytes; at most {_MOST_PICKLE_BYTES} are read")
    try:
        with path.open("rb") as file:
            return _ArrayUnpickler(file).load().values.astype(float)
    except (
        *(pickle.UnpicklingError, EOFError, ValueError, TypeError, AttributeError),
        *(LookupError, OverflowError, RecursionError, MemoryError),
    ) as error:
        raise ValueError(
            f"{path} holds something else than an array of numbers, and is not read: {str(error)[:120]}"
        ) from None


@dataclass(frozen=True)
class PressSeries:
    """Presses of one ball: folder below `data/`, beginning of the pictures' names, the ball's radius."""

    name: str
    prefix: str
    ball_radius_mm: float


SERIES = (
    PressSeries("calibration", "ball", 2.42),
    PressSeries("calibration2", "cal", 2.42),
    PressSeries("calibration3", "cal", 1.98),
)


@dataclass(frozen=True)
class Presses:
    """Rectified pictures (n, h, w, 3) in the order in which they were taken, and marked centres (n, 2) in px."""

    series: PressSeries
    pictures: np.ndarray
    centers_px: np.ndarray

    @property
    def centers_mm(self) -> np.ndarray:
        """Contact centres (n, 2) from the middle of the picture, x to the right and y down, mm."""
        height, width = self.pictures.shape[1:3]
        return (self.centers_px - np.array([width - 1, height - 1]) / 2) * MM_PER_PX

    @cached_property
    def reference(self) -> np.ndarray:
        """The median of the pictures (h, w, 3), as a ball touches each place in few of them.

        The repository's `bg-0.jpg` is the same file in all series: some 4 grey levels from the untouched parts of the
        later two, of which this is 2 away.
        """
        return np.median(self.pictures, axis=0).round().astype(np.uint8)

    def is_marked_right(self) -> np.ndarray:
        """Return whether each press (n,) changes the picture more within the ball's radius of its mark than elsewhere.

        The least of what is right, by eye, is 4.6 times as much; a mark in another place gives 0.9.
        """
        reference = self.reference.astype(np.int16)
        rows, columns = np.indices(reference.shape[:2])
        radius_px = self.series.ball_radius_mm / MM_PER_PX
        right = []
        for picture, (x, y) in zip(self.pictures, self.centers_px, strict=True):
            change = np.abs(picture - reference).mean(axis=2)
            near = np.hypot(columns - x, rows - y) < radius_px
            right.append(change[near].mean() > _LEAST_CONTRAST * change[~near].mean())
        return np.array(right)


def ball_presses(clone: Path, series: PressSeries) -> Presses:
    """Read one series of a clone of yanglh14/gelsight.

    Raises
    ------
    ValueError
        If the folder is no such clone, or one of its files is not as it should be.
    """
    folder = clone / "data" / series.name
    paths = sorted(folder.glob(f"{series.prefix}-*.jpg"), key=_number)
    if not paths:
        raise ValueError(
            f"{clone} is no clone of yanglh14/gelsight: it has no {folder}; get one: {BALL_CLONE}"
        )
    return Presses(
        series, np.stack([_pad(path) for path in paths]), np.array([_center_px(path) for path in paths])
    )


def _number(path: Path) -> tuple[int, str]:
    number = path.stem.rpartition("-")[2]
    return (int(number) if number.isdigit() else -1, path.stem)


def _pad(path: Path) -> np.ndarray:
    try:
        picture = decode_picture(path.read_bytes())
    except ValueError as error:
        raise ValueError(f"{path} is not readable: {error}") from None
    return rectified(picture, _BALL_CORNERS_PX, _BALL_PX)


def _center_px(picture: Path) -> tuple[float, float]:
    mark = picture.parent / "ball_position" / f"{picture.stem}.txt"
    try:
        x, y, _ = (float(number) for number in mark.read_text(encoding="utf-8").split())
    except FileNotFoundError:
        raise ValueError(f"{mark} is missing; {picture.name} has its mark there") from None
    except ValueError:
        raise ValueError(f"{mark} must hold three numbers: x, y and radius in px") from None
    return x, y


def _write_ball_presses(clone: Path, out_dir: Path, every: int) -> list[ConvertedClip]:
    """Write all series of a clone of yanglh14/gelsight as one domain: they are of one sensor.

    A clip is twenty presses that were taken one after another, as they lie close together.
    """
    domain, table, facts = "ball-presses", [], []
    for series in SERIES:
        presses, name = ball_presses(clone, series), series.name
        right = presses.is_marked_right()
        reference = write_picture(out_dir / domain, f"{name}/reference.png", presses.reference)
        chosen = np.flatnonzero(right)[::every].tolist()
        table += [
            {
                "picture": write_picture(
                    out_dir / domain, f"{name}/{press:05d}.png", presses.pictures[press]
                ),
                "reference": reference,
                "x_mm": float(presses.centers_mm[press, 0]),
                "y_mm": float(presses.centers_mm[press, 1]),
                "clip": f"{name}-{press // _PRESSES_PER_CLIP:02d}",
                "object": f"ball of {2 * series.ball_radius_mm:.2f} mm",
                "session": name,
            }
            for press in chosen
        ]
        facts.append(
            ConvertedClip(
                domain=domain,
                session=name,
                name=name,
                pictures=len(right),
                in_contact=len(right),
                dropped=int((~right).sum()),
                written=len(chosen),
                reference_rgb=mean_rgb(presses.reference),
            )
        )
    write_picture_table(out_dir / domain, table)
    return facts


LAYOUTS: dict[str, Writer] = {"wedge": _write_wedge, "ball-presses": _write_ball_presses}
"""What `gelgap.domains.convert` writes of a clone, by name."""
