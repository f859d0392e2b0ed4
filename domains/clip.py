"""A clip: pictures in the order of time and forces measured beside them by another clock, lined up by the clip itself.

The two clocks differ by a lag that no file states. It is estimated from the clip alone, by cross-correlation: at
which lag does the change of the pictures go best with the force? No model is trained for it, and no other clip is used.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from gelgap.domains.picture_codec import resized

CONTACT_N = 0.3
"""What is pressed harder than this is in contact."""
_REFERENCE_FRAMES = 5
_FEWEST_FRAMES = 10
_SIGNAL_PX = (80, 60)


@dataclass(frozen=True)
class Clip:
    """One recording: pictures at `time_s` (n,) and labels at `label_time_s` (m,), each by a clock of its own.

    Attributes
    ----------
    pictures
        Gives all pictures (h, w, 3) uint8 from the first, each time that it is called.
    labels
        What was measured, arrays (m,) by the name of their column, forces among them; NaN where a value is a glitch.
    lags
        The lags in frames that are possible, 0 among them; positive where the labels trail the pictures.
    """

    name: str
    object: str
    session: str
    pictures: Callable[[], Iterator[np.ndarray]]
    time_s: np.ndarray
    label_time_s: np.ndarray
    labels: dict[str, np.ndarray]
    lags: range

    @property
    def frame_s(self) -> float:
        """The time between two pictures."""
        return float(np.median(np.diff(self.time_s)))

    def labels_at(self, lag: int) -> dict[str, np.ndarray]:
        """Return the labels (n,) that belong to the pictures at a lag in frames; NaN where there are none."""
        time_s = self.time_s + lag * self.frame_s
        return {
            name: _interpolated(time_s, self.label_time_s, values, self.frame_s)
            for name, values in self.labels.items()
        }

    def pressing_at(self, lag: int) -> np.ndarray:
        """Return how hard was pressed (n,) at a lag, N."""
        return pressing_n(self.labels_at(lag))


@dataclass(frozen=True)
class AlignedClip:
    """A clip with its reference (h, w, 3), its lag in frames, and how pictures and force correlate there and at 0."""

    clip: Clip
    reference: np.ndarray
    lag: int
    correlation: float
    correlation_at_0: float

    @property
    def at_rest(self) -> int:
        """How many first pictures make the reference."""
        return _at_rest(self.clip, self.lag)

    @property
    def begins_in_contact(self) -> bool:
        """Whether the first picture that has a force is in contact already."""
        pressed_n = self.clip.pressing_at(self.lag)
        return bool(pressed_n[np.isfinite(pressed_n)][0] > CONTACT_N)


def pressing_n(labels: dict[str, np.ndarray]) -> np.ndarray:
    """Return how hard was pressed (n,): −Fz, or the size of what else of the force was measured, N."""
    if "fz_n" in labels:
        return -labels["fz_n"]
    return np.linalg.norm([labels[name] for name in ("fx_n", "fy_n") if name in labels], axis=0)


def align(clip: Clip) -> AlignedClip:
    """Find a clip's reference and its lag.

    Raises
    ------
    ValueError
        If the clip is too short, its clocks have no time in common, or its force or its pictures do not change.
    """
    if len(clip.time_s) < _FEWEST_FRAMES or len(clip.label_time_s) < _FEWEST_FRAMES:
        raise ValueError(
            f"clip {clip.name} has {len(clip.time_s)} pictures and {len(clip.label_time_s)} rows of labels; "
            f"at least {_FEWEST_FRAMES} of each are needed"
        )
    if clip.time_s[0] > clip.label_time_s[-1] or clip.label_time_s[0] > clip.time_s[-1]:
        raise ValueError(
            f"clip {clip.name}: its pictures span {clip.time_s[0]:g}…{clip.time_s[-1]:g} s, its labels "
            f"{clip.label_time_s[0]:g}…{clip.label_time_s[-1]:g} s; count both from the same moment"
        )
    change = _change(clip)
    correlations = [_correlation(change, clip.pressing_at(lag)) for lag in clip.lags]
    if np.isnan(correlations).all():
        raise ValueError(
            f"clip {clip.name}: its force or its pictures do not change; take it out of the folder"
        )
    best = int(np.nanargmax(correlations))
    at_0 = correlations[clip.lags.index(0)]
    lag = clip.lags[best]
    first = list(islice(clip.pictures(), _at_rest(clip, lag)))
    reference = np.median(first, axis=0).round().astype(np.uint8)
    return AlignedClip(clip, reference, lag, correlations[best], at_0)


def _at_rest(clip: Clip, lag: int) -> int:
    """Return how many first pictures come before the contact, less one as a lag may be wrong by one: 1 to 5."""
    touches = clip.pressing_at(lag) > CONTACT_N
    before = int(np.argmax(touches)) if touches.any() else len(touches)
    return min(max(before - 1, 1), _REFERENCE_FRAMES)


def _change(clip: Clip) -> np.ndarray:
    """Return the mean absolute difference (n,) of each picture from the first, grey levels, at 80×60 px."""
    first, change = None, []
    for picture in clip.pictures():
        small = resized(picture, _SIGNAL_PX).astype(np.int16)
        first = small if first is None else first
        change.append(np.abs(small - first).mean())
    if len(change) != len(clip.time_s):
        raise ValueError(
            f"clip {clip.name} has {len(change)} pictures and {len(clip.time_s)} times of pictures"
        )
    return np.array(change)


def _interpolated(
    time_s: np.ndarray, label_time_s: np.ndarray, values: np.ndarray, frame_s: float
) -> np.ndarray:
    """Return values (m,) at other times (n,); NaN where the nearest one is, or is more than half a frame away."""
    finite = np.isfinite(values)
    if not finite.any():
        return np.full(len(time_s), np.nan)
    found = np.interp(time_s, label_time_s[finite], values[finite])
    nearest = np.searchsorted((label_time_s[1:] + label_time_s[:-1]) / 2, time_s)
    outside = (time_s < label_time_s[0] - frame_s / 2) | (time_s > label_time_s[-1] + frame_s / 2)
    return np.where(finite[nearest] & ~outside, found, np.nan)


def _correlation(change: np.ndarray, pressed_n: np.ndarray) -> float:
    """Return Pearson's correlation over the pictures that have a force; NaN where one of the two is constant."""
    both = np.isfinite(pressed_n)
    if both.sum() < _FEWEST_FRAMES or np.ptp(change[both]) == 0 or np.ptp(pressed_n[both]) == 0:
        return np.nan
    return float(np.corrcoef(change[both], pressed_n[both])[0, 1])
