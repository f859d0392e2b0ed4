"""What is unusual about labels: the one judgement of them, for `gelgap inspect` and `gelgap adapt` alike."""

import numpy as np

from gelgap.domains.dataset import LabelledFrames
from gelgap.domains.labels import FORCE_COLUMNS, Labels, known_labels


def label_notes(frames: LabelledFrames) -> list[str]:
    """Return sentences on labels that are no numbers, and on forces that pull the sensor."""
    notes = []
    known = known_labels(frames.columns)
    for names, what in (
        ([name for name in known if name in FORCE_COLUMNS], "a force"),
        ([name for name in known if name not in FORCE_COLUMNS], "a label other than force"),
    ):
        wrong = np.zeros(len(frames), bool)
        for name in names:
            wrong |= ~np.isfinite(frames.columns[name])
        if wrong.any():
            notes.append(f"{int(wrong.sum())} frames have {what} that is not a number")
    pulling = int((frames.columns.get("fz_n", np.zeros(0)) > 0).sum())
    if pulling:
        notes.append(f"{pulling} frames have Fz > 0: the sensor is pulled, or the sign is another one")
    return notes


def outside(frames: LabelledFrames, labels: Labels) -> np.ndarray:
    """Return which frames (n,) have a label outside its range."""
    values = frames.values_of(labels.names)
    return np.any((values < labels.low) | (values > labels.high), axis=1)


def within_range(frames: LabelledFrames) -> LabelledFrames:
    """Return the frames whose labels lie within their ranges."""
    return frames.take(np.flatnonzero(~outside(frames, frames.labels)))
