"""The adaptation benchmark's results as tables: the nine groups beside the paper, oracles, tests, times."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.jobs import Job, Line
from gelgap.benchmarks.adaptation.statistics import (
    CAVEAT,
    bootstrap_interval,
    compare,
    critical_difference,
    friedman_p,
    ranks,
)

GROUPS = (
    ("mb0i0", "wmb0i0"),
    ("wmb0i0", "mb0i0"),
    ("wmb0i0", "wmb1i1"),
    ("wmb0i0", "wmb2i2"),
    ("wmb1i1", "wmb0i0"),
    ("wmb1i1", "wmb2i2"),
    ("mb0i0", "wmb1i1"),
    ("mb0i0", "wmb2i2"),
    ("wmb1i1", "mb0i0"),
)
"""The paper's adaptation groups (its table I)."""

PAPER_MAE_N = {
    "source-only": (0.276, 0.196, 0.300, 0.384, 0.226, 0.230, 0.323, 0.304, 0.368),
    "dann": (0.098, 0.118, 0.132, 0.162, 0.120, 0.180, 0.143, 0.238, 0.185),
    "daregram": (0.082, 0.091, 0.143, 0.186, 0.102, 0.242, 0.159, 0.198, 0.129),
    "dsan": (0.086, 0.086, 0.138, 0.180, 0.095, 0.167, 0.160, 0.195, 0.105),
}
"""The paper's mean MAE in N, in the order of `GROUPS`."""

TABLE_METHODS = ("source-only", "adabn", "no-transfer", "dann", "daregram", "dsan", "supervised")
"""The paper's methods, and the controls and the ceiling beside them."""
MINUTES_A_SEED = 30.0
LEAST_R2 = (0.8, 0.8, 0.9)
"""What supervised-on-target and source-only on its source must reach in Fx, Fy, Fz for a profile to count."""


@dataclass(frozen=True)
class GroupOracles:
    """What paired contacts say of a group: mean absolute errors per axis, N, without any learning."""

    pose_n: tuple[float, float, float]
    geometry_n: tuple[float, float, float]

    def comparable(self, group: tuple[str, str]) -> bool:
        """Whether perfect alignment of poses could reach what the paper reports for DSAN."""
        if group not in GROUPS:
            return True
        return float(np.mean(self.pose_n)) <= PAPER_MAE_N["dsan"][GROUPS.index(group)]


@dataclass(frozen=True)
class Results:
    """The finished runs of some groups and methods, and the oracles of the groups.

    Arrays are (methods, groups, seeds); a run that is missing or collapsed is NaN.
    """

    lines: Sequence[Line]
    groups: Sequence[tuple[str, str]]
    methods: Sequence[str]
    seeds: Sequence[int]
    oracles: dict[tuple[str, str], GroupOracles]

    @cached_property
    def found(self) -> dict[Job, Line]:
        return {line.job: line for line in self.lines}

    def line(self, group: tuple[str, str], method: str, seed: int) -> Line | None:
        return self.found.get(Job(*group, method, seed))

    def values(self, of) -> np.ndarray:
        """Return `of(line)` for every method, group and seed; NaN where there is no such run."""

        def value(line: Line | None):
            return of(line) if line is not None and line.problem is None else math.nan

        return np.array(
            [[[value(self.line(g, m, s)) for s in self.seeds] for g in self.groups] for m in self.methods]
        )

    @cached_property
    def errors_n(self) -> np.ndarray:
        """Mean MAE over the axes, N."""
        return self.values(lambda line: line.mean_mae_n)

    @cached_property
    def constant_mean_n(self) -> np.ndarray:
        """Error (groups,) of predicting the source's mean force, N, mean over the seeds' test frames."""
        return mean_of(self.values(lambda line: float(np.mean(line.constant_mean_n))), axis=(0, 2))

    @cached_property
    def common(self) -> np.ndarray:
        """Which pairs (groups, seeds) every method but supervised has finished, be it by a collapse."""
        learned = [m for m in self.methods if m != "supervised"]
        return np.array([[all(self.line(g, m, s) for m in learned) for s in self.seeds] for g in self.groups])

    @cached_property
    def balanced_n(self) -> np.ndarray:
        """The errors on the common pairs, by which methods are compared; NaN elsewhere."""
        return np.where(self.common, self.errors_n, np.nan)

    def of(self, method: str) -> np.ndarray:
        """Return the errors (groups, seeds) of one method on the common pairs, N."""
        return self.balanced_n[list(self.methods).index(method)]


