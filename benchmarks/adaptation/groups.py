"""The headline: all methods on groups of two sensors whose contact points are apart, several seeds, split by point.

The *share of the headroom closed* is (start − error)/(start − ceiling), numerator and denominator as means over the
groups. The start is source-only's error in a group and seed, or the constant mean's where that is less. The ceiling is
the error of the same network trained on the target's own labels, at its other contact points.
"""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from gelgap.adapt import NamedFigure, ResultTable
from gelgap.adapt.baselines import BASELINES, CONSTANT
from gelgap.adapt.report import mean_and_deviation
from gelgap.adapt.result_table import cell
from gelgap.benchmarks.adaptation import board, designs
from gelgap.benchmarks.adaptation.board import AXES, CEILING, DATA_SETS, GROUPS, LIGHT_GROUPS, PLAIN
from gelgap.benchmarks.adaptation.statistics import drawn_means, halves, holm, interval, p_value, sensor_pair
from gelgap.benchmarks.adaptation.study import (
    RUNS,
    Part,
    Study,
    adapt_run,
    grid,
    is_benchmark,
    load_runs,
    with_errors,
)
from gelgap.benchmarks.common import Setting, result_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SEEDS = (0, 1, 2, 3, 4)
QUICK_GROUP = ("mb0i0", "wmb1i1")
QUICK_METHODS = (PLAIN, "adabn", "classifier-only", "dsan", CEILING)
LEAST_R2 = 0.9
"""R² that the ceiling must reach on each axis of a target; shares of the headroom leave other targets out."""
R2 = [f"R² {axis}" for axis in AXES]
NAMES = [" → ".join(group) for group in (*GROUPS, *LIGHT_GROUPS)]
SHRUNK = "adabn's Fz, mean shear"
RULES = (*BASELINES, SHRUNK)
"""Rows that need no loss: rules without a network, and AdaBN with the source's mean for its shear."""
VALUES = {"mean": "error_n", "Fz": "MAE z, N", "shear": "shear_n"}
"""What methods are ranked by, each apart: a method that predicts no shear is good at neither by hiding it in a mean."""
FORMATS = {"": "{:.3f}", **dict.fromkeys(R2, "{:.2f}")}
CAVEAT = (
    "Groups of the same two sensors are not independent cases, so pairs of sensors are drawn, with their groups, "
    "and seeds."
)


def measure(study: Study) -> None:
    """Do the missing runs: of a seed the ceilings, then all methods; those on shifted labels come last."""
    from gelgap.domains import make_recipes
    from gelgap.sim import ContactPath

    chosen = study.known_methods()
    if study.is_quick:  # the domains at their least: nine points of four poses at draft quality
        path = ContactPath("quick", (-2.25, 0.0, 2.25), (-1.3, 0.0, 1.3), (0.6,), (0.4,), (0, 90, 180, 270))
        options = {"quality": "draft", "render_quality": "draft", "size_px": (160, 120), "seed": 0}
        study.generate(make_recipes(QUICK_GROUP, path, **options))
        runs = grid([("paired", QUICK_GROUP)], chosen or QUICK_METHODS, study.seeds or SEEDS[:1])
    else:
        runs = headline_grid(chosen, study.seeds or SEEDS, study.groups)
        study.generate_roles(runs)
    study.run(adapt_run, runs, RUNS)


def headline_grid(
    methods: Sequence[str] = (), seeds: Iterable[int] = SEEDS, groups: Sequence[board.Group] | None = None
) -> list[Setting]:
    """Return all runs: a seed is complete, ceilings first, before the next one begins; shifted labels are last."""
    seeds, groups = list(seeds), list(groups or (*GROUPS, *LIGHT_GROUPS))
    targets = dict.fromkeys(target for _, target in groups)
    own = [method for method in methods or board.METHODS if method != CEILING]
    main = [method for method in methods or (*board.MAIN_METHODS, "label-shift") if method != CEILING]
    found = []
    for seed in seeds:
        found += grid([(designs.DATA, (target, target)) for target in targets], [PLAIN], [seed])
        found += grid([(designs.DATA, group) for group in groups], own, [seed])
    return found + grid([(board.LABEL_SHIFT, group) for group in groups], main, seeds)


