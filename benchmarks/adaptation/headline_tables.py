"""The headline's tables: methods against their controls, groups, AdaBN's share, the paper's order, splits and times."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.compared import MAIN_METHODS
from gelgap.benchmarks.adaptation.data_sets import DESIGNS
from gelgap.benchmarks.adaptation.jobs import AT_RANDOM
from gelgap.benchmarks.adaptation.paper import PAPER_MAE_N
from gelgap.benchmarks.adaptation.results import (
    CEILING,
    GroupOracles,
    Results,
    load_results,
    mean_of,
    over_groups,
    read_oracles,
)
from gelgap.benchmarks.adaptation.statistics import (
    CAVEAT,
    bootstrap_interval,
    critical_difference,
    friedman_p,
    kendall_tau,
    paired_difference,
    ranks,
)
from gelgap.benchmarks.adaptation.tables import AXES, by_column, group_name, interval, number, numbers, spread

PLAIN = "source-only"
LEAST_R2 = (0.8, 0.8, 0.9)
"""What supervised-on-target and source-only on its source must reach in Fx, Fy, Fz for a profile to count."""
Oracles = dict[tuple[str, str], GroupOracles]


def group_tables(folder: Path) -> list[ResultTable]:
    """Return all tables about the groups that the finished runs allow."""
    designs = {design: results for design in DESIGNS if (results := load_results(folder, design)).records}
    tables = [
        table(results, design)
        for table in (headline_table, control_table)
        for design, results in designs.items()
    ]
    oracles = read_oracles(folder)
    for design, results in designs.items():
        tables.append(group_table(results, design, oracles if design == "paired" else {}))
    compared = {design: results for design, results in designs.items() if results.has(PLAIN)}
    if compared:
        tables += [adabn_table(compared)] if all(r.has("adabn") for r in compared.values()) else []
        tables += [order_table(compared)] if all(r.has(*PAPER_MAE_N) for r in compared.values()) else []
    tables += [shear_table(results, design) for design, results in designs.items()]
    at_random = load_results(folder, "paired", AT_RANDOM)
    if at_random.records and "paired" in designs:
        tables.append(split_table(at_random, designs["paired"]))
    tables += [check_table(results, design) for design, results in designs.items()]
    return [*tables, oracle_table(oracles), *(time_table(results, d) for d, results in designs.items())]


def headline_table(results: Results, design: str) -> ResultTable:
    """Each method's error, R² per axis and rank."""
    r2 = results.axis_means("r2").T
    rank_with, rank_without = (_mean_ranks(results, left_out) for left_out in ((CEILING,), (CEILING, PLAIN)))
    return by_column(
        f"All methods, {design} contacts: mean over {len(results.groups)} groups",
        "method",
        results.methods,
        {
            "mean MAE, N": numbers(over_groups(results.errors_n)),
            "95 % interval": [interval(bootstrap_interval(own)) for own in results.errors_n],
            **{f"R² {axis}": numbers(r2[:, i], ".2f") for i, axis in enumerate(AXES)},
            "rank": numbers(rank_with, ".1f"),
            f"without {PLAIN}": numbers(rank_without, ".1f"),
            "collapsed": [str(results.collapsed(method)) for method in results.methods],
            "paper, N": numbers([_paper_mean(method) for method in results.methods]),
        },
        f"Split by contact point; {_seeds(results)}. Intervals: bootstrap over groups and seeds. Ranks: means over the "
        f"groups. A run that collapsed counts with the constant mean's error. {_friedman(results)}",
    )


def control_table(results: Results, design: str) -> ResultTable:
    """What each method's loss brings: its error less that of its own control, with the interval."""
    shown = [method for method in results.methods if results.control_of(method) is not None]
    rows = [_against_control(results, method) for method in shown]
    names = ("control", "difference, N", "95 % interval", "better in", "leaving out a domain")
    return by_column(
        f"Methods against their own controls, {design} contacts",
        "method",
        shown,
        {name: [row[i] for row in rows] for i, name in enumerate(names)},
        f"Error less that of the control over the same groups and seeds, negative where the method is better; "
        f"{_seeds(results)}. Interval: bootstrap over groups and seeds. Last column: range of the mean when the groups "
        "of one domain are left out.",
    )


def _against_control(results: Results, method: str) -> list[str]:
    control = str(results.control_of(method))
    found = paired_difference(results.of(method), results.of(control), results.groups)
    return [
        control,
        number(found.mean_n, "+.4f"),
        interval(found.interval_n, "+.4f"),
        f"{found.better} of {found.groups}",
        interval(found.leaving_out_n, "+.4f"),
    ]


def _mean_ranks(results: Results, left_out: Sequence[str]) -> np.ndarray:
    """Return the mean rank (methods,) over the groups, NaN for what is left out."""
    ranked = [i for i, method in enumerate(results.methods) if method not in left_out]
    found = np.full(len(results.methods), math.nan)
    if ranked:
        found[ranked] = ranks(results.group_errors_n[ranked]).mean(axis=1)
    return found