def mean_of(values: np.ndarray, axis: int | tuple[int, ...] | None = None) -> np.ndarray:
    """Return the mean of what is there; NaN where nothing is."""
    there = ~np.isnan(values)
    count = there.sum(axis=axis)
    return np.where(count > 0, np.where(there, values, 0.0).sum(axis=axis) / np.maximum(count, 1), np.nan)


def over_groups(values: np.ndarray) -> np.ndarray:
    """Return the mean over groups of the means over seeds of (…, groups, seeds); NaN where a group has no run."""
    return mean_of(values, axis=-1).mean(axis=-1)


def number(value: float, form: str = ".3f") -> str:
    return "–" if math.isnan(value) else f"{value:{form}}"


def _share(error_n: float, width_n: float) -> str:
    return "–" if math.isnan(error_n) else f"{error_n:.3f} ({100 * error_n / width_n:.1f} %)"


def result_tables(results: Results) -> list[ResultTable]:
    """Return all tables about the groups."""
    tables = [
        check_table(results),
        group_table(results),
        axis_table(results),
        shear_table(results),
        oracle_table(results),
    ]
    if {"source-only", "supervised"} <= set(results.methods):
        tables.append(closed_table(results))
    if "source-only" in results.methods:
        tables.append(summary_table(results))
    if "dsan" in results.methods and len(results.groups) > 2:
        tables.append(paired_table(results))
    return [*tables, time_table(results)]


def spread(values: np.ndarray) -> str:
    """Return mean ± standard deviation over seeds; how many are NaN (not run, or collapsed), if any are."""
    lost = int(np.isnan(values).sum())
    good = values[~np.isnan(values)]
    if not len(good):
        return "–"
    text = f"{good.mean():.3f}" + (f" ± {good.std(ddof=1):.3f}" if len(good) > 1 else "")
    return text + (f" ({lost} missing)" if lost else "")


def group_table(results: Results) -> ResultTable:
    """The paper's main table beside what needs no learning."""
    rows = []
    for i, group in enumerate(results.groups):
        oracles = results.oracles[group]
        rows.append(
            [
                " → ".join(group) + ("" if oracles.comparable(group) else " *"),
                f"{results.constant_mean_n[i]:.3f}",
                *(spread(errors) for errors in results.errors_n[:, i]),
                f"{np.mean(oracles.pose_n):.3f}",
                f"{np.mean(oracles.geometry_n):.3f}",
            ]
        )
    mean = over_groups(results.balanced_n)
    both = [[np.mean(o.pose_n), np.mean(o.geometry_n)] for o in results.oracles.values()]
    rows.append(
        ["mean", f"{results.constant_mean_n.mean():.3f}", *(number(x) for x in mean)]
        + [f"{x:.3f}" for x in np.mean(both, axis=0)]
    )
    apart = [" → ".join(g) for g in results.groups if not results.oracles[g].comparable(g)]
    return ResultTable(
        "Mean MAE on the target's test frames, N",
        ["group", "constant mean", *results.methods, "pose oracle", "geometry oracle"],
        rows,
        f"± standard deviation over {len(results.seeds)} seeds. Means and all further tables are over the pairs of "
        "group and seed that all methods, supervised apart, have finished: "
        f"{results.common.sum()} of {results.common.size}. "
        "A group marked * has a pose oracle worse than the paper's DSAN figure and is not comparable; here: "
        f"{', '.join(apart) or 'none'}.",
    )


