"""Splits by clip: each clip of a session is tested in one fold of a seed, each object in as many as it can be."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gelgap.benchmarks.real.sessions import Session

FOLDS = 3
SEEDS = (0, 1, 2, 3, 4)


@dataclass(frozen=True)
class ClipFold:
    """One fold of one seed: what a method may train on, and the target's clips that it is tested on.

    The target's training clips come without labels unless a method says that it uses them.
    """

    seed: int
    number: int
    source: Session
    target: Session
    test: Session


def clip_folds(source: Session, target: Session, seed: int) -> Iterator[ClipFold]:
    """Yield the folds of a seed, which deals the clips of each object anew; the source's are dealt too."""
    dealt = [
        _deal(session, np.random.default_rng((seed, place))) for place, session in enumerate((source, target))
    ]
    for number in range(FOLDS):
        training = [
            session.of([clip for clip, fold in folds.items() if fold != number])
            for session, folds in zip((source, target), dealt, strict=True)
        ]
        test = target.of([clip for clip, fold in dealt[1].items() if fold == number])
        yield ClipFold(seed, number, *training, test)


def _deal(session: Session, rng: np.random.Generator) -> dict[str, int]:
    """Return the fold of each clip: those of an object go round the folds, in random order from a random one."""
    folds = {}
    for name in np.unique(session.object):
        clips = rng.permutation(np.unique(session.clip[session.object == name]))
        start = int(rng.integers(FOLDS))
        folds |= {str(clip): (start + place) % FOLDS for place, clip in enumerate(clips)}
    return folds
