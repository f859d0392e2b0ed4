"""What goes wrong while a sensor is recorded, found in the clip itself: in its pictures, and in the log of its gauge.

Cameras stall and repeat a picture, begin with pictures in other colours, lose a line and show the view shifted, and set
their exposure anew; gauges stand at their limit, and logs repeat a value. Thresholds are set by 45 clips of a real
sensor (6,681 pictures, docs/data.md), and stated beside what these clips have.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gelgap.data.formats.pictures import resized

REDUCED_PX = (80, 60)
_TILES = (6, 8)
_UNTOUCHED = 0.2
"""No contact is taken to touch this share of the tiles: where these change, the whole view has changed."""
_ABRUPT, _LEAST_ABRUPT, _BESIDE = 1.6, 1.8, 4
"""How many times the changes of the neighbours, and the usual change, it must exceed; how many neighbours there are."""
_LOADED, _LEAST_LOADED = 0.15, 3.5
"""Where the force changes by that share of its range, a contact does so too: the fastest real ones have 3.3."""
_GAIN_OF_ONE = 0.01
_MOST_UNLIKE = 1 / 3
"""Small steps that leave out more are those of compression, which renews whole pictures now and then."""
_AFTER_GAP = 1.5
_LEAST_CHANGE = 0.5
"""Of 255: as in the real clips. Compressed video shows nothing for some pictures, and then all at once."""
_LIKE = 0.1
"""The most that a channel's light may change between pictures of one view. The exposure steps by 0.03 in 11 clips."""
_REPEATED = 0.98
"""A repeated picture has at least this share of the values of the one before. The real clips have 0.65 at most."""
_QUIET = 0.75
"""A camera in whose pictures more values than this stay is quiet, or its video is compressed: pictures may repeat."""
_UNSETTLED, _LEAST_DRIFT = 0.05, 0.03
_LONGEST_STAND = 3.5
"""A log stands still where a value repeats for longer than this many of its usual runs."""
_AT_REST, _FEWEST_CHANGES = 0.1, 10
_LEAST_TURNS, _LONGER_AT_REST = 0.3, 1.25
"""Noise alone turns at two of three rows; quantised logs, which repeat their rest, have longer runs there."""


@dataclass(frozen=True)
class ReducedPictures:
    """All pictures of a clip, reduced (n, h, w, 3) uint8, to 80×60 px at most.

    `unchanged` is which share of the values of each (n,) are those of the picture before, at full size.
    """

    pictures: np.ndarray
    unchanged: np.ndarray

    @classmethod
    def read(cls, pictures: Iterable[np.ndarray]) -> "ReducedPictures":
        reduced, unchanged, last = [], [], None
        for picture in pictures:
            reduced.append(resized(picture, _reduced_px(picture)))
            unchanged.append(0.0 if last is None else float((picture == last).mean()))
            last = picture
        return cls(np.stack(reduced), np.array(unchanged))

    def __len__(self) -> int:
        return len(self.pictures)