def axis_table(results: Results) -> ResultTable:
    """Error and R² per axis, mean over groups and seeds."""

    def means(of) -> np.ndarray:
        return over_groups(np.where(results.common, results.values(of), np.nan))

    per_axis = [means(lambda ln, a=a: ln.mae_n[a]) for a in range(3)]
    r2 = [means(lambda ln, a=a: ln.r2[a]) for a in range(3)]
    widths = (1.5, 1.5, 3.0)
    constant = [mean_of(results.values(lambda line, a=a: line.constant_mean_n[a])) for a in range(3)]
    rows = [["constant mean", *(_share(n, w) for n, w in zip(constant, widths, strict=True))]]
    rows[0] += ["–"] * 3
    for i in range(len(results.methods)):
        rows.append(
            [
                results.methods[i],
                *(_share(v[i], w) for v, w in zip(per_axis, widths, strict=True)),
                *(number(v[i], ".2f") for v in r2),
            ]
        )
    for name in ("pose", "geometry"):
        values = np.mean([getattr(o, f"{name}_n") for o in results.oracles.values()], axis=0)
        cells = [_share(n, w) for n, w in zip(values, widths, strict=True)]
        rows.append([f"{name} oracle", *cells, "–", "–", "–"])
    return ResultTable(
        "Per axis, mean over groups and seeds: MAE in N (% of the range) and R²",
        ["method", "Fx", "Fy", "Fz", "R² x", "R² y", "R² z"],
        rows,
    )


def shear_table(results: Results) -> ResultTable:
    """Whether shear is read at all: R² of Fx and Fy by group."""
    r2 = mean_of(results.values(lambda line: (line.r2[0] + line.r2[1]) / 2), axis=2)
    rows = [
        [" → ".join(group), *(number(value, ".2f") for value in r2[:, i])]
        for i, group in enumerate(results.groups)
    ]
    return ResultTable(
        "Shear: R² on the target, mean of Fx and Fy",
        ["group", *results.methods],
        rows,
        "Mean over the seeds that a method has. At 0 or below a method is no better than the target's constant mean.",
    )


def oracle_table(results: Results) -> ResultTable:
    """Both oracles per group and axis."""
    rows = [
        [
            " → ".join(group),
            *(f"{x:.4f}" for x in (*o.pose_n, *o.geometry_n)),
            "yes" if o.comparable(group) else "no",
        ]
        for group, o in results.oracles.items()
    ]
    names = [f"{kind} {axis}" for kind in ("pose", "geometry") for axis in ("Fx", "Fy", "Fz")]
    return ResultTable(
        "Oracles per axis, MAE in N",
        ["group", *names, "comparable"],
        rows,
        "Pose: the source's force at the same command. Geometry: the source gel's force at the target's contact.",
    )


def closed_table(results: Results) -> ResultTable:
    """The share of the gap from source-only to supervised that each method closes, not capped."""
    from gelgap.adapt import gap_closed

    own = [m for m in results.methods if m not in ("source-only", "supervised")]
    plain, ceiling = (mean_of(results.of(m), axis=1) for m in ("source-only", "supervised"))

    def share(method: str, i: int) -> str:
        value = gap_closed(plain[i], float(mean_of(results.of(method)[i])), ceiling[i])
        return "–" if math.isnan(value) else f"{100 * value:.0f} %"

    rows = [[" → ".join(g), *(share(m, i) for m in own)] for i, g in enumerate(results.groups)]
    shares = [100 * gap_closed(plain.mean(), float(over_groups(results.of(m))), ceiling.mean()) for m in own]
    return ResultTable(
        "Share of the gap from source-only to supervised-on-target that is closed",
        ["group", *own],
        [*rows, ["of the means", *(number(value, ".0f") + " %" for value in shares)]],
        "Not capped: above 100 % a method is better than supervised, below 0 worse than source-only.",
    )