def load_headline(folder: Path, data: str = designs.DATA) -> pd.DataFrame:
    """Return the runs of a data set.

    Raises
    ------
    ValueError
        If the runs of a group are not all of one configuration.
    """
    runs = load_runs(folder / RUNS)
    runs = runs[(runs["data"] == data) & runs["changes"].isin([board.BY_POINT]) & runs["group"].isin(NAMES)]
    for group, own in runs.groupby("group"):
        if len(own[["profile", "configuration"]].drop_duplicates()) > 1:
            raise ValueError(
                f"{folder / RUNS}: the runs of {group}, {data} contacts, are of more than one configuration; only runs "
                "of one profile and of the same data can be compared"
            )
    return runs


def load_ceilings(folder: Path) -> pd.DataFrame:
    """Return the runs of targets that were trained on themselves, by target and seed."""
    runs = load_runs(folder / RUNS)
    own = runs[(runs["source"] == runs["target"]) & runs["changes"].isin([board.BY_POINT])]
    return own.set_index(["target", "seed"]).sort_index()


def methods_of(runs: pd.DataFrame, *left_out: str) -> list[str]:
    """Return the methods that were run, rules first and then in the board's order, others last."""
    there = list(runs["method"].unique())
    order = dict.fromkeys([*RULES, *board.METHODS, *there])
    return [method for method in order if method in there and method not in left_out]


def with_rules(runs: pd.DataFrame) -> pd.DataFrame:
    """Return runs, and the rules of `RULES` as further methods; what a record does not have is left out."""
    found = [runs]
    plain, adabn = (runs[runs["method"] == name] for name in (PLAIN, "adabn"))
    for name in BASELINES:
        columns = [f"baselines_{what}.{name}" for what in ("mae_n", "r2")]
        own = plain.dropna(subset=columns) if set(columns) <= set(plain) else plain[:0]
        found.append(own.assign(method=name, mae_n=own.get(columns[0]), r2=own.get(columns[1])))
    if len(found[1]):
        shrunk = [
            (*mean[:2], own[2]) for mean, own in zip(adabn["constant_mean_n"], adabn["mae_n"], strict=True)
        ]
        r2 = [
            (*mean[:2], own[2])
            for mean, own in zip(adabn[f"baselines_r2.{CONSTANT}"], adabn["r2"], strict=True)
        ]
        found.append(adabn.assign(method=SHRUNK, mae_n=shrunk, r2=r2))
    rules = pd.concat([one for one in found[1:] if len(one)] or [runs[:0]])
    rules = rules.assign(problem=None, control=None, stage2_s=0.0, settings=[()] * len(rules))
    return with_errors(pd.concat([runs, rules])) if len(rules) else runs


def counted(runs: pd.DataFrame, values: str = "error_n") -> pd.DataFrame:
    """Return values by group and seed (rows) and method, NaN except for the pairs that all have finished.

    The ceiling apart: methods are compared on what every one of them has finished. A run that collapsed counts with
    the error of the constant mean that it became.
    """
    table = runs.pivot(index=["group", "seed"], columns="method", values=values)
    groups, seeds = table.index.levels
    table = table.reindex(pd.MultiIndex.from_product([[name for name in NAMES if name in groups], seeds]))
    whole = table[methods_of(runs, CEILING)].notna().all(axis=1)
    return table[methods_of(runs)].where(whole, axis=0)


def by_group(values: pd.DataFrame) -> pd.DataFrame:
    """Return the means over seeds by group and method."""
    return values.groupby(level=0, sort=False).mean()


def over_groups(values: pd.DataFrame) -> pd.Series:
    """Return the means over groups of the means over seeds by method; NaN where a group has no run."""
    return by_group(values).mean(skipna=False)


def ranks(errors: pd.DataFrame) -> pd.DataFrame:
    """Return the rank of each method (columns) in each case, 1 the best, ties shared; NaN is worst."""
    return errors.fillna(math.inf).rank(axis=1)


