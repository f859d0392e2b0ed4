"""Methods without a network: a constant, and a quadratic in how much a picture differs from rest.

Each is a function of a fold that returns its Fz (n,) in N for the fold's test pictures.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gelgap.benchmarks.real.clip_folds import ClipFold
from gelgap.benchmarks.real.sessions import Session

_DEGREE = 2


@dataclass(frozen=True)
class ForceMethod:
    """A way to tell the force of the target's pictures, and whose labels it takes."""

    name: str
    labels: str
    predict: Callable[[ClipFold], np.ndarray]


def _constant(fold: ClipFold) -> np.ndarray:
    return np.full(len(fold.test.fz_n), fold.source.fz_n.mean())


def _quadratic(fold: ClipFold) -> np.ndarray:
    return _fitted(fold.source.change, fold.source, fold.test.change)


def _standardised(fold: ClipFold) -> np.ndarray:
    """Standardise each domain's change of pictures by the mean and deviation of its own training pictures."""
    own = _standard(fold.source.change, fold.source)
    return _fitted(own, fold.source, _standard(fold.test.change, fold.target))


def _with_target_labels(fold: ClipFold) -> np.ndarray:
    return _fitted(fold.target.change, fold.target, fold.test.change)


def _fitted(change: np.ndarray, labelled: Session, tested: np.ndarray) -> np.ndarray:
    return np.polynomial.Polynomial.fit(change, labelled.fz_n, _DEGREE)(tested)


def _standard(change: np.ndarray, session: Session) -> np.ndarray:
    return (change - session.change.mean()) / session.change.std()


PLAIN_METHODS = (
    ForceMethod("constant mean", "source", _constant),
    ForceMethod("quadratic in the mean difference", "source", _quadratic),
    ForceMethod("the same, standardised per domain", "source", _standardised),
    ForceMethod("quadratic in the mean difference", "target", _with_target_labels),
)