def summary_table(results: Results) -> ResultTable:
    """Mean, interval, reduction and rank of each method, beside the paper's."""
    plain = over_groups(results.of("source-only"))
    learned = [i for i, m in enumerate(results.methods) if m != "supervised"]
    by_group = mean_of(results.balanced_n, axis=2)
    mean_ranks = dict(
        zip([results.methods[i] for i in learned], ranks(by_group[learned]).mean(axis=1), strict=True)
    )
    paper = {name: float(np.mean(values)) for name, values in PAPER_MAE_N.items()}
    paper_ranks = dict(zip(paper, ranks(np.array(list(PAPER_MAE_N.values()))).mean(axis=1), strict=True))
    rows = []
    for i, method in enumerate(results.methods):
        errors = results.balanced_n[i]
        low, high = bootstrap_interval(errors)
        rows.append(
            [
                method,
                number(over_groups(errors)),
                "–" if math.isnan(low) else f"{low:.3f}…{high:.3f}",
                number(100 * (over_groups(errors) / plain - 1), "+.0f") + " %",
                f"{mean_ranks[method]:.2f}" if method in mean_ranks else "–",
                f"{paper[method]:.3f}" if method in paper else "–",
                f"{100 * (paper[method] / paper['source-only'] - 1):+.0f} %" if method in paper else "–",
                f"{paper_ranks[method]:.2f}" if method in paper else "–",
            ]
        )
    return ResultTable(
        "Over the groups, beside the paper",
        [
            "method",
            "mean, N",
            "95 % interval",
            "change",
            "mean rank",
            "paper, N",
            "paper's change",
            "paper's rank",
        ],
        rows,
        "Change against source-only. Interval: bootstrap over groups, then seeds. Rank: over groups, means of seeds, "
        "supervised left out; the paper's among its four.",
    )


def paired_table(results: Results, against: str = "dsan") -> ResultTable:
    """Paired tests of every method against DSAN, Friedman's test and the critical difference."""
    found = compare(results.balanced_n, list(results.methods), results.groups, against)
    rows = [
        [
            f"{c.first} − {c.second}",
            f"{c.difference_n:+.4f}",
            f"{c.wins} of {c.cases}",
            f"{c.p_groups:.3f}",
            f"{c.p_runs:.2g}",
            f"{c.leaving_out[0]:+.4f}…{c.leaving_out[1]:+.4f}",
        ]
        for c in found
    ]
    own = [i for i, m in enumerate(results.methods) if m != "supervised"]
    by_group = mean_of(results.balanced_n[own], axis=2)
    note = (
        f"Friedman's test over the groups, {len(own)} methods: p = {friedman_p(by_group):.2g}; critical difference of "
        f"mean ranks (Nemenyi, 5 %): {critical_difference(len(own), len(results.groups)):.2f}. {CAVEAT}"
    )
    return ResultTable(
        f"Paired differences from {against}, N",
        ["difference", "mean, N", "groups better", "p over groups", "p over runs", "leaving out a domain"],
        rows,
        note,
    )


