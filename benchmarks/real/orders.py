"""Do two benchmarks order methods alike? Kendall's τ between their mean errors, with a bootstrap interval."""

from dataclasses import dataclass

import numpy as np

from gelgap.benchmarks.common import mean_of

RESAMPLES = 1000


@dataclass(frozen=True)
class OrderAgreement:
    """Kendall's τ between two orders of the same methods (1: the same, −1: the reverse), and its 95 % interval."""

    tau: float
    interval: tuple[float, float]


def order_agreement(first: np.ndarray, second: np.ndarray, seed: int = 0) -> OrderAgreement:
    """Compare the orders of methods by errors (methods, cases, seeds) of each; NaN is a run that is not there.

    The interval is the bootstrap's: cases and seeds of each benchmark are drawn with replacement, the same for all
    methods, because methods share what makes a case hard.
    """
    rng = np.random.default_rng(seed)
    drawn = [_tau(_drawn(first, rng), _drawn(second, rng)) for _ in range(RESAMPLES)]
    low, high = np.nanpercentile(drawn, [2.5, 97.5])
    return OrderAgreement(_tau(first, second), (float(low), float(high)))


def _drawn(errors: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    _, cases, seeds = errors.shape
    drawn = errors[:, rng.integers(cases, size=cases)]
    return drawn[:, :, rng.integers(seeds, size=seeds)]


def _tau(first: np.ndarray, second: np.ndarray) -> float:
    from scipy.stats import kendalltau

    means = [mean_of(mean_of(errors, axis=2), axis=1) for errors in (first, second)]
    return float(kendalltau(*means).statistic)
