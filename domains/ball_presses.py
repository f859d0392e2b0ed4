"""Presses of the repository yanglh14/gelsight: a ball on a gel with dots, its centre marked by hand.

A clone holds `data/calibration{,2,3}/*.jpg` with `ball_position/*.txt`: x, y and a radius in pixels of the rectified
picture. The radii are limited to the ball's own and are not used. Nothing of it comes with gelgap.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from gelgap.domains.picture_codec import decode_picture
from gelgap.domains.rectification import Rectification

CLONE = "git clone https://github.com/yanglh14/gelsight"
MM_PER_PX = 0.1
_PAD = Rectification(((33, 58), (208, 61), (56, 250), (185, 250)), (240, 320))
"""The corners that the repository rectifies by."""
_LEAST_CONTRAST = 2.0


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
    """Read one series of a clone.

    Raises
    ------
    ValueError
        If the folder is no such clone, or one of its files is not as it should be.
    """
    folder = clone / "data" / series.name
    paths = sorted(folder.glob(f"{series.prefix}-*.jpg"), key=_number)
    if not paths:
        raise ValueError(f"{clone} is no clone of yanglh14/gelsight: it has no {folder}; get one: {CLONE}")
    pictures = np.stack([_PAD(_decoded(path)) for path in paths])
    return Presses(series, pictures, np.array([_center_px(path) for path in paths]))


def _number(path: Path) -> tuple[int, str]:
    number = path.stem.rpartition("-")[2]
    return (int(number) if number.isdigit() else -1, path.stem)


def _decoded(path: Path) -> np.ndarray:
    try:
        return decode_picture(path.read_bytes())
    except ValueError as error:
        raise ValueError(f"{path} is not readable: {error}") from None


def _center_px(picture: Path) -> Sequence[float]:
    mark = picture.parent / "ball_position" / f"{picture.stem}.txt"
    try:
        x, y, _ = (float(number) for number in mark.read_text(encoding="utf-8").split())
    except FileNotFoundError:
        raise ValueError(f"{mark} is missing; {picture.name} has its mark there") from None
    except ValueError:
        raise ValueError(f"{mark} must hold three numbers: x, y and radius in px") from None
    return x, y