def constant_mean(runs: pd.DataFrame) -> pd.Series:
    """Return the error of predicting the source's mean force by group, N, mean over methods and seeds."""
    return runs["constant_mean_n"].map(np.mean).groupby(runs["group"]).mean()


def tables(folder: Path) -> list[ResultTable]:
    """Return all tables about the groups that the finished runs allow."""
    if not is_benchmark(folder):
        return []
    sets = {data: with_rules(runs) for data in DATA_SETS if len(runs := load_headline(folder, data))}
    ceilings = load_ceilings(folder)
    found = [
        table(runs, data, ceilings)
        for table in (method_table, control_table, group_table)
        for data, runs in sets.items()
    ]
    return [*found, ceiling_table(ceilings)] if len(ceilings) else found


def usable(ceilings: pd.DataFrame) -> list[str]:
    """Return the targets whose ceiling reaches R² ≥ 0.9 on each axis, in the mean over seeds."""
    if ceilings.empty:
        return []
    least = ceilings[R2].groupby(level="target").mean().min(axis=1)
    return list(least.index[least >= LEAST_R2])


def headroom(runs: pd.DataFrame, ceilings: pd.DataFrame, values: str = "error_n") -> pd.DataFrame | None:
    """Return by group and seed (rows) start − error of each method, and start − ceiling in the column `ceiling`.

    Only of groups whose target's ceiling is one, and seeds in which it was found; None if there are none.
    """
    errors = counted(runs, values)
    if PLAIN not in errors or ceilings.empty:
        return None
    start = errors[PLAIN] if CONSTANT not in errors else errors[[PLAIN, CONSTANT]].min(axis=1)
    targets = [(group.partition(" → ")[2], seed) for group, seed in errors.index]
    ceiling = ceilings[values].reindex(targets).set_axis(errors.index)
    is_one = np.isin([target for target, _ in targets], usable(ceilings))
    good = ceiling.notna() & start.notna() & is_one
    gains = errors.rsub(start, axis=0).assign(ceiling=start - ceiling)[good]
    return gains if len(gains) else None


def closed(gains: pd.DataFrame | None, methods: Iterable[str]) -> pd.DataFrame:
    """Return the share of the headroom that each method closes, %, and its 95 % interval."""
    found = pd.DataFrame(math.nan, pd.Index(list(methods), name="method"), ["share"]).assign(interval=None)
    if gains is None:
        return found
    groups = list(dict.fromkeys(gains.index.get_level_values(0)))
    pairs = [sensor_pair(group) for group in groups]

    def cube(column: str) -> np.ndarray:
        return gains[column].unstack().reindex(groups).to_numpy()

    whole = drawn_means(cube("ceiling"), pairs)
    total = by_group(gains[["ceiling"]]).mean().item()
    for method in found.index:
        found.loc[method, "share"] = (
            100 * by_group(gains[[method]]).mean().item() / total if total > 0 else math.nan
        )
        draws = 100 * drawn_means(cube(method), pairs) / np.where(whole > 0, whole, math.nan)
        found.at[method, "interval"] = None if np.isnan(draws).any() else interval(draws)
    return found


def summary(runs: pd.DataFrame, ceilings: pd.DataFrame) -> pd.DataFrame:
    """Return each method's share of the headroom closed, errors, R² per axis, and rank by mean, Fz and shear."""
    errors = {name: counted(runs, column) for name, column in VALUES.items()}
    methods = list(errors["mean"])
    shares = {name: closed(headroom(runs, ceilings, column), methods) for name, column in VALUES.items()}
    frame = pd.DataFrame(index=pd.Index(methods, name="method"))
    frame["closed"] = shares["mean"]["share"]
    frame["interval"] = shares["mean"]["interval"]
    for name in ("Fz", "shear"):
        frame[f"closed {name}"] = shares[name]["share"]
    for name, own in errors.items():
        frame[f"{name}, N"] = over_groups(own)
    mean_shear = runs["constant_mean_n"].map(lambda mae_n: float(np.mean(mae_n[:2])))
    hidden = runs.assign(hidden_n=(2 * mean_shear + runs["MAE z, N"]) / 3)
    frame["no shear, N"] = over_groups(counted(hidden, "hidden_n"))
    for column in R2:
        frame[column] = over_groups(counted(runs, column))
    for name, own in errors.items():
        frame[f"rank {name}"] = ranks(by_group(own)[methods_of(runs, CEILING)]).mean()
    return frame.dropna(axis=1, how="all")


