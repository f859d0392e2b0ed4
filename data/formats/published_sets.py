"""Real recordings of two public repositories, to convert into picture folders. Nothing of them comes with gelgap.

GelSight-lab/EstimateModulus: videos of a GelSight Wedge and the force of the gripper. A clone holds
`example_data/<session>/<clip>.avi` with `<clip>_forces.pkl`, one number a picture in N, positive in compression, and
`wedge_config/config_100.csv`, the corners of the pad in the pictures.

yanglh14/gelsight: a ball on a gel with markers, its centre marked by hand. A clone holds `data/calibration{,2,3}/*.jpg`
with `ball_position/*.txt`: x, y and a radius in pixels of the rectified picture. The radii are limited to the ball's
own and are not used.
"""

import pickle
import re
from collections.abc import Iterator
from functools import partial
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gelgap.assets.image_file import read_image
from gelgap.data.formats.convert import Clip, ConvertedClip, Layout, Selection, mean_rgb
from gelgap.data.formats.video import video_pictures
from gelgap.data.frames.tables import read_table

WEDGE_CLONE = "git clone https://github.com/GelSight-lab/EstimateModulus"
PICTURES_PER_S = 30.0
GLITCH_N = -1.5
"""A force below this, by the repository's sign, is an error of the gauge."""
Corners = tuple[tuple[float, float], ...]
"""(x, y) px of the top left, top right, bottom left and bottom right one."""
_CORNERS = Path("wedge_config", "config_100.csv")
_CORNER_NAMES = ("topleft", "topright", "bottomleft", "bottomright")
_WEDGE_PX = (320, 240)
_WEDGE_LAGS = range(6)
_MOST_PICKLE_BYTES = 2**28
_ARRAY_NAMES = (
    "numpy.core.multiarray._reconstruct",
    "numpy._core.multiarray._reconstruct",
    "numpy.ndarray",
    "numpy.dtype",
)

BALL_CLONE = "git clone https://github.com/yanglh14/gelsight"
MM_PER_PX = 0.1
# The corners by which the repository rectifies its pictures.
_BALL_CORNERS_PX, _BALL_PX = ((33, 58), (208, 61), (56, 250), (185, 250)), (240, 320)
_LEAST_CONTRAST = 2.0
_PRESSES_PER_CLIP = 20


def rectified(picture: np.ndarray, corners_px: Corners, size_px: tuple[int, int]) -> np.ndarray:
    """Return a quadrilateral of a picture (h, w, 3) warped to an upright one of this width and height.

    Raises
    ------
    ValueError
        If they are not inside the picture.
    """
    import cv2

    corners = np.array(corners_px, np.float32)
    if corners.min() < 0 or (corners > picture.shape[1::-1]).any():
        raise ValueError(
            f"the corners {corners.tolist()} lie outside of a picture of {picture.shape[1]}×{picture.shape[0]} px"
        )
    width, height = size_px
    upright = np.array([(0, 0), (width, 0), (0, height), (width, height)], np.float32)
    return cv2.warpPerspective(picture, cv2.getPerspectiveTransform(corners, upright), size_px)


def _wedge_clips(clone: Path) -> Iterator[Clip]:
    """Read the clips of a clone of EstimateModulus, their pads rectified to 320×240 px."""
    corners = _pad_corners(clone)
    videos = sorted((clone / "example_data").glob("*/*.avi"))
    if not videos:
        raise ValueError(f"{clone / 'example_data'} holds no videos; get the whole repository: {WEDGE_CLONE}")
    for video in videos:
        forces = video.with_name(f"{video.stem}_forces.pkl")
        if not forces.is_file():
            raise ValueError(f"{forces} is missing; {video.name} has its forces there")
        force_n = read_pickled_array(forces)
        if force_n.ndim != 1:
            raise ValueError(f"{forces} holds an array of shape {force_n.shape}, not one number a picture")
        time_s = np.arange(len(force_n)) / PICTURES_PER_S
        labels = pd.DataFrame({"fz_n": np.where(force_n < GLITCH_N, np.nan, -force_n)}, time_s)
        pictures = partial(_pad_pictures, video, corners)
        yield Clip(video.stem, video.parent.name, pictures, time_s, labels, _WEDGE_LAGS)


def _pad_pictures(video: Path, corners_px: Corners) -> Iterator[np.ndarray]:
    return (rectified(picture, corners_px, _WEDGE_PX) for picture in video_pictures(video))


def _pad_corners(clone: Path) -> Corners:
    table = clone / _CORNERS
    if not table.is_file():
        raise ValueError(f"{clone} is no clone of EstimateModulus, lacks {_CORNERS}; get one: {WEDGE_CLONE}")
    columns = dict(read_table(table))
    try:
        rows = [columns["Name"].index(name) for name in _CORNER_NAMES]
        return tuple((float(columns["x"][row]), float(columns["y"][row])) for row in rows)
    except (KeyError, IndexError, ValueError):
        raise ValueError(
            f"{table} must have a row with Name, x, y for each of {', '.join(_CORNER_NAMES)}"
        ) from None


