"""The contact sheet of a real sensor's predictions: best, median and worst press, real, predicted and difference."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from gelgap.assets.whole_file import write_whole
from gelgap.benchmarks.render.predictions import Prediction, score_presses
from gelgap.render import PressPicture

REACH, SIDE_PX, CONTRAST = (
    2.2,
    200,
    4,
)  # contact radii around a press, of each square in the sheet, of differences
WITHIN = 2  # the metric that ranks presses: PSNR within two radii


def draw_contact_sheet(path: Path, presses: Sequence[PressPicture], shown: Mapping[str, Prediction]) -> None:
    """Write the sheet of predictions by their titles; presses are ranked by the first of them."""
    import cv2

    first = next(iter(shown.values()))
    level = [values[WITHIN] for values in score_presses(first, presses)]
    ranked = np.argsort(level)[::-1]
    rows = []
    for rank, label in ((0, "best"), (len(ranked) // 2, "median"), (-1, "worst")):
        press = presses[ranked[rank]]
        squares = [_square(press.picture, press)]
        for prediction in shown.values():
            picture = prediction.pictures[ranked[rank]]
            difference = np.clip(128 + CONTRAST * (picture.astype(int) - press.picture), 0, 255)
            squares += [_square(picture, press), _square(difference.astype(np.uint8), press)]
        row = np.hstack(squares)
        cv2.putText(row, f"{label}, {level[ranked[rank]]:.1f} dB", (6, 16), *_FONT)
        rows.append(row)
    names = ["real"]
    for name in shown:
        names += [name, f"128 + {CONTRAST} x difference"]
    header = np.full((22, rows[0].shape[1], 3), 40, np.uint8)
    for column, name in enumerate(names):
        cv2.putText(header, name, (column * SIDE_PX + 6, 16), *_FONT)
    sheet = np.vstack([header, *rows])
    _, encoded = cv2.imencode(".jpg", sheet[..., ::-1], (cv2.IMWRITE_JPEG_QUALITY, 90))
    write_whole(path, encoded.tobytes())


_FONT = (0, 0.42, (255, 255, 255), 1, 16)  # Hershey simplex, its size, white, one pixel wide, antialiased


def _square(picture: np.ndarray, press: PressPicture) -> np.ndarray:
    """Return what lies around a press, black beyond the picture's edge."""
    import cv2

    side = round(2 * REACH * press.radius_px)
    left, top = (round(at - side / 2) for at in press.center_px)
    padded = np.pad(picture, ((side, side), (side, side), (0, 0)))
    cut = padded[top + side : top + 2 * side, left + side : left + 2 * side]
    return cv2.resize(cut, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA)
