"""A few labels of a real session: which pictures are labelled, which come without labels, and which are tested.

Whole clips are tested, and no picture of theirs is seen before.
"""

from dataclasses import dataclass

import numpy as np

from gelgap.benchmarks.real.clip_folds import FOLDS, clip_folds
from gelgap.benchmarks.real.sessions import Session


@dataclass(frozen=True)
class Budget:
    """How much is labelled: whole clips, or single frames of any clips; with `other_objects` none of the tested one."""

    clips: int = 0
    frames: int = 0
    other_objects: bool = False

    @classmethod
    def of(cls, name: str) -> "Budget":
        """Return the budget of a name."""
        return next(budget for budget in BUDGETS if budget.name == name)

    @property
    def name(self) -> str:
        """What it is in words."""
        amount, what = (self.clips, "clip") if self.clips else (self.frames, "frame")
        plural, others = "s" * (amount > 1), " of other objects" * self.other_objects
        return f"{amount} {what}{plural}{others}"


BUDGETS = (
    *(Budget(clips=clips) for clips in (1, 2, 4, 8)),
    *(Budget(frames=frames) for frames in (4, 8, 16, 64)),
    Budget(clips=4, other_objects=True),
)


@dataclass(frozen=True)
class FewLabels:
    """Indices of a session's pictures: `known` without labels, of which some are `labelled`, and `tested`."""

    labelled: np.ndarray
    known: np.ndarray
    tested: np.ndarray


def few_labels(session: Session, budget: Budget, draw: int) -> FewLabels:
    """Return what a draw labels and tests; a smaller budget of the same kind labels a part of a larger one's.

    A draw tests the clips of one fold, and three draws test each clip once; or all clips of one object, one after the
    other.
    """
    if budget.other_objects:
        objects = np.unique(session.object)
        is_tested = session.object == objects[draw % len(objects)]
    else:
        folds = clip_folds(session, session, draw // FOLDS)
        test = next(fold.test for fold in folds if fold.number == draw % FOLDS)
        is_tested = np.isin(session.clip, test.clip)
    known, rng = np.flatnonzero(~is_tested), np.random.default_rng((draw, budget.other_objects))
    if budget.frames:
        labelled = np.sort(rng.permutation(known)[: budget.frames])
    else:
        clips = rng.permutation(np.unique(session.clip[known]))[: budget.clips]
        labelled = known[np.isin(session.clip[known], clips)]
    return FewLabels(labelled, known, np.flatnonzero(is_tested))
