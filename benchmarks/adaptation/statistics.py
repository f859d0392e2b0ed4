"""Comparing methods over groups and seeds: bootstrap intervals, paired tests, ranks and their critical difference."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESAMPLES = 4000
CAVEAT = (
    "The groups are not independent: nine groups are made of four domains, groups of one source share its first stage, "
    "and mb0i0 and wmb0i0 show the same contacts. A rank test takes them for independent, so that its p values are too "
    "small and its critical difference too short; with all nine differences of one sign the smallest possible p is "
    "0.004, which four domains cannot support. Read them as a description. The last columns leave out one domain at a "
    "time, which is the honest spread."
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
    """Return the 95 % interval of the mean of values (groups, seeds): groups are drawn, then seeds within each.

    NaN is a seed that a group has not. The interval is NaN if a group has none, or if there is one group.
    """
    from scipy.stats import bootstrap

    count = (~np.isnan(values)).sum(axis=1)
    if len(values) < 2 or not count.all():
        return math.nan, math.nan
    rng = np.random.default_rng(seed)
    present_first = np.sort(values, axis=1)

    def mean_of_drawn_seeds(groups: np.ndarray, axis: int) -> np.ndarray:
        drawn = rng.random((*groups.shape, values.shape[1])) * count[groups][..., None]
        return present_first[groups[..., None], drawn.astype(int)].mean(axis=(axis - 1, -1))

    groups = (np.arange(len(values)),)
    found = bootstrap(groups, mean_of_drawn_seeds, n_resamples=RESAMPLES, method="percentile", rng=rng)
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


def ranks(errors: np.ndarray) -> np.ndarray:
    """Return the rank (methods, cases) of each method in each case, 1 the best, ties shared; NaN is worst."""
    from scipy.stats import rankdata

    return rankdata(np.where(np.isnan(errors), np.inf, errors), axis=0)


@dataclass(frozen=True)
class Comparison:
    """A method against another over the same cases; `difference_n` is the mean of first minus second, N.

    `p_groups` is Wilcoxon's signed-rank p over the groups' means, `p_runs` over all runs (groups × seeds), both
    two-sided and Holm-corrected over the comparisons of a table; `leaving_out` holds the smallest and the largest mean
    difference when one domain's groups are left out.
    """

    first: str
    second: str
    difference_n: float
    p_groups: float
    p_runs: float
    wins: int
    cases: int
    leaving_out: tuple[float, float]


def compare(
    errors: np.ndarray, methods: Sequence[str], groups: Sequence[tuple[str, str]], against: str
) -> list[Comparison]:
    """Compare every method with one of them; errors (methods, groups, seeds) in N.

    A pair of group and seed that is NaN for all methods was not run. A method with another NaN (a collapse) is left
    out, and so is one without a run in some group.
    """
    there = ~np.isnan(errors).all(axis=0)
    base = errors[methods.index(against)]
    found = []
    for method, own in zip(methods, errors, strict=True):
        difference = own - base
        if method == against or not there.any(axis=1).all() or np.isnan(difference[there]).any():
            continue
        by_group = np.array([row[kept].mean() for row, kept in zip(difference, there, strict=True)])
        without = [by_group[kept].mean() for kept in _leaving_out(groups) if kept.any()]
        found.append(
            Comparison(
                first=method,
                second=against,
                difference_n=float(by_group.mean()),
                p_groups=_wilcoxon_p(by_group),
                p_runs=_wilcoxon_p(difference[there]),
                wins=int((by_group < 0).sum()),
                cases=len(by_group),
                leaving_out=(float(min(without)), float(max(without))),
            )
        )
    p_groups, p_runs = (_holm([getattr(c, name) for c in found]) for name in ("p_groups", "p_runs"))
    return [replace(c, p_groups=g, p_runs=r) for c, g, r in zip(found, p_groups, p_runs, strict=True)]


def _wilcoxon_p(differences: np.ndarray) -> float:
    from scipy.stats import wilcoxon

    return float(wilcoxon(differences).pvalue) if differences.any() else 1.0


def _leaving_out(groups: Sequence[tuple[str, str]]) -> list[np.ndarray]:
    domains = dict.fromkeys(domain for group in groups for domain in group)
    return [np.array([domain not in group for group in groups]) for domain in domains]


def _holm(p_values: Sequence[float]) -> list[float]:
    from statsmodels.stats.multitest import multipletests

    return multipletests(p_values, method="holm")[1].tolist() if p_values else []


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
