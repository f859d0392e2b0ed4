"""Pictures of presses that a model predicts, how far they are from the real ones, and what they cost."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gelgap.render import PressPicture

METRICS = ("inside", "ring", "within", "whole", "SSIM", "mean abs")


@dataclass(frozen=True)
class Prediction:
    """Predicted uint8 pictures, one per press, with the fit's and a frame's processor time (None: nothing is done).

    `pose` is `marked` where a press was taken as marked by hand, `refined` where it was moved in its own picture.
    """

    name: str
    pose: str
    pictures: list[np.ndarray]
    fit_s: float | None = None
    frame_ms: float | None = None


def scores(
    predicted: np.ndarray, real: np.ndarray, center_px: tuple[float, float], radius_px: float
) -> list[float]:
    """Return the metrics of one picture, PSNR in dB by region."""
    from skimage.metrics import structural_similarity

    rows, columns = np.indices(real.shape[:2])
    share = np.hypot(columns - center_px[0], rows - center_px[1]) / radius_px
    error = predicted.astype(float) - real
    regions = (share < 1, (share >= 1) & (share < 2), share < 2, np.ones_like(share, bool))
    levels = [float(10 * np.log10(255**2 / max(np.mean(error[r] ** 2), 1e-9))) for r in regions]
    ssim = float(structural_similarity(predicted, real, channel_axis=2))
    return [*levels, ssim, float(np.abs(error).mean())]


def score_presses(prediction: Prediction, presses: Sequence[PressPicture]) -> list[list[float]]:
    """Return the metrics of each press."""
    return [
        scores(picture, press.picture, press.center_px, press.radius_px)
        for picture, press in zip(prediction.pictures, presses, strict=True)
    ]


def table_row(prediction: Prediction, values: list[list[float]]) -> list:
    """Return a row of medians, in brackets the worst."""
    medians, worst = np.median(values, axis=0), np.min(values, axis=0)
    levels = [f"{m:.1f} ({w:.1f})" for m, w in zip(medians[:4], worst[:4], strict=True)]
    times = ["" if t is None else round(t, 1) for t in (prediction.fit_s, prediction.frame_ms)]
    return [prediction.name, prediction.pose, *levels, f"{medians[4]:.3f}", f"{medians[5]:.2f}", *times]
