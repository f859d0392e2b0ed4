"""The adaptation benchmark's tables of the groups: errors beside the paper's, oracles, tests and times."""

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.paper import PAPER_MAE_N
from gelgap.benchmarks.adaptation.results import Results, mean_of, over_groups
from gelgap.benchmarks.adaptation.statistics import (
    CAVEAT,
    bootstrap_interval,
    compare,
    critical_difference,
    friedman_p,
    ranks,
)

MINUTES_PER_SEED = 30.0
LEAST_R2 = (0.8, 0.8, 0.9)
"""What supervised-on-target and source-only on its source must reach in Fx, Fy, Fz for a profile to count."""
RANGE_WIDTH_N = np.array([1.5, 1.5, 3.0])
AXES = ("x", "y", "z")


def number(value: float, form: str = ".3f", unit: str = "") -> str:
    """Return a number's text, a dash for NaN."""
    return "–" if math.isnan(value) else f"{value:{form}}{unit}"


def numbers(values: Iterable[float], form: str = ".3f", unit: str = "") -> list[str]:
    """Return the texts of some numbers."""
    return [number(value, form, unit) for value in values]


def spread(values: np.ndarray) -> str:
    """Return mean ± standard deviation over seeds; how many are NaN (not run, or collapsed), if any are."""
    good = values[~np.isnan(values)]
    if not len(good):
        return "–"
    text = f"{good.mean():.3f}" + (f" ± {good.std(ddof=1):.3f}" if len(good) > 1 else "")
    return text + (f" ({len(values) - len(good)} missing)" if len(good) < len(values) else "")


def by_column(
    title: str, first: str, names: Iterable[str], columns: Mapping[str, Sequence[str]], note: str = ""
) -> ResultTable:
    """Return the table whose first column holds names and whose others are given as texts."""
    rows = [list(row) for row in zip(names, *columns.values(), strict=True)]
    return ResultTable(title, [first, *columns], rows, note)


def group_name(group: tuple[str, str]) -> str:
    """Return a group's name, such as "mb0i0 → wmb1i1"."""
    return " → ".join(group)


def group_tables(results: Results) -> list[ResultTable]:
    """Return all tables about the groups that the methods which were run allow."""
    tables = [check_table, group_table, axis_table, shear_table, oracle_table]
    if {"source-only", "supervised"} <= set(results.methods):
        tables.append(closed_table)
    if "source-only" in results.methods:
        tables.append(summary_table)
    if "dsan" in results.methods and len(results.groups) > 2:
        tables.append(paired_table)
    return [table(results) for table in (*tables, time_table)]


def check_table(results: Results) -> ResultTable:
    """Whether the profile counts: R² of supervised-on-target and of source-only on its source, and time per seed."""
    good = [record for record in results.records if record.problem is None]
    conditions: dict[tuple[str, str], list[Sequence[float]]] = {}
    for _, target in results.groups:
        own = [r.r2 for r in good if (r.job.method, r.job.target) == ("supervised", target)]
        conditions["supervised on target", target] = own
    for source, _ in results.groups:
        own = [r for r in good if (r.job.method, r.job.source) == ("source-only", source)]
        held_out = [r.source_held_out_r2 for r in own if r.source_held_out_r2]
        conditions["source-only on held-out source", source] = held_out
    rows = []
    for condition, r2 in conditions.items():
        if r2:
            mean, worst = np.mean(r2, axis=0), np.min(r2, axis=0)
            cells = [f"{m:.2f} (≥ {w:.2f})" for m, w in zip(mean, worst, strict=True)]
            rows.append([*condition, *cells, "yes" if (mean >= LEAST_R2).all() else "NO"])
    minutes = core_minutes_per_seed(results) / 2
    met = "–" if math.isnan(minutes) else "yes" if minutes <= MINUTES_PER_SEED else "NO"
    rows.append(["a seed, four methods", f"{number(minutes, '.1f')} min on 2 cores", "–", "–", "–", met])
    return ResultTable(
        "Does the profile count?",
        ["condition", "domain", "R² x", "R² y", "R² z", "met"],
        rows,
        "Needed in the mean over runs: R² of at least 0.8 in Fx and Fy and 0.9 in Fz (the worst run is in brackets), "
        f"and at most {MINUTES_PER_SEED:g} minutes per seed on two cores (training time over two).",
    )


def core_minutes_per_seed(results: Results) -> float:
    """Return the mean training time of the paper's methods in minutes of one core; NaN without a complete seed."""
    complete = [seed for i, seed in enumerate(results.seeds) if results.common[:, i].all()]
    records = [record for record in results.records if record.job.seed in complete]
    stage1: dict[tuple[str, int], float] = {}
    for record in records:
        key = (record.job.source, record.job.seed)
        stage1[key] = max(stage1.get(key, 0.0), record.stage1_s)
    stage2 = [r.stage2_s for r in records if r.job.method in PAPER_MAE_N and r.problem is None]
    return (sum(stage1.values()) + sum(stage2)) / 60 / len(complete) if complete else math.nan


