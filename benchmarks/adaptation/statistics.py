"""Comparing methods over groups and seeds: bootstrap intervals of paired differences, ranks, critical difference."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESAMPLES = 4000
CAVEAT = (
    "A description, not a test: the nine groups are made of four domains, groups of one source share its first stage, "
    "and mb0i0 and wmb0i0 show the same contacts, so they are not nine independent cases."
)


def check_installed() -> None:
    """Stop, before anything is measured, if the package that compares methods is missing.

    Raises
    ------
    ModuleNotFoundError
        If scikit-posthocs is not installed.
    """
    try:
        import scikit_posthocs  # noqa: F401
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            "comparing methods needs scikit-posthocs: pip install gelgap[benchmark]"
        ) from None


def bootstrap_interval(values: np.ndarray, seed: int = 0) -> tuple[float, float]:
    """Return the 95 % percentile interval of the mean of values (groups, seeds), NaN where there is no run.

    Groups and seeds are drawn with replacement, independently of each other: a seed gives all groups their split and
    their initial weights, so that its runs are drawn together. The interval is NaN for one group, or where a group
    has no run.
    """
    there = ~np.isnan(values)
    if len(values) < 2 or not there.any(axis=1).all():
        return math.nan, math.nan
    rng = np.random.default_rng(seed)
    groups = rng.integers(len(values), size=(RESAMPLES, len(values), 1))
    seeds = rng.integers(values.shape[1], size=(RESAMPLES, 1, values.shape[1]))
    drawn, count = np.where(there, values, 0.0)[groups, seeds], there[groups, seeds].sum(axis=2)
    by_group = np.where(count > 0, drawn.sum(axis=2) / np.maximum(count, 1), np.nan)
    means = np.nanmean(by_group, axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


def ranks(errors: np.ndarray) -> np.ndarray:
    """Return the rank (methods, cases) of each method in each case, 1 the best, ties shared; NaN is worst."""
    from scipy.stats import rankdata

    return rankdata(np.where(np.isnan(errors), np.inf, errors), axis=0)


@dataclass(frozen=True)
class Difference:
    """A method's errors less its control's over the same groups and seeds, N; negative where it is better.

    `interval_n` is the bootstrap's; `better` counts the groups whose mean over seeds is negative; `leaving_out_n` holds
    the smallest and the largest mean when one domain's groups are left out.
    """

    mean_n: float
    interval_n: tuple[float, float]
    better: int
    groups: int
    leaving_out_n: tuple[float, float]


def paired_difference(own: np.ndarray, control: np.ndarray, groups: Sequence[tuple[str, str]]) -> Difference:
    """Return the difference of errors (groups, seeds); NaN where one of them has no run."""
    difference = own - control
    there = ~np.isnan(difference)
    by_group = np.where(there, difference, 0.0).sum(axis=1) / np.where(
        there.any(axis=1), there.sum(axis=1), np.nan
    )
    domains = dict.fromkeys(domain for group in groups for domain in group)
    kept = [np.array([domain not in group for group in groups]) for domain in domains]
    without = [float(by_group[rows].mean()) for rows in kept if rows.any()]
    return Difference(
        mean_n=float(by_group.mean()),
        interval_n=bootstrap_interval(difference),
        better=int((by_group < 0).sum()),
        groups=len(by_group),
        leaving_out_n=(min(without), max(without)) if without else (math.nan, math.nan),
    )


def kendall_tau(errors: Sequence[float]) -> float:
    """Return Kendall's τ between the order of some errors and their falling order; 1: each is below the one before."""
    from scipy.stats import kendalltau

    return float(kendalltau(np.arange(len(errors)), -np.asarray(errors)).statistic)


def critical_difference(methods: int, cases: int, level: float = 0.05) -> float:
    """Return Nemenyi's critical difference of mean ranks (Demšar, JMLR 7, 2006)."""
    from scipy.stats import studentized_range

    q = studentized_range.ppf(1 - level, methods, np.inf) / np.sqrt(2)
    return float(q * np.sqrt(methods * (methods + 1) / (6 * cases)))


def friedman_p(errors: np.ndarray) -> float:
    """Return the p value of Friedman's test that methods (rows, at least 3) do not differ over cases (columns)."""
    from scipy.stats import friedmanchisquare

    return float(friedmanchisquare(*ranks(errors)).pvalue) if len(errors) > 2 else math.nan


def plot_critical_difference(methods: Sequence[str], errors: np.ndarray, title: str) -> "Figure":
    """Draw the mean ranks of methods by their errors (methods, cases); bars join those that Nemenyi's test does not
    tell apart at 5 %."""
    from matplotlib.figure import Figure
    from pandas import DataFrame
    from scikit_posthocs import critical_difference_diagram, posthoc_nemenyi_friedman

    found = ranks(errors)
    figure = Figure(figsize=(8, 1.4 + 0.4 * len(methods)), layout="constrained")
    axes = figure.subplots()
    critical_difference_diagram(
        dict(zip(methods, found.mean(axis=1), strict=True)),
        posthoc_nemenyi_friedman(DataFrame(found.T, columns=list(methods))),
        cd=critical_difference(*found.shape),
        ax=axes,
        label_fmt_left="{label}  {rank:.2f}",
        label_fmt_right="{rank:.2f}  {label}",
        text_h_margin=0.1,
    )
    axes.set_title(f"{title} (1: least error)", pad=20)
    return figure
