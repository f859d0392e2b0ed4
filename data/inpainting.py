"""Taking the markers out of a picture: find them in the picture itself, as one must with a real sensor, and fill in."""

import numpy as np

# Markers are no larger than this share of the picture's width.
_LARGEST_DIAMETER = 0.08
_RADIUS_PX = 3


def detect_markers(picture: np.ndarray, least_contrast: float = 0.25) -> np.ndarray:
    """Return the bool (h, w) mask of dark markers in a uint8 (h, w, 3) sRGB picture.

    A marker is darker than its surroundings in every channel, which shading under coloured light never is: a black
    top-hat over the brightest channel finds it, and Otsu's threshold cuts it out. The mask is grown by a pixel or two,
    so that no rim stays.

    By `least_contrast` of their surroundings' code value markers are darker at least; shading and noise are not.

    Raises
    ------
    ValueError
        If the picture is not uint8 (h, w, 3).
    """
    import cv2

    brightest, width = smooth_brightness(picture), picture.shape[1]
    around = without_dark_spots(brightest)
    depth = around - brightest
    otsu, _ = cv2.threshold(depth, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    if otsu < least_contrast * np.median(around):
        return np.zeros(brightest.shape, bool)
    # The rim of a marker is half covered: cut at half of Otsu's level, and only where a core was found.
    # Codes are whole, so that a level for each code of the surroundings, rounded down, is a table.
    level = np.maximum(otsu, least_contrast * np.arange(256))
    core, rim = (
        (depth > cv2.LUT(around, np.minimum(share * level, 255).astype(np.uint8))).astype(np.uint8)
        for share in (1.0, 0.5)
    )
    grow = 2 * round(max(width / 320, 0.5)) + 1
    wide, narrow = (
        cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)) for size in (2 * grow + 1, grow)
    )
    return cv2.dilate(rim & cv2.dilate(core, wide), narrow).astype(bool)


def smooth_brightness(picture: np.ndarray) -> np.ndarray:
    """Return the brightest channel (h, w) of a uint8 (h, w, 3) picture, its noise smoothed away."""
    import cv2

    _check(picture)
    # OpenCV finds the brightest channel twenty times as fast as NumPy, whose inner loop is over three values.
    channels = cv2.max(cv2.max(picture[..., 0], picture[..., 1]), picture[..., 2])
    return cv2.GaussianBlur(channels, (0, 0), 0.8 * max(picture.shape[1] / 320, 0.5))


def without_dark_spots(brightest: np.ndarray) -> np.ndarray:
    """Return a grey picture (h, w) with all that is dark and no larger than a marker closed."""
    import cv2

    size = int(max(_LARGEST_DIAMETER * brightest.shape[1], 5)) | 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return cv2.morphologyEx(brightest, cv2.MORPH_CLOSE, kernel)


def inpaint_telea(picture: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return the uint8 picture with the masked pixels filled by Telea's fast marching (2004), the paper's choice."""
    import cv2

    _check(picture, mask)
    return cv2.inpaint(picture, mask.astype(np.uint8), _RADIUS_PX, cv2.INPAINT_TELEA)


def _check(picture: np.ndarray, mask: np.ndarray | None = None) -> None:
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        raise ValueError(f"picture must be uint8 (h, w, 3), not {picture.dtype} {picture.shape}")
    if mask is not None and mask.shape != picture.shape[:2]:
        raise ValueError(f"mask has shape {mask.shape}, and the picture asks for {picture.shape[:2]}")
