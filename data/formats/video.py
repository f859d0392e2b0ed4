"""The pictures of a video, and when each was taken."""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cv2 import VideoCapture

LOG = logging.getLogger(__name__)
VIDEOS = (".avi", ".mp4", ".mov", ".mkv", ".webm")
_COUNTED = (".avi", ".mp4", ".mov")  # the others state no number of pictures, but how long they are
_SOUND_S = 0.5
"""The sound of a video may last so much longer than its pictures."""


def picture_times_s(path: Path) -> np.ndarray:
    """Return when each picture of a video is shown, in s from its start."""
    return np.array([video.get(0) / 1000 for video in _grabbed(path)])  # 0 is OpenCV's CAP_PROP_POS_MSEC


def video_pictures(path: Path) -> Iterator[np.ndarray]:
    """Yield the pictures (h, w, 3) uint8 RGB of a video; a ValueError if OpenCV's FFmpeg cannot read it."""
    for video in _grabbed(path):
        done, picture = video.retrieve()
        if not done:
            return
        yield np.ascontiguousarray(picture[..., ::-1])


def _grabbed(path: Path) -> "Iterator[VideoCapture]":
    """Yield a video at each of its pictures, before it is decoded; warn if these are fewer than it states."""
    import cv2

    video = cv2.VideoCapture(str(path.resolve()), cv2.CAP_FFMPEG)
    try:
        if not video.isOpened():
            raise ValueError(f"{path} is not a video that can be read")
        read_s = 0.0
        while video.grab():
            read_s = video.get(cv2.CAP_PROP_POS_MSEC) / 1000
            yield video
        stated, read = video.get(cv2.CAP_PROP_FRAME_COUNT), video.get(cv2.CAP_PROP_POS_FRAMES)
        stated_s = stated / max(video.get(cv2.CAP_PROP_FPS), 1e-9)
        if path.suffix.lower() in _COUNTED and stated > read + 1:
            LOG.warning("%s states %d pictures, of which %d could be read", path, stated, read)
        if path.suffix.lower() not in _COUNTED and stated_s > read_s + _SOUND_S:
            LOG.warning("%s states %.1f s, of which %.1f s could be read", path, stated_s, read_s)
    finally:
        video.release()