def _paper_mean(method: str) -> float:
    return float(np.mean(PAPER_MAE_N[method])) if method in PAPER_MAE_N else math.nan


def _seeds(results: Results) -> str:
    done, wanted = int(results.common.sum()), results.common.size
    missing = (
        "" if done == wanted else f" ({done} of {wanted} pairs of group and seed are finished by all methods)"
    )
    return f"{len(results.seeds)} seed(s){missing}"


def _friedman(results: Results) -> str:
    """Return Friedman's test and the critical difference over the groups' means, with and without source-only."""
    texts = []
    for name, left_out in (("all", (CEILING,)), (f"without {PLAIN}", (CEILING, PLAIN))):
        errors = results.group_errors_n[[i for i, m in enumerate(results.methods) if m not in left_out]]
        if len(errors) > 2 and errors.shape[1] > 1:
            difference = critical_difference(*errors.shape)
            texts.append(
                f"{name}: Friedman's p = {friedman_p(errors):.2g}, Nemenyi's difference {difference:.1f}"
            )
    return f"Ranks over group means, {'; '.join(texts)}. {CAVEAT}" if texts else ""


def group_table(results: Results, design: str, oracles: Oracles) -> ResultTable:
    """The main methods group by group, beside baselines without learning."""
    worse = np.zeros(len(results.groups), bool)
    if results.has(PLAIN):
        worse = results.group_means_n(PLAIN) > results.constant_mean_n
    comparable = [group not in oracles or oracles[group].comparable(group) for group in results.groups]
    names = [
        group_name(group) + (" †" if bad else "") + ("" if fair else " *")
        for group, bad, fair in zip(results.groups, worse, comparable, strict=True)
    ]
    columns = {"constant mean": _with_mean(results.constant_mean_n)}
    for method in results.methods:
        if method in MAIN_METHODS:
            mean = number(float(results.group_means_n(method).mean()))
            columns[method] = [*map(spread, results.of(method)), mean]
    if oracles:
        for name in ("pose", "geometry"):
            errors = [np.mean(getattr(oracles[group], f"{name}_n")) for group in results.groups]
            columns[f"{name} oracle"] = _with_mean(errors)
    return by_column(
        f"Group by group, {design} contacts: mean MAE on the target's test frames, N",
        "group",
        [*names, "mean"],
        columns,
        f"± standard deviation over {_seeds(results)}. † {PLAIN} is worse than the source's mean force always: "
        f"{int(worse.sum())} of {len(worse)} groups. * The pose oracle is worse than the paper's DSAN figure, so that "
        f"the group is not comparable: {comparable.count(False)} of {len(comparable)}.",
    )


def _with_mean(values: Sequence[float]) -> list[str]:
    return numbers([*values, float(np.mean(values))])


def adabn_table(designs: dict[str, Results]) -> ResultTable:
    """The share of the way from source-only to each method that AdaBN alone goes."""
    methods = list(dict.fromkeys(m for results in designs.values() for m in results.methods))
    shown = [method for method in methods if method not in (PLAIN, "adabn")]
    columns: dict[str, list[str]] = {}
    for design, results in designs.items():
        plain, bn = (over_groups(results.of(method)) for method in (PLAIN, "adabn"))
        own = [float(over_groups(results.of(m))) if m in results.methods else math.nan for m in shown]
        columns[f"{design}: change from {PLAIN}"] = numbers(
            [100 * (n / plain - 1) for n in own], "+.0f", " %"
        )
        shares = [(plain - bn) / (plain - n) if n < plain else math.nan for n in own]
        columns[f"{design}: AdaBN's share"] = numbers([100 * share for share in shares], ".0f", " %")
    return by_column(
        "How much of each method's gain is batch normalisation",
        "method",
        shown,
        columns,
        f"Share: what AdaBN takes off {PLAIN}'s mean error over what the method takes off. Above 100 %, AdaBN alone is "
        "better.",
    )


def order_table(designs: dict[str, Results]) -> ResultTable:
    """Whether the paper's order of its four methods is found, group by group."""
    order = list(PAPER_MAE_N)
    groups = [group for results in designs.values() for group in results.groups]
    columns: dict[str, list[str]] = {}
    for design, results in designs.items():
        errors = {
            group: [float(results.group_means_n(m)[i]) for m in order]
            for i, group in enumerate(results.groups)
        }
        means = [float(over_groups(results.of(m))) for m in order]
        rows = [errors.get(group) for group in dict.fromkeys(groups)] + [means]
        columns[f"{design}: order"] = [_order(order, row) for row in rows]
        columns[f"{design}: τ"] = ["–" if row is None else number(kendall_tau(row), "+.2f") for row in rows]
        columns[f"{design}: the paper's"] = ["–" if row is None else _is_falling(row) for row in rows]
    papers = np.array([PAPER_MAE_N[method] for method in order])
    tau = np.mean([kendall_tau(column) for column in papers.T])
    return by_column(
        "Is the paper's order of methods found?",
        "group",
        [*map(group_name, dict.fromkeys(groups)), "of the means"],
        columns,
        f"The paper's order of means, the worst first: {' > '.join(order)}. τ: Kendall's with it (1: the same order); "
        f"its own groups have {tau:.2f} in the mean.",
    )


