"""One trial on the real ball presses: how far a method's contact points lie from the marks of presses it has not seen.

A draw deals the clips, twenty successive presses each, to two halves: labels and unlabelled pictures come from one, the
other is tested. Draws come in pairs that exchange the halves, so that every clip is tested equally often.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gelgap.benchmarks.common import bootstrap as bootstrap_interval
from gelgap.benchmarks.real.plain_points import center_of_change_px, level_point_px
from gelgap.benchmarks.real.press_windows import Windows, windows_of
from gelgap.benchmarks.real.published_sets import MM_PER_PX
from gelgap.domains import LabelledFrames

DRAWS = tuple(range(4))
NO_LABELS, FEW = 0, (5, 20, 100)
_LEVEL_RADIUS_PX = 16.0


@dataclass(frozen=True)
class PointRecord:
    """A finished trial: mean distance from the marks on each tested clip, mm, as it is and without its mean error.

    `offset_mm` is that mean error (x, y). `configuration` is a hash of what all trials have in common.
    """

    method: str
    labels: int
    draw: int
    configuration: str
    clip_mm: dict[str, float]
    clip_centered_mm: dict[str, float]
    offset_mm: tuple[float, float]
    seconds: float

    @property
    def key(self) -> tuple[str, int, int]:
        """What the trial was."""
        return self.method, self.labels, self.draw


@dataclass(frozen=True)
class RealPresses:
    """All marked presses, and where the rules without a network see them, (n, 2) mm."""

    frames: LabelledFrames

    @cached_property
    def clip(self) -> np.ndarray:
        """The clip of each press (n,)."""
        return self.frames.columns["clip"].astype(str)

    @cached_property
    def center_of_change_mm(self) -> np.ndarray:
        """Centroids of the change."""
        return self._seen(
            lambda picture, reference: center_of_change_px(picture.astype(np.int16) - reference)
        )

    @cached_property
    def windows(self) -> Windows:
        """What networks see of them."""
        return windows_of(self.frames)

    @cached_property
    def level_point_mm(self) -> np.ndarray:
        """Where the change vanishes."""
        return self._seen(lambda picture, reference: level_point_px(picture, reference, _LEVEL_RADIUS_PX))

    def _seen(self, rule: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
        references = self.frames.references_at()
        pairs = ((self.frames.picture(k), references[r]) for k, r in enumerate(self.frames.reference_id))
        found_px = np.array([rule(picture, reference) for picture, reference in pairs])
        height, width = references.shape[1:3]
        return (found_px - np.array([width - 1, height - 1]) / 2) * MM_PER_PX

    def halves(self, draw: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the presses that a draw may learn from, and those that it is tested on."""
        clips = np.random.default_rng(draw // 2).permutation(np.unique(self.clip))
        tested = np.isin(self.clip, clips[draw % 2 :: 2])
        return np.flatnonzero(~tested), np.flatnonzero(tested)

    def labelled(self, draw: int, count: int) -> np.ndarray:
        """Return the presses whose marks a draw may learn from."""
        pool, _ = self.halves(draw)
        return np.random.default_rng([draw, count]).choice(pool, min(count, len(pool)), replace=False)


def record_of(
    presses: RealPresses,
    trial: tuple[str, int, int],
    configuration: str,
    predicted_mm: np.ndarray,
    seconds: float,
) -> PointRecord:
    """Return the record of a method's points (tested presses, 2)."""
    _, tested = presses.halves(trial[2])
    error_mm = predicted_mm - presses.frames.label_values[tested]
    offset_mm = error_mm.mean(axis=0)

    def by_clip(errors: np.ndarray) -> dict[str, float]:
        distance_mm, clip = np.hypot(*errors.T), presses.clip[tested]
        return {name: round(float(distance_mm[clip == name].mean()), 5) for name in np.unique(clip).tolist()}

    return PointRecord(
        *trial,
        configuration,
        by_clip(error_mm),
        by_clip(error_mm - offset_mm),
        tuple(np.round(offset_mm, 5).tolist()),
        round(seconds, 2),
    )


@dataclass(frozen=True)
class PlainMethod:
    """A rule, and how it predicts the tested presses of a draw from that many labelled ones."""

    name: str
    labels: tuple[int, ...]
    predict: Callable[[RealPresses, int, int], np.ndarray]


def _constant(presses: RealPresses, draw: int, labels: int) -> np.ndarray:
    _, tested = presses.halves(draw)
    few = presses.frames.label_values[presses.labelled(draw, labels)]
    return np.broadcast_to(few.mean(axis=0), (len(tested), 2))


def _centroid(presses: RealPresses, draw: int, labels: int) -> np.ndarray:
    return presses.center_of_change_mm[presses.halves(draw)[1]]


def _regressed_centroid(presses: RealPresses, draw: int, labels: int) -> np.ndarray:
    return _regressed(presses, presses.center_of_change_mm, draw, labels)


def _level(presses: RealPresses, draw: int, labels: int) -> np.ndarray:
    return presses.level_point_mm[presses.halves(draw)[1]]


def _regressed_level(presses: RealPresses, draw: int, labels: int) -> np.ndarray:
    return _regressed(presses, presses.level_point_mm, draw, labels)


def _regressed(presses: RealPresses, seen_mm: np.ndarray, draw: int, labels: int) -> np.ndarray:
    """Regress the marks on what a rule sees, linearly, and predict the tested presses."""
    few = presses.labelled(draw, labels)
    columns = np.column_stack([np.ones(len(seen_mm)), seen_mm])
    fitted = np.linalg.lstsq(columns[few], presses.frames.label_values[few], rcond=None)[0]
    return columns[presses.halves(draw)[1]] @ fitted


PLAIN_METHODS = (
    PlainMethod("constant mean", FEW, _constant),
    PlainMethod("centroid of the change", (NO_LABELS,), _centroid),
    PlainMethod("centroid, linear regression", FEW, _regressed_centroid),
    PlainMethod("point of no change", (NO_LABELS,), _level),
    PlainMethod("point of no change, linear regression", FEW, _regressed_level),
)


@dataclass(frozen=True)
class Errors:
    """What the records of one method with one number of labels say together: errors (clips, pairs of draws)."""

    method: str
    labels: int
    mm: np.ndarray
    centered_mm: np.ndarray
    offset_mm: np.ndarray
    seconds: float

    @property
    def mean_mm(self) -> float:
        """Mean distance over clips and pairs of draws."""
        return float(np.nanmean(self.mm))

    @property
    def interval_mm(self) -> tuple[float, float]:
        """Its 95 % interval, by the bootstrap over clips and pairs of draws."""
        return bootstrap_interval(self.mm)


def errors_of(records: list[PointRecord]) -> Errors:
    """Return the errors of records of one method with one number of labels."""
    clips = sorted({clip for record in records for clip in record.clip_mm})
    pairs = sorted({record.draw // 2 for record in records})

    def table(field: str) -> np.ndarray:
        found = np.full((len(clips), len(pairs)), np.nan)
        for record in records:
            for clip, error_mm in getattr(record, field).items():
                found[clips.index(clip), pairs.index(record.draw // 2)] = error_mm
        return found

    return Errors(
        records[0].method,
        records[0].labels,
        table("clip_mm"),
        table("clip_centered_mm"),
        np.mean([record.offset_mm for record in records], axis=0),
        float(np.median([record.seconds for record in records])),
    )