def _reduced_px(picture: np.ndarray) -> tuple[int, int]:
    """Return the width and height to which a picture is reduced, of whole pixels in each tile."""
    (height, width, _), (rows, columns) = picture.shape, _TILES
    if height < rows or width < columns:
        raise ValueError(f"pictures are {width}×{height} px: at least {columns}×{rows} px are needed")
    return min(REDUCED_PX[0], width // columns * columns), min(REDUCED_PX[1], height // rows * rows)


@dataclass(frozen=True)
class PictureFaults:
    """What is wrong with the pictures (n,) of a clip.

    Attributes
    ----------
    repeated
        Repeats the picture before: the camera stalled.
    in_doubt
        Repeats the picture before, in a camera so quiet that it may have seen the same: only the force can tell.
    unlike
        Shows the whole view otherwise than most of the clip: shifted, without a colour, in another light.
    light_steps
        Where the light of the whole view changes from one picture to the next, by which share: (number, share).
    """

    repeated: np.ndarray
    in_doubt: np.ndarray
    unlike: np.ndarray
    light_steps: tuple[tuple[int, float], ...]

    @property
    def usable(self) -> np.ndarray:
        return ~(self.repeated | self.unlike)


def picture_faults(clip: ReducedPictures, pressed_n: np.ndarray) -> PictureFaults:
    """Find what is wrong with the pictures (n,); where the force (n,) N changes much, contacts may be abrupt, too."""
    repeated, in_doubt = repeated_pictures(clip.unchanged)
    fresh = np.flatnonzero(~repeated)
    # Compressed video shows small changes of light of some pictures at once, too.
    may_be_abrupt = _is_loaded(pressed_n) | _is_quiet(clip.unchanged)
    unlike = np.zeros(len(clip), bool)
    by_all = _other_views(clip.pictures[fresh], may_be_abrupt[fresh])
    by_large = _other_views(clip.pictures[fresh], np.ones(len(fresh), bool))
    is_compression = np.mean(by_all[0] & ~by_large[0]) > _MOST_UNLIKE
    unlike[fresh], steps = by_large if is_compression else by_all
    # A repeat of what is left out shows that, too.
    shown = fresh[np.searchsorted(fresh, np.arange(len(clip)), "right") - 1]
    return PictureFaults(
        repeated, in_doubt, unlike | unlike[shown], tuple((int(fresh[k]), share) for k, share in steps)
    )


def repeated_pictures(unchanged: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which pictures (n,) repeat the one before, and which do so in a camera that may have seen the same.

    A camera has noise: between its pictures at rest most values change, and no two pictures are the same by chance.
    Where most values stay, as in compressed video, a repeat proves nothing.
    """
    same, nothing = unchanged >= _REPEATED, np.zeros(len(unchanged), bool)
    return (nothing, unchanged == 1) if _is_quiet(unchanged) else (same, nothing)


def _is_quiet(unchanged: np.ndarray) -> bool:
    """Return whether most values stay from one picture (n,) to the next that is no repeat."""
    differing = unchanged[1:][unchanged[1:] < _REPEATED]
    return not len(differing) or bool(np.median(differing) >= _QUIET)


def _other_views(
    pictures: np.ndarray, may_be_abrupt: np.ndarray
) -> tuple[np.ndarray, list[tuple[int, float]]]:
    """Return which pictures (n,) show another view than the longest run of them, and the steps of its light.

    Abrupt changes of the whole view divide the clip. From its longest part outwards, a part is of the same view if it
    continues the part before it, apart from a small change of light.
    """
    view = _View.of(pictures, may_be_abrupt)
    starts = [0, *(np.flatnonzero(view.changes > view.allowed) + 1).tolist(), len(pictures)]
    parts = list(pairwise(starts))
    main = max(range(len(parts)), key=lambda part: parts[part][1] - parts[part][0])
    unlike, steps = np.ones(len(pictures), bool), []
    first, last = parts[main]
    unlike[first:last] = False
    for start, stop in parts[main + 1 :]:
        share = view.step(last - 1, start)
        if share is not None:
            unlike[start:stop] = False
            steps.append((start, share))
            last = stop
    for start, stop in reversed(parts[:main]):
        share = view.step(stop - 1, first)
        if share is not None:
            unlike[start:stop] = False
            steps.append((first, share))
            first = start
    return unlike, sorted((k, share) for k, share in steps if not unlike[k - 1])


@dataclass(frozen=True)
class _View:
    """How much the whole view changes from each picture to the next (n - 1,), over its usual change, and may change.

    A press changes pictures for as long as it lasts; what is abrupt exceeds the changes beside it.
    """

    pictures: np.ndarray
    usual: np.ndarray
    changes: np.ndarray
    allowed: np.ndarray

    @classmethod
    def of(cls, pictures: np.ndarray, may_be_abrupt: np.ndarray) -> "_View":
        by_tile = np.stack([_tile_means(_absolute(b, a)) for a, b in pairwise(pictures)])
        usual = np.maximum(np.median(by_tile, axis=0), _LEAST_CHANGE)
        changes = np.quantile(by_tile / usual, _UNTOUCHED, axis=1)
        # The third largest: a picture alone makes two changes, and those are not what it is compared with.
        beside = np.lib.stride_tricks.sliding_window_view(
            np.pad(changes, _BESIDE, "reflect"), 2 * _BESIDE + 1
        )
        least = np.where(may_be_abrupt[1:], _LEAST_LOADED, _LEAST_ABRUPT)
        return cls(pictures, usual, changes, np.maximum(_ABRUPT * np.sort(beside, axis=1)[:, -3], least))

    def step(self, a: int, b: int) -> float | None:
        """Return by which share the light changes from one picture to another; None if they show different views."""
        before, after = self.pictures[a].astype(np.float32), self.pictures[b].astype(np.float32)
        # The median, as a contact changes fewer tiles than half.
        levels = [np.maximum(_tile_means(own, of_channels=True), 1) for own in (before, after)]
        gain = np.median(levels[1] / levels[0], axis=0)
        change = np.quantile(_tile_means(_absolute(after, before * gain)) / self.usual, _UNTOUCHED)
        allowed = self.allowed[a] * (1 if b == a + 1 else _AFTER_GAP)
        # Colours that go against each other are a gradient that has moved.
        is_moved = gain.min() < 1 - _GAIN_OF_ONE and gain.max() > 1 + _GAIN_OF_ONE
        is_like = np.abs(gain - 1).max() <= _LIKE and change <= allowed and not is_moved
        return float(gain.mean() - 1) if is_like else None


def _is_loaded(pressed_n: np.ndarray) -> np.ndarray:
    """Return where a force (n,) changes much within three pictures before and two behind."""
    pressed_n = np.nan_to_num(pressed_n)
    beside = np.lib.stride_tricks.sliding_window_view(np.pad(pressed_n, (3, 2), "edge"), 6)
    return np.ptp(beside, axis=1) > _LOADED * max(np.ptp(pressed_n), 1e-9)


def unsettled_pictures(pictures: np.ndarray) -> int:
    """Return how many of the first pictures (n, h, w, 3) before contact are in another light than the later half.

    Exposure settles in some tenths of a second; light that drifts by less in the half is none of it.
    """
    levels = np.maximum(pictures.mean(axis=(1, 2)), 1)
    half = len(levels) // 2
    if half < 2:
        return 0
    off = np.abs(levels[:half] / np.median(levels[half:], axis=0) - 1).max(axis=1) > _UNSETTLED
    return int(off.nonzero()[0].max(initial=-1)) + 1


def _absolute(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    return np.abs(after.astype(np.float32) - before)


def _tile_means(picture: np.ndarray, of_channels: bool = False) -> np.ndarray:
    """Return means of a picture (h, w, 3) in each tile, (tiles,), or (tiles, 3) of its channels."""
    rows, columns = _TILES
    height, width, channels = picture.shape
    tiles = picture.reshape(rows, height // rows, columns, width // columns, channels).mean(axis=(1, 3))
    by_channel = tiles.reshape(-1, channels)
    return by_channel if of_channels else by_channel.mean(axis=1)


def drift_of_light(pictures: np.ndarray) -> float:
    """Return by which share the light of a channel changes most over pictures (n, h, w, 3) at rest, from first to last.

    0 where that is less than the exposure of a camera changes by itself, 3 %.
    """
    few = max(min(len(pictures) // 2, 5), 1)
    first, last = pictures[:few].mean(axis=0), pictures[-few:].mean(axis=0)
    shares = np.median(last / np.maximum(first, 1), axis=(0, 1)) - 1
    share = float(shares[np.abs(shares).argmax()])
    return share if abs(share) >= _LEAST_DRIFT else 0.0


def stands_still(values: np.ndarray) -> np.ndarray:
    """Return where a log (n,) stands: at the limit of its gauge, or repeating what it had.

    A gauge has noise, so that a value repeats only for as many rows as it is read less often than the log is written.
    A run that is longer than three of those is none of its readings. At 0 a gauge may stand, as it is told to; and of a
    log that is quiet at rest nothing can be said.
    """
    known = np.flatnonzero(np.isfinite(values))
    stands = np.zeros(len(values), bool)
    if not len(known):
        return stands
    own = values[known]
    starts = np.flatnonzero(np.concatenate([[True], np.diff(own) != 0]))
    lengths = np.diff([*starts, len(own)])
    usual = float(np.median(lengths))
    if _has_noise(own[starts], lengths):
        long = (lengths > _LONGEST_STAND * usual) & (own[starts] != 0)
        stands[known[np.repeat(long, lengths)]] = True
    return stands


def _has_noise(levels: np.ndarray, lengths: np.ndarray) -> bool:
    """Return whether a log changes to and fro at rest, below a tenth of its largest value, as often as elsewhere."""
    at_rest = np.abs(levels) <= _AT_REST * np.abs(levels).max()
    rising = np.diff(levels[at_rest]) > 0
    if len(rising) < _FEWEST_CHANGES:
        return False
    turns = np.mean(rising[1:] != rising[:-1])
    return bool(turns >= _LEAST_TURNS and lengths[at_rest].mean() <= np.median(lengths) * _LONGER_AT_REST)


def runs(chosen: np.ndarray) -> list[tuple[int, int]]:
    """Return the first and last number of each run of what is chosen (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]])))
    return [(int(start), int(stop) - 1) for start, stop in edges.reshape(-1, 2)]
