"""Where a ball touches, without a network and without labels: two rules on how a picture differs from its reference.

A dent is brighter on the sides that face lights and darker on the others, and seldom as much: the centroid of the
change lies off the contact's centre, towards the stronger light. Where the gel is level its colour is that of the
reference, so that the change is zero in the dent's centre, whatever the lights.
"""

import numpy as np

_MARGIN = 0.05
"""Share of the width: the pad's rim changes, too, when the gel is pressed."""
_BLUR = 0.025
_SHARE = 0.5
_DOT_CONTRAST = 14
_DOT_PX = 13
_ROUNDS = 6
_MOST_STEP_PX = 5.0


def center_of_change_px(change: np.ndarray) -> np.ndarray:
    """Return (x, y) px: the centroid of what exceeds half of the largest change (h, w, 3), blurred, where that lies."""
    import cv2

    height, width, _ = change.shape
    margin = round(_MARGIN * width)
    inside = np.zeros((height, width), np.float32)
    inside[margin:-margin, margin:-margin] = 1
    size = cv2.GaussianBlur(np.abs(change).mean(axis=2, dtype=np.float32) * inside, (0, 0), _BLUR * width)
    _, parts = cv2.connectedComponents((size > _SHARE * size.max()).astype(np.uint8))
    strong = np.where(parts == parts.ravel()[size.argmax()], size, 0)
    rows, columns = np.indices(size.shape)
    return np.array([(strong * columns).sum(), (strong * rows).sum()]) / strong.sum()


def level_point_px(picture: np.ndarray, reference: np.ndarray, radius_px: float) -> np.ndarray:
    """Return (x, y) px: where the change, taken as linear in the place within `radius_px`, vanishes in all colours.

    It begins at the centroid of the change. Dots are left out.
    """
    dots = dots_of(picture) | dots_of(reference)
    change = picture.astype(np.float64) - reference
    rows, columns = np.indices(dots.shape)
    point = start = center_of_change_px(change)
    for _ in range(_ROUNDS):
        near = (np.hypot(columns - point[0], rows - point[1]) < radius_px) & ~dots
        away = np.column_stack([np.ones(near.sum()), columns[near] - point[0], rows[near] - point[1]])
        there, *slopes = np.linalg.lstsq(away, change[near], rcond=None)[0]
        step = np.linalg.lstsq(np.transpose(slopes), -there, rcond=None)[0]
        point = point + np.clip(step, -_MOST_STEP_PX, _MOST_STEP_PX)
    return point if np.hypot(*(point - start)) < radius_px else start


def dots_of(picture: np.ndarray) -> np.ndarray:
    """Return the mask (h, w) of dots. These are too pale in the median of many pictures for gelgap's own rule."""
    import cv2

    brightest = picture.max(axis=2)
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_DOT_PX, _DOT_PX))
    hollow = cv2.morphologyEx(brightest, cv2.MORPH_BLACKHAT, around)
    return cv2.dilate((hollow > _DOT_CONTRAST).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
