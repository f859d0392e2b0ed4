"""Windows around what a press changes, for a network to say how far from the change's centroid the contact point is.

A network that sees the whole picture must tell a place to a hundredth of the view; in a window it is a tenth.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gelgap.benchmarks.real.plain_points import center_of_change_px
from gelgap.benchmarks.real.synthetic_presses import SIZE_PX, VIEW_MM
from gelgap.domains import ArrayFrames, LabelledFrames, Labels, with_labels

WINDOW_PX = 64
REACH_MM = 4.0
"""A contact point lies no farther from the window's centre, along x and along y."""
_MM_PER_PX = VIEW_MM[0] / SIZE_PX[0]
_LABELS = Labels.of({"x_mm": (-REACH_MM, REACH_MM), "y_mm": (-REACH_MM, REACH_MM)})
_NO_CHANGE = 128
_JITTER_MM = 1.5
_COPIES = 2


@dataclass(frozen=True)
class Windows:
    """What changes within windows, labelled with the contact point from their centres, and the centres (n, 2) in mm."""

    frames: LabelledFrames
    centers_mm: np.ndarray

    @property
    def has_point(self) -> np.ndarray:
        """Whether the contact point is within reach of the window's centre (n,)."""
        return np.abs(self.frames.label_values).max(axis=1) < REACH_MM

    def take(self, rows: np.ndarray) -> "Windows":
        """Return some of the windows."""
        return Windows(self.frames.take(rows), self.centers_mm[rows])


def windows_of(frames: LabelledFrames) -> Windows:
    """Return a window around the centroid of each picture's change."""
    changes = list(_changes(frames))
    return _windows(frames, changes, _centroids_mm(changes))


def training_windows(frames: LabelledFrames) -> LabelledFrames:
    """Return two windows of each synthetic press, put beside the centroid at random, that have the contact point."""
    rng = np.random.default_rng(0)
    pressed = frames.take(np.flatnonzero(frames.columns["depth_mm"] > 0))
    changes = list(_changes(pressed))
    centers_mm = np.tile(_centroids_mm(changes), (_COPIES, 1))
    centers_mm = centers_mm + rng.uniform(-_JITTER_MM, _JITTER_MM, centers_mm.shape)
    twice = pressed.take(np.tile(np.arange(len(pressed)), _COPIES))
    found = _windows(twice, changes * _COPIES, centers_mm)
    return found.frames.take(np.flatnonzero(found.has_point))


def _changes(frames: LabelledFrames) -> Iterator[np.ndarray]:
    """Yield each picture less its reference (h, w, 3)."""
    references = frames.references_at(SIZE_PX).astype(np.int16)
    for picture, reference in zip(frames.images(SIZE_PX), frames.reference_id, strict=True):
        yield picture - references[reference]


def _centroids_mm(changes: list[np.ndarray]) -> np.ndarray:
    """Return the centroids (n, 2) from the middle of the view."""
    found_px = np.array([center_of_change_px(change) for change in changes])
    return (found_px - (np.array(SIZE_PX) - 1) / 2) * _MM_PER_PX


def _windows(frames: LabelledFrames, changes: list[np.ndarray], centers_mm: np.ndarray) -> Windows:
    """Cut windows at whole pixels; beyond the picture nothing changes."""
    middle_px = centers_mm / _MM_PER_PX + (np.array(SIZE_PX) - 1) / 2
    first_px = np.round(middle_px - (WINDOW_PX - 1) / 2).astype(int)
    centers_mm = (first_px + (WINDOW_PX - 1) / 2 - (np.array(SIZE_PX) - 1) / 2) * _MM_PER_PX
    cut = np.array([_cut(change, *first) for change, first in zip(changes, first_px, strict=True)])
    points_mm = np.stack([frames.columns[name] for name in _LABELS.names], axis=1)
    off_mm = points_mm - centers_mm
    pictures = np.clip(_NO_CHANGE + cut, 0, 255).astype(np.uint8)
    windows = ArrayFrames(
        frames.name,
        pictures,
        np.full(pictures.shape[1:], _NO_CHANGE, np.uint8),
        None,
        x_mm=off_mm[:, 0],
        y_mm=off_mm[:, 1],
    )
    return Windows(with_labels(windows, _LABELS), centers_mm)


def _cut(change: np.ndarray, x: int, y: int) -> np.ndarray:
    """Return the window whose first column and row are x and y."""
    padded = np.pad(change, ((WINDOW_PX, WINDOW_PX), (WINDOW_PX, WINDOW_PX), (0, 0)))
    return padded[y + WINDOW_PX : y + 2 * WINDOW_PX, x + WINDOW_PX : x + 2 * WINDOW_PX].copy()