def check_table(results: Results) -> ResultTable:
    """Whether the profile counts: R² of supervised-on-target and of source-only on its source, and the time a seed."""
    rows = []

    def add(what: str, domain: str, r2: np.ndarray) -> None:
        mean, worst = r2.mean(axis=0), r2.min(axis=0)
        good = bool((mean >= LEAST_R2).all())
        cells = [f"{m:.2f} (≥ {w:.2f})" for m, w in zip(mean, worst, strict=True)]
        rows.append([what, domain, *cells, "yes" if good else "NO"])

    sound = [line for line in results.lines if line.problem is None]
    for domain in dict.fromkeys(group[1] for group in results.groups):
        own = [ln.r2 for ln in sound if (ln.job.method, ln.job.target) == ("supervised", domain)]
        if own:
            add("supervised on target", domain, np.array(own))
    for domain in dict.fromkeys(group[0] for group in results.groups):
        own = [
            ln.source_held_out_r2
            for ln in sound
            if (ln.job.method, ln.job.source) == ("source-only", domain) and ln.source_held_out_r2
        ]
        if own:
            add("source-only on held-out source", domain, np.array(own))
    minutes = core_minutes_a_seed(results) / 2
    met = "–" if math.isnan(minutes) else "yes" if minutes <= MINUTES_A_SEED else "NO"
    rows.append(["a seed, four methods", f"{number(minutes, '.1f')} min on 2 cores", "–", "–", "–", met])
    return ResultTable(
        "Does the profile count?",
        ["condition", "domain", "R² x", "R² y", "R² z", "met"],
        rows,
        "Needed in the mean over runs: R² of at least 0.8 in Fx and Fy and 0.9 in Fz (the worst run is in brackets), "
        f"and at most {MINUTES_A_SEED:g} minutes a seed on two cores (training time over two).",
    )


def core_minutes_a_seed(results: Results) -> float:
    """Return the training time of the paper's four methods in minutes of one core: the mean over complete seeds, NaN
    without one."""
    complete = [seed for i, seed in enumerate(results.seeds) if results.common[:, i].all()]
    of_seed = [line for line in results.lines if line.job.seed in complete]
    stage1: dict[tuple[str, int], float] = {}
    for line in of_seed:
        key = (line.job.source, line.job.seed)
        stage1[key] = max(stage1.get(key, 0.0), line.stage1_s)
    stage2 = [ln.stage2_s for ln in of_seed if ln.job.method in PAPER_MAE_N and ln.problem is None]
    return (sum(stage1.values()) + sum(stage2)) / 60 / len(complete) if complete else math.nan


def further_table(results: Results) -> ResultTable:
    """Every method on the groups that methods beside the paper's were run on."""
    plain = float(over_groups(results.of("source-only")))
    r2 = [
        over_groups(np.where(results.common, results.values(lambda line, a=a: line.r2[a]), np.nan))
        for a in range(3)
    ]
    stage2 = mean_of(results.values(lambda line: line.stage2_s), axis=(1, 2))
    rows = [
        [
            method,
            *(spread(errors) for errors in results.errors_n[i]),
            number(over_groups(results.balanced_n[i])),
            number(100 * (over_groups(results.balanced_n[i]) / plain - 1), "+.0f") + " %",
            ", ".join(number(axis[i], ".2f") for axis in r2),
            number(stage2[i], ".1f"),
        ]
        for i, method in enumerate(results.methods)
    ]
    groups = [" → ".join(group) for group in results.groups]
    return ResultTable(
        "All methods: mean MAE on the target's test frames, N",
        ["method", *groups, "mean", "change", "R² x, y, z", "stage 2, s"],
        rows,
        f"{len(results.seeds)} seed(s); mean, change against source-only and R² over the pairs of group and seed that "
        f"all have finished: {results.common.sum()} of {results.common.size}.",
    )


def time_table(results: Results) -> ResultTable:
    """Error against training time."""
    stage1 = [line.stage1_s for line in results.lines if line.stage1_s > 0]
    shared = float(np.median(stage1)) if stage1 else math.nan
    rows = []
    for i, method in enumerate(results.methods):
        own = [line.stage2_s for line in results.lines if line.job.method == method and line.problem is None]
        stage2 = float(np.median(own)) if own else math.nan
        rows.append([method, number(over_groups(results.balanced_n[i])), f"{shared:.1f}", f"{stage2:.1f}"])
    return ResultTable(
        "Target MAE against training time",
        ["method", "mean MAE, N", "stage 1, s", "stage 2, s"],
        rows,
        "Medians of one core's wall time on a shared machine; stage 1 is shared by all methods of a source and seed.",
    )