SUMMARY_FORMATS = (
    FORMATS
    | {"interval": "{:.0f}"}
    | dict.fromkeys(("closed", "closed Fz", "closed shear"), "{:.0f} %")
    | {f"rank {name}": "{:.1f}" for name in VALUES}
)


def method_table(runs: pd.DataFrame, data: str, ceilings: pd.DataFrame) -> ResultTable:
    """Each method's share of the headroom, errors, R² per axis, ranks and time; in the note how stable the order is."""
    frame, errors = summary(runs, ceilings), counted(runs)
    frame["stage 2, s"] = runs.groupby("method")["stage2_s"].median()
    stage1_s = float(runs.loc[runs["stage1_s"] > 0, "stage1_s"].median())
    collapsed = runs.groupby("method")["problem"].count()
    frame = frame.assign(collapsed=collapsed) if collapsed.any() else frame
    used = headroom(runs, ceilings)
    groups = 0 if used is None else used.index.get_level_values(0).nunique()
    return result_table(
        f"All methods, {data} contacts: mean over {len(by_group(errors))} groups",
        frame,
        f"Split by contact point; {_seeds(runs)}. Closed: of the headroom, from {PLAIN}'s error, or the constant "
        f"mean's where less, to that of training on the target itself; {groups} groups, whose targets' ceilings have "
        f"R² ≥ {LEAST_R2:g} on every axis. No shear: the method's Fz beside the source's mean shear. Intervals: "
        f"bootstrap, 95 %. {CAVEAT} A run that collapsed counts with the constant mean's error. Stage 2: median wall "
        "time of one core; stage 1, which all methods of a source and seed share, took "
        f"{cell(stage1_s, '{:.1f}') or '–'} s. {halves(errors)}",
        {**SUMMARY_FORMATS, "collapsed": "{:d}", "stage 2, s": "{:.1f}"},
    )


def _seeds(runs: pd.DataFrame) -> str:
    whole, seeds = counted(runs).notna().any(axis=1), f"{runs['seed'].nunique()} seed(s)"
    finished = f"({whole.sum()} of {len(whole)} pairs of group and seed are finished by all methods)"
    return seeds if whole.all() else f"{seeds} {finished}"


def control_table(runs: pd.DataFrame, data: str, ceilings: pd.DataFrame) -> ResultTable:
    """What each method's loss brings: its error less that of its own control over the same groups and seeds."""
    errors, controls = counted(runs), runs.groupby("method")["control"].first()
    methods = [method for method in errors if controls.get(method) in errors]
    gains = pd.DataFrame({method: errors[method] - errors[controls[method]] for method in methods})
    means = by_group(gains)
    pairs = [sensor_pair(group) for group in means.index]
    draws = {m: drawn_means(gains[m].unstack(sort=False).to_numpy(), pairs) for m in methods}
    kept = [[own != pair for own in pairs] for pair in dict.fromkeys(pairs)]
    without = pd.DataFrame([means[rows].mean(skipna=False) for rows in kept if any(rows)], columns=methods)
    p = pd.Series({method: p_value(draws[method]) for method in methods}, dtype=float)
    return result_table(
        f"Methods beside their own controls, {data} contacts",
        pd.DataFrame(
            {
                "control": controls[methods],
                "difference, N": means.mean(skipna=False),
                "95 % interval": [interval(draws[m]) for m in methods],
                "p, Holm": holm(p),
                "better in": [f"{count} of {len(means)}" for count in (means < 0).sum()],
                "leaving out a pair": list(zip(without.min(), without.max(), strict=True)),
            }
        ).rename_axis("method"),
        f"Error less that of the control over the same groups and seeds, negative where the method is better; "
        f"{_seeds(runs)}. Interval and p: bootstrap, two-sided; p is adjusted for the number of rows. {CAVEAT} Last "
        "column: range of the mean when the groups of one pair of sensors are left out.",
        {"": "{:+.4f}", "p, Holm": "{:.3f}"},
    )


