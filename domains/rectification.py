"""A quadrilateral of a picture, such as a sensor's pad seen at an angle, warped to an upright rectangle."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Rectification:
    """The perspective warp of four corners to a picture of `size_px` (width, height).

    `corners_px` are (x, y) of the top left, top right, bottom left and bottom right corner.
    """

    corners_px: tuple[tuple[float, float], ...]
    size_px: tuple[int, int]

    def __call__(self, picture: np.ndarray) -> np.ndarray:
        """Return the picture (h, w, 3) of the quadrilateral, interpolated linearly.

        Raises
        ------
        ValueError
            If it is not inside the picture.
        """
        import cv2

        corners = np.float32(self.corners_px)
        if corners.min() < 0 or (corners > picture.shape[1::-1]).any():
            raise ValueError(
                f"the corners {corners.tolist()} lie outside of a picture of {picture.shape[1]}×{picture.shape[0]} px"
            )
        width, height = self.size_px
        upright = [(0, 0), (width, 0), (0, height), (width, height)]
        matrix = cv2.getPerspectiveTransform(corners, np.float32(upright))
        return cv2.warpPerspective(picture, matrix, self.size_px)
