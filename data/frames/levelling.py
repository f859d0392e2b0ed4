"""Bringing pictures to their reference's light: a lamp ages, exposure and white balance are automatic.

Each channel of a picture is gain × reference + offset wherever the contact changes nothing; levelling takes the offset
off and divides by the gain. The line is fitted robustly: the dent and moved markers are outliers. A picture whose
channels have been multiplied and shifted is levelled to the same picture as before, so a network reads the same force:
without, its error grows from 0.04 to 0.31 N (docs/adaptation.md).
"""

import numpy as np

# Of a channel's reference, the median distance from its median, in codes: below it the line's slope is not known.
_LEAST_SPREAD = 1.0
# Pixels by which a picture is levelled: enough for a line, whatever the picture's size.
_PIXELS = 800
_STEPS = 4
# Tukey's constant: 95 % of the efficiency of least squares where nothing is an outlier.
_TUKEY = 4.685
_MAD_TO_STD = 1.4826
# Channels at the ends of the range say nothing of their light.
_CLIPPED = 1, 254
# A lid on the lens leaves nothing to bring back.
_LEAST_GAIN = 0.05
_BATCH = 256


def light_of(pictures: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return gain and offset (n, 3), in codes, of pictures (n, h, w, 3) over their reference (h, w, 3), all uint8 RGB.

    Where a channel of the reference shows one brightness all over, the offset is 0; where nearly all is clipped,
    nothing is changed. Method: Theil and Sen's slope of pairs of pixels, then Tukey's biweight (Huber and Ronchetti,
    Robust Statistics, ch. 7).
    """
    every = max(1, round(np.sqrt(reference.shape[0] * reference.shape[1] / _PIXELS)))
    flat = reference[::every, ::every].reshape(-1, 3).T.astype(np.float32)
    gain, offset = np.ones((len(pictures), 3)), np.zeros((len(pictures), 3))
    for start in range(0, len(pictures), _BATCH):
        part = pictures[start : start + _BATCH, ::every, ::every]
        seen = np.moveaxis(part.reshape(len(part), -1, 3), 2, 1).astype(np.float32)
        for channel in range(3):
            lines = _lines(seen[:, channel], flat[channel])
            gain[start : start + _BATCH, channel], offset[start : start + _BATCH, channel] = lines
    return gain, offset


def levelled(pictures: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return pictures (n, h, w, 3) uint8 RGB in the light of their reference (h, w, 3), in a ms of a core each."""
    gain, offset = light_of(pictures, reference)
    codes = np.arange(256.0)
    tables = (codes - offset[..., None]) / np.maximum(gain, _LEAST_GAIN)[..., None]
    tables = np.clip(np.rint(tables), 0, 255).astype(np.uint8)
    shown = np.empty_like(pictures)
    for picture, table, out in zip(pictures, tables, shown, strict=True):
        for channel in range(3):
            out[..., channel] = table[channel][picture[..., channel]]
    return shown


def _lines(seen: np.ndarray, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return slope and intercept (n,) of the line that most pixels of one channel (n, p) follow over its rest (p,)."""
    within = (rest > _CLIPPED[0]) & (rest < _CLIPPED[1])
    rest, seen = rest[within], seen[:, within]
    n = len(seen)
    if len(rest) < 10:
        return np.ones(n), np.zeros(n)
    if np.median(np.abs(rest - np.median(rest))) < _LEAST_SPREAD:
        return np.median(seen / rest, axis=1), np.zeros(n)
    partner = np.argsort(rest, kind="stable")
    partner = partner[(np.arange(len(rest)) + len(rest) // 2) % len(rest)][np.argsort(partner, kind="stable")]
    apart = rest - rest[partner]
    wide = np.abs(apart) >= np.median(np.abs(apart))
    slope = np.median((seen - seen[:, partner])[:, wide] / apart[wide], axis=1)
    intercept = np.median(seen - slope[:, None] * rest, axis=1)
    open_range = (seen > _CLIPPED[0]) & (seen < _CLIPPED[1])
    for _ in range(_STEPS):
        residual = seen - slope[:, None] * rest - intercept[:, None]
        scale = _MAD_TO_STD * np.median(np.abs(residual), axis=1, keepdims=True)
        ratio = residual / np.maximum(_TUKEY * scale, 1e-6 * slope[:, None] + 1e-6)
        weight = np.where((np.abs(ratio) < 1) & open_range, (1 - ratio**2) ** 2, 0) + 1e-9
        total = weight.sum(axis=1)
        mean_rest, mean_seen = (weight * rest).sum(axis=1) / total, (weight * seen).sum(axis=1) / total
        away = rest - mean_rest[:, None]
        slope = (weight * away * (seen - mean_seen[:, None])).sum(axis=1) / (weight * away**2).sum(axis=1)
        intercept = mean_seen - slope * mean_rest
    return slope, intercept