def group_table(runs: pd.DataFrame, data: str, ceilings: pd.DataFrame) -> ResultTable:
    """The main methods group by group, beside rules and the ceiling."""
    errors = counted(runs)
    means = by_group(errors)
    shown = [method for method in means if method in (*RULES, *board.MAIN_METHODS)]
    worse = means[PLAIN] > constant_mean(runs)[means.index] if PLAIN in means else means.index == ""
    frame = means[shown].astype(object)
    for method in shown:
        frame[method] = errors[method].groupby(level=0, sort=False).apply(mean_and_deviation).astype(object)
    frame.loc["mean"] = means[shown].mean(skipna=False)
    note = "no ceiling was found."
    if len(ceilings):
        own = ceilings["error_n"].groupby(level="target").mean()
        frame["ceiling"] = [own.get(group.partition(" → ")[2]) for group in frame.index]
        note = f"* The ceiling's R² is below {LEAST_R2:g} on an axis, so that no headroom is counted."
    good = usable(ceilings)
    marked = {
        group: group
        + " †" * int(bad)
        + " *" * int(len(ceilings) > 0 and group.partition(" → ")[2] not in good)
        for group, bad in zip(means.index, worse, strict=True)
    }
    return result_table(
        f"Group by group, {data} contacts: mean MAE on the target's test frames, N",
        frame.rename(marked).rename_axis("group"),
        f"± standard deviation over {_seeds(runs)}. † {PLAIN} is worse than the source's mean force always. {note}",
        {"": "{:.3f}"},
    )


def ceiling_table(ceilings: pd.DataFrame) -> ResultTable:
    """What training on the target itself reaches, and whether that is a ceiling."""
    columns = ["error_n", *[f"MAE {axis}, N" for axis in AXES], *R2]
    frame = ceilings[columns].groupby(level="target").mean().rename(columns={"error_n": "mean MAE, N"})
    frame["used"] = ["yes" if target in usable(ceilings) else "NO" for target in frame.index]
    return result_table(
        "The ceiling: trained on the target's own labels",
        frame,
        f"{ceilings.index.get_level_values('seed').nunique()} seed(s); on the target's test points, which training "
        f"does not show. A target whose R² is below {LEAST_R2:g} on an axis is left out of the headroom.",
        FORMATS,
    )


def figures(folder: Path) -> list[NamedFigure]:
    """Return errors by group, of the first data set that has any."""
    for data in DATA_SETS:
        if len(runs := load_headline(folder, data)):
            return [NamedFigure("groups", "Target MAE by group and method", plot_groups(runs))]
    return []


def plot_groups(runs: pd.DataFrame) -> "Figure":
    """Draw the main methods' errors in each group as bars beside the constant mean."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.8), layout="constrained")
    axes, errors = figure.subplots(), counted(runs)
    shown = [method for method in errors if method in board.MAIN_METHODS]
    means, deviations = by_group(errors)[shown], errors[shown].groupby(level=0, sort=False).std().fillna(0.0)
    means.plot.bar(ax=axes, yerr=deviations, width=0.8, rot=0, legend=False, fontsize=8, xlabel="")
    place = np.arange(len(means))
    level = constant_mean(runs)[means.index]
    axes.hlines(level, place - 0.4, place + 0.4, "k", "dotted", label=CONSTANT)
    axes.set_xticklabels([group.replace(" → ", "\n→ ") for group in means.index])
    axes.set_ylabel("target MAE, N")
    figure.legend(loc="outside upper center", fontsize=8, ncols=(len(shown) + 3) // 2)
    return figure


PART = Part(measure, tables, figures)
