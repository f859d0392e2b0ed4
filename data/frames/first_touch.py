"""Dents around the place where their contact began: without markers, how far a dent has moved is what tells shear.

In another light R² of shear of single drags is 0.85 to 0.98, where single pictures by losses have 0.2 in the mean
(docs/results/light.md).
"""

import logging

import numpy as np

from gelgap.data.frames.dataset import LabelledFrames

LOG = logging.getLogger(__name__)
TRAJECTORY, STEP = "trajectory_id", "step"
_SPAN = 2 / 3  # of the picture's width and height is shown
# The norm of the three colours' change, of the range, that there is in a contact, and at a pixel of its dent: blurred
# noise has a third of the latter, and a touch that just exceeds it would show one wall alone.
_LEAST_CONTACT, _LEAST_CHANGE = 0.03, 0.02
# Of the largest change in a picture, that a pixel of the dent has at least.
_SHARE = 0.15
# Of the pixels of a contact's largest dent: one that begins with more has been pressed before.
_LATE = 0.6
_BLUR_PX = 0.6  # of a pixel that is shown
# The root mean square by which a part without a dent is divided, of the range.
_LEAST_RMS = 0.005


def trajectory_of(frames: LabelledFrames) -> np.ndarray:
    """Return the number of each frame's trajectory (n,), which is of one sensor; a ValueError where it is not known."""
    for name in (TRAJECTORY, STEP):
        if name not in frames.columns:
            raise ValueError(
                f"data set {frames.name} has no column {name}: the input touch and sequence_length above 1 need "
                f"{TRAJECTORY} and {STEP} of each frame"
            )
        if unknown := int((frames.columns[name] < 0).sum()):
            raise ValueError(f"{frames.name}: {unknown} of {len(frames)} rows lack {name}; give all or none")
    keys = np.stack([frames.reference_id, frames.columns[TRAJECTORY], frames.columns[STEP]], axis=1)
    found, count = np.unique(keys, axis=0, return_counts=True)
    if len(twice := found[count > 1]):
        raise ValueError(
            f"data set {frames.name} has {count.max()} rows of {TRAJECTORY} {twice[0, 1]} and {STEP} {twice[0, 2]}: "
            "number trajectories throughout the table, and pictures within each"
        )
    return np.unique(keys[:, :2], axis=0, return_inverse=True)[1]


def dents_from_touch(frames: LabelledFrames, size_px: tuple[int, int]) -> np.ndarray:
    """Return the dent of each frame around its place of first touch, (n, h, w, 2) float16 as `dent_at` shows it.

    That place is the dent's centre in the first frame of the frame's contact, in its trajectory and by step; where a
    contact has ended, the next one has its own. Without contact nothing is shown. A frame takes 6 ms of a core. A
    warning says so if most contacts begin with a dent that is hardly smaller than it becomes.
    """
    shown = np.zeros((len(frames), size_px[1], size_px[0], 2), np.float16)
    references = [read() for read in frames.rest_pictures]
    trajectory = trajectory_of(frames)
    sizes_px: list[list[int]] = []  # of the dents of each contact
    centre_px, before = np.zeros(2), -1
    for row in np.lexsort([frames.columns[STEP], trajectory]):
        change = change_of(frames.picture(int(row)), references[frames.reference_id[row]], size_px)
        dent_px = dent_pixels(change)
        if not len(dent_px):
            before = -1
            continue
        if trajectory[row] != before:
            centre_px, before = dent_px.mean(axis=0), trajectory[row]
            sizes_px.append([])
        sizes_px[-1].append(len(dent_px))
        shown[row] = dent_at(change, centre_px, size_px)
    # A single contact may be what a few pictures to predict show of one.
    followed = [sizes for sizes in sizes_px if len(sizes) > 1]
    late = sum(sizes[0] > _LATE * max(sizes) for sizes in followed)
    if late > 1 and 2 * late > len(followed):
        LOG.warning(
            f"input touch: {frames.name}: {late} of {len(followed)} contacts begin with a dent that is hardly smaller "
            "than it becomes, so that they may have been dragged before: begin each with a picture of a straight touch "
            "at most 0.2 mm deep, and leave out those that have none"
        )
    return shown


def change_of(picture: np.ndarray, reference: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
    """Return how the colours of each pixel have changed, (h, w, 3) of the range, blurred for pictures of `size_px`."""
    import cv2

    blur_px = _BLUR_PX * _SPAN * picture.shape[1] / size_px[0]
    return cv2.GaussianBlur((picture.astype(np.float32) - reference) / 255, (0, 0), blur_px)


def dent_pixels(change: np.ndarray) -> np.ndarray:
    """Return the pixels (k, 2), x and y, that belong to a dent, by `change_of`; none without contact."""
    strength = np.linalg.norm(change, axis=2)
    least = max(_LEAST_CHANGE, _SHARE * strength.max())
    return np.argwhere((strength > least) & (strength.max() > _LEAST_CONTACT))[:, ::-1]


def dent_at(change: np.ndarray, centre_px: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
    """Return how strong a change and its edges are around a place, (h, w, 2), each over its root mean square.

    No colour is left, only where something is. Two thirds of the picture's width and height are shown, reduced to
    `size_px`; beyond the picture nothing has changed.
    """
    import cv2

    size = np.array(size_px)
    shown_px = _SPAN * np.array(change.shape[1::-1]) / size
    corner_px = centre_px - shown_px * (size - 1) / 2
    to_stored = np.column_stack([np.diag(shown_px), corner_px])
    part = cv2.warpAffine(change, to_stored, size_px, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    edges = np.concatenate(np.gradient(part, axis=(0, 1)), axis=2)
    strengths = np.stack([np.linalg.norm(part, axis=2), np.linalg.norm(edges, axis=2)], axis=2)
    return strengths / (np.sqrt(np.square(strengths).mean(axis=(0, 1))) + _LEAST_RMS)
