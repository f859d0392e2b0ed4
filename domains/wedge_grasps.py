"""Grasps of the repository GelSight-lab/EstimateModulus: videos of a GelSight Wedge and the force of the gripper.

A clone holds `example_data/<session>/<clip>.avi` with `<clip>_forces.pkl`, one number a picture in N, positive in
compression, and `wedge_config/config_100.csv`, the corners of the pad in the pictures. Nothing of it comes with gelgap.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from gelgap.domains.clip import Clip
from gelgap.domains.clip_names import object_of
from gelgap.domains.pickled_array import read_pickled_array
from gelgap.domains.rectification import Rectification
from gelgap.domains.stored import read_table
from gelgap.domains.video import video_pictures

CLONE = "git clone https://github.com/GelSight-lab/EstimateModulus"
PICTURES_PER_S = 30.0
GLITCH_N = -1.5
"""A force below this, by the repository's sign, is an error of the gauge."""
_CLIPS, _CORNERS = "example_data", Path("wedge_config", "config_100.csv")
_CORNER_NAMES = ("topleft", "topright", "bottomleft", "bottomright")
_SIZE_PX = (320, 240)
_LAGS = range(6)


def wedge_clips(clone: Path) -> Iterator[Clip]:
    """Yield the clips of a clone, their pads rectified to 320×240 px.

    Raises
    ------
    ValueError
        If the folder is no such clone, or one of its files is not as it should be.
    """
    rectify = Rectification(_corners(clone), _SIZE_PX)
    videos = sorted((clone / _CLIPS).glob("*/*.avi"))
    if not videos:
        raise ValueError(f"{clone / _CLIPS} holds no videos; get the whole repository: {CLONE}")
    return (_clip(video, rectify) for video in videos)


def _corners(clone: Path) -> tuple[tuple[float, float], ...]:
    table = clone / _CORNERS
    if not table.is_file():
        raise ValueError(f"{clone} is no clone of EstimateModulus: it has no {_CORNERS}; get one: {CLONE}")
    found = {row.get("Name"): (row.get("x"), row.get("y")) for row in read_table(table)}
    try:
        return tuple((float(x), float(y)) for x, y in (found[name] for name in _CORNER_NAMES))
    except (KeyError, TypeError, ValueError):
        raise ValueError(
            f"{table} must have a row with Name, x, y for each of {', '.join(_CORNER_NAMES)}"
        ) from None


def _clip(video: Path, rectify: Rectification) -> Clip:
    forces = video.with_name(f"{video.stem}_forces.pkl")
    if not forces.is_file():
        raise ValueError(f"{forces} is missing; {video.name} has its forces there")
    force_n = read_pickled_array(forces)
    if force_n.ndim != 1:
        raise ValueError(f"{forces} holds an array of shape {force_n.shape}; expected one number a picture")
    time_s = np.arange(len(force_n)) / PICTURES_PER_S
    return Clip(
        name=video.stem,
        object=object_of(video.stem),
        session=video.parent.name,
        pictures=partial(_pad, video, rectify),
        time_s=time_s,
        label_time_s=time_s,
        labels={"fz_n": np.where(force_n < GLITCH_N, np.nan, -force_n)},
        lags=_LAGS,
    )


def _pad(video: Path, rectify: Rectification) -> Iterator[np.ndarray]:
    return (rectify(picture) for picture in video_pictures(video))
