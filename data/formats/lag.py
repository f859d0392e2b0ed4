"""By how many frames forces trail pictures, estimated from one clip alone by cross-correlation.

At which lag does what contact changes in the pictures go best with the force? Light that drifts is taken out of the
pictures first, and a lag other than 0 is applied only where it fits better than 0 beyond its own uncertainty.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

_REST_FRAMES = 5
_FEWEST_FRAMES = 10
_LEAST_LAG = 0.2
"""Of a frame: fading lamps and compression shift clips without a lag by so much."""
_LEAST_R = 0.75
"""Clocks of other zeros are aligned where pictures and force correlate by so much."""
_RIVAL, _FALLEN = 0.97, 0.9
"""Another alignment that correlates by so much of the best is as good: presses that repeat."""


@dataclass(frozen=True)
class LagEstimate:
    """A lag in frames, and how well it is known.

    `range` are the least and the greatest lag that fit as well, None where the lag was stated; `best` is the one that
    fits best, which `lag` is only if 0 fits worse.
    """

    lag: float
    best: float | None = None
    range: tuple[float, float] | None = None
    correlation: float | None = None
    correlation_at_0: float | None = None


def pressed_signal(pictures: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Return how far each picture (n, h, w, 3) has gone from rest towards the most pressed ones, (n,).

    That is its projection on their mean difference, in which the noise of pixels averages out. What another light
    makes of the picture at rest, a gain and an offset of each channel, is taken out of all differences. Where a picture
    is not usable, the signal is interpolated.
    """
    known = np.flatnonzero(usable)
    rest = np.median(pictures[known[:_REST_FRAMES]], axis=0)
    n_channels = rest.shape[2]
    light = np.zeros((2 * n_channels, *rest.shape))
    for channel in range(n_channels):
        light[2 * channel, ..., channel] = 1
        light[2 * channel + 1, ..., channel] = rest[..., channel]
    basis = np.linalg.qr(light.reshape(len(light), -1).T)[0].astype(np.float32)
    changes = (pictures[known].astype(np.float32) - rest.astype(np.float32)).reshape(len(known), -1)
    of_light = (changes @ basis) @ basis.T
    # What a contact changes fades with the light, too.
    level = 1 + of_light.reshape(len(known), -1, n_channels).mean(axis=1) / np.maximum(
        rest.mean(axis=(0, 1)), 1
    )
    changes = (
        (changes - of_light).reshape(len(known), -1, n_channels) / np.maximum(level, 0.1)[:, None]
    ).reshape(len(known), -1)
    most = np.argsort(np.abs(changes).mean(axis=1))[-max(len(known) // 10, 1) :]
    signal = changes @ changes[most].mean(axis=0)
    return np.interp(np.arange(len(pictures)), known, signal)


def estimated_lag(
    signal: np.ndarray, usable: np.ndarray, pressed_n_at: Callable[[float], np.ndarray], lags: range
) -> LagEstimate | None:
    """Return the lag at which the force (n,) goes best with the signal (n,), and the range of those that do as well.

    Force is a cubic of the signal plus noise: what a press without release shows goes with any lag, as it should. Twice
    the log likelihood of a lag is −n log(1 − R²), and falls by 4 at the ends of an interval of 95 %. Errors of
    neighbouring pictures go together, so n is divided by the sum of their autocorrelation up to its first zero. Clocks
    alone give one lag while the signal rises and while it falls; compressed video shows slow changes late and gives
    two, and so does a gel that creeps: the range includes both. None where nothing correlates: the force or the
    pictures do not change, or fewer than ten pictures have labels.
    """
    whole = np.array(lags, float)
    unexplained = np.array([_unexplained(signal, usable, pressed_n_at(lag)) for lag in whole])
    if np.isnan(unexplained).all():
        return None
    # A frame takes as long as 0.05 N in a press of 1.5 N/s: between whole lags, tenths are tried.
    around = whole[np.nanargmin(unexplained)] + np.arange(-15, 16) / 10
    tried = np.unique(np.concatenate([whole, around[(around >= lags[0]) & (around <= lags[-1])]]).round(1))
    pressed_n = np.stack([np.where(usable, pressed_n_at(lag), np.nan) for lag in tried])
    unexplained = np.array([_unexplained(signal, usable, own) for own in pressed_n])
    best = int(np.nanargmin(unexplained))
    line = _cubic(signal, pressed_n[best])
    independent = _independent_errors(pressed_n[best] - line)
    fitting = np.flatnonzero(unexplained <= unexplained[best] * np.exp(4 / independent)).tolist()
    is_rising = np.gradient(np.convolve(np.pad(signal, 2, "edge"), np.ones(5) / 5, "valid")) > 0
    for part in (is_rising, ~is_rising):
        errors = np.array([_mean_square(own[part] - line[part]) for own in pressed_n])
        fitting += [int(np.nanargmin(errors))] if np.isfinite(errors).any() else []
    least, most = tried[min(fitting)], tried[max(fitting)]
    low = round(max(float(least) - _LEAST_LAG, lags[0]), 1)
    high = round(min(float(most) + _LEAST_LAG, lags[-1]), 1)
    # Clocks as they are where these fit as well; else, of one zero, a whole number if the log was made with the frames.
    lag, whole_lag = float(tried[best]), float(np.round(tried[best]))
    if low <= 0 <= high:
        lag = 0.0
    elif 0 in lags and least <= whole_lag <= most:
        lag = whole_lag
    r = {
        own: _correlation(signal, pressed_n[tried == own][0]) for own in {lag, *([0.0] if 0 in lags else [])}
    }
    return LagEstimate(lag, float(tried[best]), (low, high), r[lag], r.get(0.0))


def offset_of_clocks(signal: np.ndarray, pressed_n: np.ndarray) -> int | None:
    """Return by how many frames the force (m,) trails the signal (n,), both one value a frame, however many that are.

    Both count as at rest beyond their ends, so that an alignment which leaves a press without its partner does not
    fit. None where nothing fits, or another alignment fits as well.
    """
    seen, felt = _above_rest(signal), _above_rest(pressed_n)
    size = np.sqrt(np.square(seen).sum() * np.square(felt).sum())
    if not size > 0:
        return None
    fits = np.correlate(felt, seen, "full") / size
    best = int(np.argmax(fits))
    # Beyond where the fit falls off, another peak is another alignment.
    fallen = np.flatnonzero(fits < _FALLEN * fits[best])
    left, right = fallen[fallen < best].max(initial=-1), fallen[fallen > best].min(initial=len(fits))
    others = np.concatenate([fits[: left + 1], fits[right:]])
    if fits[best] < _LEAST_R or (len(others) and others.max() > _RIVAL * fits[best]):
        return None
    return best - (len(signal) - 1)


def _above_rest(values: np.ndarray) -> np.ndarray:
    """Return values (n,) less what they are at rest, 0 where they are not known."""
    return np.nan_to_num(values - np.nanquantile(values, 0.05))


def _correlation(signal: np.ndarray, pressed_n: np.ndarray) -> float:
    """Return Pearson's correlation where both are known; NaN for too few, or if one does not change.

    Rounding would decide the latter.
    """
    known = np.isfinite(pressed_n)
    signal, pressed_n = signal[known], pressed_n[known]
    if len(pressed_n) < _FEWEST_FRAMES or np.ptp(signal) == 0 or np.ptp(pressed_n) == 0:
        return float("nan")
    return float(np.corrcoef(signal, pressed_n)[0, 1])


def _cubic(signal: np.ndarray, pressed_n: np.ndarray) -> np.ndarray:
    """Return the cubic of the signal (n,) that is nearest to the force where that is known, (n,) N."""
    known = np.isfinite(pressed_n)
    return np.polynomial.Polynomial.fit(signal[known], pressed_n[known], 3)(signal)


def _unexplained(signal: np.ndarray, usable: np.ndarray, pressed_n: np.ndarray) -> float:
    """Return the share of the force's variance that a cubic of the signal leaves; 1 where they do not rise together."""
    pressed_n = np.where(usable, pressed_n, np.nan)
    correlation = _correlation(signal, pressed_n)
    if not correlation > 0:
        return float("nan") if np.isnan(correlation) else 1.0
    return _mean_square(pressed_n - _cubic(signal, pressed_n)) / float(np.nanvar(pressed_n))


def _mean_square(errors: np.ndarray) -> float:
    known = errors[np.isfinite(errors)]
    return float(np.square(known).mean()) if len(known) >= _FEWEST_FRAMES else float("nan")


def _independent_errors(errors: np.ndarray) -> float:
    """Return how many of the errors (n,), NaN where unknown, are independent of each other, one at least."""
    errors = errors[np.isfinite(errors)]
    correlated = np.correlate(errors, errors, "full")[len(errors) - 1 :]
    positive = correlated[: np.argmax(correlated <= 0) or None]
    return (
        max(len(errors) * correlated[0] / (2 * positive.sum() - correlated[0]), 1.0) if correlated[0] else 1.0
    )