def _order(methods: Sequence[str], errors: Sequence[float] | None) -> str:
    if errors is None or np.isnan(errors).any():
        return "–"
    return " > ".join(methods[i] for i in np.argsort(errors)[::-1])


def _is_falling(errors: Sequence[float]) -> str:
    return "yes" if (np.diff(errors) < 0).all() else "no"


def shear_table(results: Results, design: str) -> ResultTable:
    """Whether shear is read at all: R² of Fx and Fy by group."""
    r2 = mean_of(results.values("r2")[:2].mean(axis=0), axis=2)
    return by_column(
        f"Shear, {design} contacts: R² on the target, mean of Fx and Fy",
        "group",
        map(group_name, results.groups),
        {m: numbers(r2[i], ".2f") for i, m in enumerate(results.methods) if m in MAIN_METHODS},
        "Mean over seeds. At 0 or below a method is no better than the target's mean force.",
    )


def split_table(at_random: Results, by_point: Results) -> ResultTable:
    """The same methods with frames split at random and by contact point."""
    shown = [method for method in at_random.methods if method in by_point.methods]
    random_n, point_n = (
        [float(over_groups(results.of(m))) for m in shown] for results in (at_random, by_point)
    )
    return by_column(
        "Split at random or by contact point, paired contacts: mean MAE, N",
        "method",
        shown,
        {
            "at random": numbers(random_n),
            "by point": numbers(point_n),
            "by point over at random": numbers(np.divide(point_n, random_n), ".2f"),
            "rank at random": numbers(_ranks_of(random_n), ".0f"),
            "rank by point": numbers(_ranks_of(point_n), ".0f"),
        },
        f"At random: {_seeds(at_random)}; by point: {_seeds(by_point)}. At random, neighbours of every test frame were "
        "trained on.",
    )


def _ranks_of(errors: Sequence[float]) -> np.ndarray:
    return ranks(np.array(errors)[:, None])[:, 0]


def check_table(results: Results, design: str) -> ResultTable:
    """Whether the profile counts: R² of supervised-on-target and of source-only on its source."""
    good = [record for record in results.records if record.problem is None]
    conditions: dict[tuple[str, str], list[Sequence[float]]] = {}
    for record in good:
        if record.job.method == CEILING:
            conditions.setdefault(("supervised on target", record.job.target), []).append(record.r2)
        elif record.job.method == PLAIN and record.source_held_out_r2:
            own = conditions.setdefault(("source-only on held-out source", record.job.source), [])
            own.append(record.source_held_out_r2)
    rows = []
    for condition, r2 in conditions.items():
        mean, worst = np.mean(r2, axis=0), np.min(r2, axis=0)
        cells = [f"{m:.2f} (≥ {w:.2f})" for m, w in zip(mean, worst, strict=True)]
        rows.append([*condition, *cells, "yes" if (mean >= LEAST_R2).all() else "NO"])
    return ResultTable(
        f"Does the profile count? {design.capitalize()} contacts",
        ["condition", "domain", "R² x", "R² y", "R² z", "met"],
        rows,
        "Needed in the mean over runs: R² of at least 0.8 in Fx and Fy and 0.9 in Fz (the worst run is in brackets).",
    )


def oracle_table(oracles: Oracles) -> ResultTable:
    """Both oracles per group and axis."""
    rows = [
        [
            group_name(group),
            *numbers((*o.pose_n, *o.geometry_n), ".4f"),
            "yes" if o.comparable(group) else "no",
        ]
        for group, o in oracles.items()
    ]
    return ResultTable(
        "Oracles per axis, MAE in N",
        ["group", *(f"{kind} F{axis}" for kind in ("pose", "geometry") for axis in AXES), "comparable"],
        rows,
        "From paired contacts. Pose: the source's force at the same command. Geometry: the source gel's force at the "
        "target's contact.",
    )


def time_table(results: Results, design: str) -> ResultTable:
    """Error against training time."""
    stage2 = [_median(own) for own in results.values("stage2_s")]
    return by_column(
        f"Target MAE against training time, {design} contacts",
        "method",
        results.methods,
        {
            "mean MAE, N": numbers(over_groups(results.errors_n)),
            "stage 1, s": [number(results.stage1_s, ".1f")] * len(results.methods),
            "stage 2, s": numbers(stage2, ".1f"),
        },
        "Medians of one core's wall time on a shared machine; stage 1 is shared by all methods of a source and seed.",
    )


def _median(values: np.ndarray) -> float:
    there = values[~np.isnan(values)]
    return float(np.median(there)) if len(there) else math.nan
