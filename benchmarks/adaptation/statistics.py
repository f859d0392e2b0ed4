"""Comparing methods over groups and seeds: bootstrap intervals, paired tests, ranks, critical-difference plot."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

BOOTSTRAPS = 4000
CAVEAT = (
    "The groups are not independent: nine groups are made of four domains, groups of one source share its first stage, "
    "and mb0i0 and wmb0i0 show the same contacts. A rank test takes them for independent, so that its p values are too "
    "small and its critical difference too short; with all nine differences of one sign the smallest possible p is "
    "0.004, which four domains cannot support. Read them as a description. The last columns leave out one domain at a "
    "time, which is the honest spread."
)


def bootstrap_interval(values: np.ndarray, seed: int = 0) -> tuple[float, float]:
    """Return the 95 % interval of the mean of values (groups, seeds): groups are drawn, then seeds within each.

    NaN is a seed that a group has not; the interval is NaN if a group has none.
    """
    rng = np.random.default_rng(seed)
    there = ~np.isnan(values)
    count = there.sum(axis=1)
    if not count.all():
        return float("nan"), float("nan")
    groups, seeds = values.shape
    sorted_values = np.take_along_axis(values, np.argsort(~there, axis=1, kind="stable"), axis=1)
    rows = rng.integers(0, groups, (BOOTSTRAPS, groups, 1))
    columns = (rng.random((BOOTSTRAPS, groups, seeds)) * count[rows]).astype(int)
    low, high = np.quantile(sorted_values[rows, columns].mean(axis=(1, 2)), [0.025, 0.975])
    return float(low), float(high)


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
    from scipy.stats import wilcoxon

    there = ~np.isnan(errors).all(axis=0)
    base = errors[methods.index(against)]
    found = []
    for method, own in zip(methods, errors, strict=True):
        if method == against or not there.any(axis=1).all() or np.isnan((own - base)[there]).any():
            continue
        by_run = (own - base)[there]
        by_group = np.array([(own - base)[i, there[i]].mean() for i in range(len(there))])
        if not by_run.any():
            p_groups = p_runs = 1.0
        else:
            p_groups, p_runs = (float(wilcoxon(d).pvalue) for d in (by_group, by_run))
        without = [by_group[kept].mean() for kept in _leaving_out(groups) if kept.any()]
        found.append(
            Comparison(
                first=method,
                second=against,
                difference_n=float(by_group.mean()),
                p_groups=p_groups,
                p_runs=p_runs,
                wins=int((by_group < 0).sum()),
                cases=len(by_group),
                leaving_out=(float(min(without)), float(max(without))),
            )
        )
    return _holm(found)


def _leaving_out(groups: Sequence[tuple[str, str]]) -> list[np.ndarray]:
    domains = dict.fromkeys(domain for group in groups for domain in group)
    return [np.array([domain not in group for group in groups]) for domain in domains]


def _holm(found: list[Comparison]) -> list[Comparison]:
    from dataclasses import replace

    for name in ("p_groups", "p_runs"):
        order = sorted(range(len(found)), key=lambda i: getattr(found[i], name))
        largest = 0.0
        for place, i in enumerate(order):
            largest = max(largest, min(1.0, (len(found) - place) * getattr(found[i], name)))
            found[i] = replace(found[i], **{name: largest})
    return found


def critical_difference(methods: int, cases: int, level: float = 0.05) -> float:
    """Return Nemenyi's critical difference of mean ranks (Demšar, JMLR 7, 2006)."""
    from scipy.stats import studentized_range

    q = studentized_range.ppf(1 - level, methods, np.inf) / np.sqrt(2)
    return float(q * np.sqrt(methods * (methods + 1) / (6 * cases)))


def friedman_p(errors: np.ndarray) -> float:
    """Return the p value of Friedman's test that methods (rows, at least 3) do not differ over cases (columns)."""
    from scipy.stats import friedmanchisquare

    if len(errors) < 3:
        return float("nan")
    return float(friedmanchisquare(*ranks(errors)).pvalue)


def plot_critical_difference(
    mean_ranks: dict[str, float], difference: float, title: str, path: Path | None = None
):
    """Draw mean ranks on a line; bars join methods that differ by less than the critical difference."""
    from matplotlib.figure import Figure

    ordered = sorted(mean_ranks.items(), key=lambda item: item[1])
    figure = Figure(figsize=(7, 0.9 + 0.34 * len(ordered)), layout="constrained")
    axes = figure.subplots()
    for row, (method, rank) in enumerate(ordered):
        axes.plot([rank, rank], [0, -1 - row], color="0.6", linewidth=0.8)
        axes.plot(rank, 0, "ko", markersize=4)
        axes.text(rank + 0.05, -1 - row, f"{method}  {rank:.2f}", va="center", fontsize=9)
    last = 0.0
    for i, (_, start) in enumerate(ordered):
        end = max(rank for _, rank in ordered if rank - start < difference)
        if end > max(last, start):
            axes.plot([start, end], [0.25 + 0.2 * i] * 2, color="k", linewidth=3, solid_capstyle="round")
            last = end
    axes.plot([1, 1 + difference], [0.6 + 0.2 * len(ordered)] * 2, color="tab:red", linewidth=2)
    axes.text(1, 0.75 + 0.2 * len(ordered), f"critical difference {difference:.2f}", fontsize=8)
    axes.set(title=title, xlabel="mean rank (1: least error)", yticks=[], xlim=(0.8, len(ordered) + 1.2))
    for side in ("left", "right", "top"):
        axes.spines[side].set_visible(False)
    if path is not None:
        figure.savefig(path, dpi=110)
    return figure