class _StandIn:
    """Keeps what a pickle would hand to a class of NumPy, and calls nothing."""

    def __init__(self, *arguments: Any):
        self.arguments = arguments

    def __setstate__(self, state: Any) -> None:
        self.state = state


class _ArrayUnpickler(pickle.Unpickler):
    """Resolves the names by which NumPy writes an array of numbers, to stand-ins, and no other."""

    def find_class(self, module: str, name: str) -> type[_StandIn]:
        if f"{module}.{name}" not in _ARRAY_NAMES:
            raise ValueError(f"it names '{module}.{name}'")
        return _StandIn


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
            _, shape, kind, by_columns, data = _ArrayUnpickler(file).load().state
        code = kind.state[1].replace("|", "=") + kind.arguments[0]
        if not re.fullmatch("[<>=][iuf][1248]", code) or not all(type(side) is int for side in shape):
            raise ValueError("its values are not numbers, or its shape is missing")
        values = np.frombuffer(data, code)
        if prod(shape) != len(values) or min(shape, default=0) < 0:
            raise ValueError(f"it states shape {shape} and {len(values)} values")
        return values.reshape(shape, order="F" if by_columns else "C").astype(float)
    except Exception as error:  # a forged file can lead to any
        raise ValueError(
            f"{path} holds something else than an array of numbers, and is not read: {str(error)[:120]}"
        ) from None


SERIES = {"calibration": ("ball", 2.42), "calibration2": ("cal", 2.42), "calibration3": ("cal", 1.98)}
"""Series of presses of one ball: the beginning of the pictures' names and the ball's radius, mm, by the folder."""


def _ball_presses(clone: Path, name: str, every: int) -> Selection:
    """Select every n-th press that is marked right of one of `SERIES` of a clone of yanglh14/gelsight.

    All series are one domain, as they are of one sensor.
    A clip is twenty presses that were taken one after another, as they lie close together.
    """
    folder, (prefix, ball_radius_mm) = clone / "data" / name, SERIES[name]
    paths = sorted(folder.glob(f"{prefix}-*.jpg"), key=_number)
    if not paths:
        raise ValueError(f"{clone} is no clone of yanglh14/gelsight, lacks {folder}; get one: {BALL_CLONE}")
    pictures = np.stack([rectified(read_image(path), _BALL_CORNERS_PX, _BALL_PX) for path in paths])
    centers_px = np.array([_center_px(path) for path in paths])
    # As a ball touches each place in few of them. The repository's `bg-0.jpg` is the same file in all series: some
    # 4 grey levels from the untouched parts of the later two, of which this is 2 away.
    reference = np.median(pictures, axis=0).round().astype(np.uint8)
    right = _is_marked_right(pictures, reference, centers_px, ball_radius_mm / MM_PER_PX)
    chosen = np.flatnonzero(right)[::every]
    centers_mm = (centers_px - (np.array(_BALL_PX) - 1) / 2) * MM_PER_PX
    table = pd.DataFrame(centers_mm[chosen], chosen, ["x_mm", "y_mm"]).assign(
        clip=[f"{name}-{press // _PRESSES_PER_CLIP:02d}" for press in chosen],
        object=f"ball of {2 * ball_radius_mm:.2f} mm",
    )
    facts = ConvertedClip(
        domain="ball-presses",
        session=name,
        name=name,
        pictures=len(right),
        in_contact=len(right),
        dropped=int((~right).sum()),
        written=len(chosen),
        reference_rgb=mean_rgb(reference),
    )
    return Selection(facts, reference, lambda: pictures, table)


def _is_marked_right(
    pictures: np.ndarray, reference: np.ndarray, centers_px: np.ndarray, radius_px: float
) -> np.ndarray:
    """Return whether each press (n,) changes the picture more within the ball's radius of its mark than elsewhere.

    The least of what is right, by eye, is 4.6 times as much; a mark in another place gives 0.9.
    """
    rows, columns = np.indices(reference.shape[:2])
    right = []
    for picture, (x, y) in zip(pictures, centers_px, strict=True):
        change = np.abs(picture - reference.astype(np.int16)).mean(axis=2)
        near = np.hypot(columns - x, rows - y) < radius_px
        right.append(change[near].mean() > _LEAST_CONTRAST * change[~near].mean())
    return np.array(right)


def _number(path: Path) -> tuple[int, str]:
    number = path.stem.rpartition("-")[2]
    return (int(number) if number.isdigit() else -1, path.stem)


def _center_px(picture: Path) -> tuple[float, float]:
    mark = picture.parent / "ball_position" / f"{picture.stem}.txt"
    try:
        x, y, _ = (float(number) for number in mark.read_text(encoding="utf-8").split())
    except FileNotFoundError:
        raise ValueError(f"{mark} is missing; {picture.name} has its mark there") from None
    except ValueError:
        raise ValueError(f"{mark} must hold three numbers: x, y and radius in px") from None
    return x, y


LAYOUTS: dict[str, Layout] = {
    "wedge": lambda clone, every, lag: (clip.selected(every, lag) for clip in _wedge_clips(clone)),
    "ball-presses": lambda clone, every, lag: (_ball_presses(clone, name, every) for name in SERIES),
}
"""What `gelgap.data.convert` reads of a clone, by name."""
