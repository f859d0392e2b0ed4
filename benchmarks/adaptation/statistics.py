"""What can be said of methods that were compared on groups of few sensors: intervals and p-values by pair and seed.

Groups of the same two sensors, in either direction or with other markers, are not independent, and a seed gives all
groups their split and weights. So pairs of sensors and seeds are drawn with replacement, a pair with all its groups.
"""

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.stats import kendalltau

from gelgap.benchmarks.common import RESAMPLES


def sensor_pair(group: str) -> tuple[str, ...]:
    """Return the two sensors, gel and light, of a group such as "mb0i0 → wmb1i1", in alphabetical order."""
    return tuple(sorted(name.removeprefix("w").removeprefix("m") for name in group.split(" → ")))


def drawn_means(values: np.ndarray, pairs: Sequence[object]) -> np.ndarray:
    """Return the means (RESAMPLES, …) of values (…, groups, seeds) over drawn pairs and seeds; the same in every call.

    Draws with fewer than two pairs or seeds to choose from have no meaning: then all are NaN.
    """
    seeds = values.shape[-1]
    _, member = np.unique(np.array([repr(pair) for pair in pairs]), return_inverse=True)
    count = int(member.max()) + 1
    if count < 2 or seeds < 2 or np.isnan(values).any():
        return np.full((RESAMPLES, *values.shape[:-2]), math.nan)
    rng = np.random.default_rng(0)
    of_pairs = rng.multinomial(count, np.full(count, 1 / count), RESAMPLES)[:, member].astype(float)
    of_seeds = rng.multinomial(seeds, np.full(seeds, 1 / seeds), RESAMPLES) / seeds
    of_pairs /= of_pairs.sum(axis=1, keepdims=True)
    return np.einsum("rg,rs,...gs->r...", of_pairs, of_seeds, values)


def interval(draws: np.ndarray) -> tuple[float, float]:
    """Return the 95 % percentile interval of draws (resamples,)."""
    low, high = np.percentile(draws, [2.5, 97.5])
    return float(low), float(high)


def p_value(draws: np.ndarray) -> float:
    """Return the two-sided p of a difference being 0, from its draws; never below 2/(draws + 1)."""
    if np.isnan(draws).any():
        return math.nan
    least = min((draws <= 0).sum(), (draws >= 0).sum())
    return float(min(1.0, 2 * (1 + least) / (len(draws) + 1)))


def holm(p_values: pd.Series) -> pd.Series:
    """Return p-values adjusted for their number by Holm's procedure (Scandinavian Journal of Statistics 6, 1979)."""
    known = p_values.dropna().sort_values(kind="stable")
    factors = len(known) - np.arange(len(known))
    return (known * factors).clip(upper=1.0).cummax().reindex(p_values.index)


def halves(errors: pd.DataFrame) -> str:
    """Say how alike the orders of methods (columns) by errors (groups and seeds) are in two halves of the seeds.

    Nothing with a single seed or fewer than three methods.
    """
    seeds = errors.index.get_level_values(1)
    known = list(dict.fromkeys(seeds))
    if len(known) < 2 or errors.shape[1] < 3:
        return ""
    of_halves = [errors[seeds.isin(known[k::2])] for k in (0, 1)]
    means = [half.groupby(level=0).mean().mean(skipna=False).to_numpy() for half in of_halves]
    return f"Order of methods in two halves of the seeds: Kendall's τ = {kendalltau(*means).statistic:.2f}."
