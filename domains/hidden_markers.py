"""A picture without its markers: found in the picture itself, as one must with a real sensor, and inpainted."""

import numpy as np


def without_markers(picture: np.ndarray) -> np.ndarray:
    """Return the uint8 (h, w, 3) picture with its dots filled in; one in which none are found stays as it is."""
    from gelgap.render import detect_markers, inpaint_telea

    mask = detect_markers(picture)
    return inpaint_telea(picture, mask) if mask.any() else picture
