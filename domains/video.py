"""The pictures of a video file and their times; OpenCV's FFmpeg decodes them."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cv2 import VideoCapture

VIDEOS = (".avi", ".mp4", ".mov", ".mkv", ".webm")


def video_pictures(path: Path) -> Iterator[np.ndarray]:
    """Yield the pictures (h, w, 3) uint8 RGB of a video.

    Raises
    ------
    ValueError
        If the file is no video that can be read.
    """
    with _opened(path) as video:
        while True:
            done, picture = video.read()
            if not done:
                return
            yield np.ascontiguousarray(picture[..., ::-1])


def video_times_s(path: Path) -> np.ndarray:
    """Return the times (n,) of a video's pictures, s; raises what `video_pictures` does."""
    import cv2

    times = []
    with _opened(path) as video:
        while video.grab():
            times.append(video.get(cv2.CAP_PROP_POS_MSEC) / 1000)
    return np.array(times)


@contextmanager
def _opened(path: Path) -> "Iterator[VideoCapture]":
    import cv2

    video = cv2.VideoCapture(str(path.resolve()), cv2.CAP_FFMPEG)
    try:
        if not video.isOpened():
            raise ValueError(f"{path} is not a video that can be read")
        yield video
    finally:
        video.release()