def group_table(results: Results) -> ResultTable:
    """The paper's main table, beside baselines without learning."""
    comparable = {group: results.oracles[group].comparable(group) for group in results.groups}
    names = [group_name(group) + ("" if comparable[group] else " *") for group in results.groups]
    columns = {"constant mean": _with_mean(results.constant_mean_n)}
    for i, method in enumerate(results.methods):
        mean = number(over_groups(results.balanced_n[i]))
        columns[method] = [*map(spread, results.errors_n[i]), mean]
    oracles = [results.oracles[group] for group in results.groups]
    columns["pose oracle"] = _with_mean([np.mean(oracle.pose_n) for oracle in oracles])
    columns["geometry oracle"] = _with_mean([np.mean(oracle.geometry_n) for oracle in oracles])
    apart = ", ".join(group_name(group) for group in results.groups if not comparable[group])
    return by_column(
        "Mean MAE on the target's test frames, N",
        "group",
        [*names, "mean"],
        columns,
        f"± standard deviation over {len(results.seeds)} seeds. Means and all further tables are over the pairs of "
        "group and seed that all methods, supervised apart, have finished: "
        f"{results.common.sum()} of {results.common.size}. "
        "A group marked * has a pose oracle worse than the paper's DSAN figure and is not comparable; here: "
        f"{apart or 'none'}.",
    )


def _with_mean(values: Sequence[float]) -> list[str]:
    return numbers([*values, np.mean(values)])


def axis_table(results: Results) -> ResultTable:
    """Error and R² per axis, mean over groups and seeds."""
    oracles = results.oracles.values()
    others = np.stack(
        [np.mean([getattr(o, name) for o in oracles], axis=0) for name in ("pose_n", "geometry_n")]
    )
    constant = mean_of(results.values("constant_mean_n"), axis=(1, 2, 3))
    mae_n = np.vstack([constant, results.axis_means("mae_n").T, others])
    r2 = np.full_like(mae_n, math.nan)
    r2[1:-2] = results.axis_means("r2").T
    percent = numbers((100 * mae_n / RANGE_WIDTH_N).ravel(), ".1f")
    errors = [
        text if text == "–" else f"{text} ({share} %)"
        for text, share in zip(numbers(mae_n.ravel()), percent, strict=True)
    ]
    columns = {f"F{axis}": errors[i::3] for i, axis in enumerate(AXES)}
    columns |= {f"R² {axis}": numbers(r2[:, i], ".2f") for i, axis in enumerate(AXES)}
    names = ["constant mean", *results.methods, "pose oracle", "geometry oracle"]
    title = "Per axis, mean over groups and seeds: MAE in N (% of the range) and R²"
    return by_column(title, "method", names, columns)


def shear_table(results: Results) -> ResultTable:
    """Whether shear is read at all: R² of Fx and Fy by group."""
    r2 = mean_of(results.values("r2")[:2].mean(axis=0), axis=2)
    return by_column(
        "Shear: R² on the target, mean of Fx and Fy",
        "group",
        map(group_name, results.groups),
        {method: numbers(r2[i], ".2f") for i, method in enumerate(results.methods)},
        "Mean over the seeds that a method has. At 0 or below a method is no better than the target's constant mean.",
    )


def oracle_table(results: Results) -> ResultTable:
    """Both oracles per group and axis."""
    rows = [
        [
            group_name(group),
            *numbers((*o.pose_n, *o.geometry_n), ".4f"),
            "yes" if o.comparable(group) else "no",
        ]
        for group, o in results.oracles.items()
    ]
    return ResultTable(
        "Oracles per axis, MAE in N",
        ["group", *(f"{kind} F{axis}" for kind in ("pose", "geometry") for axis in AXES), "comparable"],
        rows,
        "Pose: the source's force at the same command. Geometry: the source gel's force at the target's contact.",
    )


def closed_table(results: Results) -> ResultTable:
    """The share of the gap from source-only to supervised that each method closes, not capped."""
    from gelgap.adapt import gap_closed

    plain, ceiling = (mean_of(results.of(method), axis=1) for method in ("source-only", "supervised"))
    columns = {}
    for method in results.methods:
        if method not in ("source-only", "supervised"):
            own = mean_of(results.of(method), axis=1)
            by_group = [gap_closed(*errors) for errors in zip(plain, own, ceiling, strict=True)]
            of_means = gap_closed(plain.mean(), own.mean(), ceiling.mean())
            columns[method] = numbers([100 * share for share in (*by_group, of_means)], ".0f", " %")
    return by_column(
        "Share of the gap from source-only to supervised-on-target that is closed",
        "group",
        [*map(group_name, results.groups), "of the means"],
        columns,
        "Not capped: above 100 % a method is better than supervised, below 0 worse than source-only.",
    )


def summary_table(results: Results) -> ResultTable:
    """Mean, interval, reduction and rank of each method, beside the paper's."""
    mean = over_groups(results.balanced_n)
    intervals = [bootstrap_interval(errors) for errors in results.balanced_n]
    rank = np.full(len(mean), math.nan)
    rank[results.learned] = ranks(results.group_errors_n).mean(axis=1)
    paper_n = np.array(list(PAPER_MAE_N.values()))
    paper = {
        name: (own, 100 * (own / paper_n[0].mean() - 1), place)
        for name, own, place in zip(
            PAPER_MAE_N, paper_n.mean(axis=1), ranks(paper_n).mean(axis=1), strict=True
        )
    }
    beside = np.array([paper.get(method, (math.nan,) * 3) for method in results.methods])
    return by_column(
        "Over the groups, beside the paper",
        "method",
        results.methods,
        {
            "mean, N": numbers(mean),
            "95 % interval": ["–" if math.isnan(low) else f"{low:.3f}…{high:.3f}" for low, high in intervals],
            "change": _changes(results),
            "mean rank": numbers(rank, ".2f"),
            "paper, N": numbers(beside[:, 0]),
            "paper's change": numbers(beside[:, 1], "+.0f", " %"),
            "paper's rank": numbers(beside[:, 2], ".2f"),
        },
        "Change against source-only. Interval: bootstrap over groups, then seeds. Rank: over groups, means of seeds, "
        "supervised left out; the paper's among its four.",
    )


def _changes(results: Results) -> list[str]:
    """Return each method's change against source-only."""
    plain = over_groups(results.of("source-only"))
    return numbers(100 * (over_groups(results.balanced_n) / plain - 1), "+.0f", " %")


def paired_table(results: Results, against: str = "dsan") -> ResultTable:
    """Paired tests of every method against DSAN, Friedman's test and the critical difference."""
    rows = [
        [
            f"{c.first} − {c.second}",
            f"{c.difference_n:+.4f}",
            f"{c.wins} of {c.cases}",
            f"{c.p_groups:.3f}",
            f"{c.p_runs:.2g}",
            f"{c.leaving_out[0]:+.4f}…{c.leaving_out[1]:+.4f}",
        ]
        for c in compare(results.balanced_n, results.methods, results.groups, against)
    ]
    errors = results.group_errors_n
    return ResultTable(
        f"Paired differences from {against}, N",
        ["difference", "mean, N", "groups better", "p over groups", "p over runs", "leaving out a domain"],
        rows,
        f"Friedman's test over the groups, {len(errors)} methods: p = {friedman_p(errors):.2g}; critical difference of "
        f"mean ranks (Nemenyi, 5 %): {critical_difference(*errors.shape):.2f}. {CAVEAT}",
    )


def time_table(results: Results) -> ResultTable:
    """Error against training time."""
    stage2 = [np.median(own) if len(own) else math.nan for own in map(_present, results.values("stage2_s"))]
    return by_column(
        "Target MAE against training time",
        "method",
        results.methods,
        {
            "mean MAE, N": numbers(over_groups(results.balanced_n)),
            "stage 1, s": [number(results.stage1_s, ".1f")] * len(results.methods),
            "stage 2, s": numbers(stage2, ".1f"),
        },
        "Medians of one core's wall time on a shared machine; stage 1 is shared by all methods of a source and seed.",
    )


def _present(values: np.ndarray) -> np.ndarray:
    return values[~np.isnan(values)]


def further_table(results: Results) -> ResultTable:
    """Every method on the groups that methods beside the paper's were run on."""
    errors = {group_name(g): list(map(spread, results.errors_n[:, i])) for i, g in enumerate(results.groups)}
    stage2 = mean_of(results.values("stage2_s"), axis=(1, 2))
    return by_column(
        "All methods: mean MAE on the target's test frames, N",
        "method",
        results.methods,
        {
            **errors,
            "mean": numbers(over_groups(results.balanced_n)),
            "change": _changes(results),
            "R² x, y, z": [", ".join(numbers(r2, ".2f")) for r2 in results.axis_means("r2").T],
            "stage 2, s": numbers(stage2, ".1f"),
        },
        f"{len(results.seeds)} seed(s); mean, change against source-only and R² over the pairs of group and seed that "
        f"all have finished: {results.common.sum()} of {results.common.size}.",
    )
