"""The headline: all methods on the nine groups, paired and independent contacts, several seeds, split by point."""

import math
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import pandas as pd

from gelgap.adapt import NamedFigure, ResultTable
from gelgap.adapt.report import mean_and_deviation
from gelgap.benchmarks.adaptation import board
from gelgap.benchmarks.adaptation.board import AXES, CEILING, DESIGNS, GROUPS, PAPER_MAE_N, PLAIN
from gelgap.benchmarks.adaptation.study import (
    ORACLES,
    RUNS,
    Part,
    Study,
    adapt_run,
    grid,
    is_benchmark,
    load_runs,
    read_results,
    write_results,
)
from gelgap.benchmarks.common import Setting, bootstrap, kendall_tau, result_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SEEDS = (0, 1, 2, 3, 4)
QUICK_GROUP = ("mb0i0", "wmb1i1")
QUICK_METHODS = (PLAIN, "adabn", "classifier-only", "dsan", CEILING)
LEAST_R2 = (0.8, 0.8, 0.9)
"""R² that supervised-on-target and source-only on its source must reach in Fx, Fy, Fz for a profile to count."""
R2 = [f"R² {axis}" for axis in AXES]
NAMES = [" → ".join(group) for group in GROUPS]
FORMATS = {"": "{:.3f}", "rank": "{:.1f}", **dict.fromkeys(R2, "{:.2f}")}
CAVEAT = (
    "A description, not a test: the nine groups are made of four domains, groups of one source share its first stage, "
    "and mb0i0 and wmb0i0 show the same contacts, so they are not nine independent cases."
)


def measure(study: Study) -> None:
    """Do the missing runs; then those of the paper's split, which come last."""
    from gelgap.domains import make_recipes
    from gelgap.sim import ContactPath

    chosen = study.known_methods()
    if study.is_quick:  # the domains at their least: nine points of four poses at draft quality
        path = ContactPath("quick", (-2.25, 0.0, 2.25), (-1.3, 0.0, 1.3), (0.6,), (0.4,), (0, 90, 180, 270))
        options = {"quality": "draft", "render_quality": "draft", "size_px": (160, 120), "seed": 0}
        study.generate(make_recipes(QUICK_GROUP, path, **options))
        keep_oracles(study, [QUICK_GROUP])
        runs = grid([("paired", QUICK_GROUP)], chosen or QUICK_METHODS, study.seeds or SEEDS[:1])
    else:
        study.generate_sets(*DESIGNS)
        keep_oracles(study, GROUPS)
        runs = headline_grid(chosen, study.seeds or SEEDS)
    study.run(adapt_run, runs, RUNS)


def headline_grid(methods: Sequence[str] = (), seeds: Iterable[int] = SEEDS) -> list[Setting]:
    """Return all runs: a seed is complete, in both designs, before the next one begins; the paper's split is last."""
    cases = [(design, group) for design in DESIGNS for group in GROUPS]
    by_point = grid(cases, methods or board.METHODS, seeds)
    return by_point + grid(cases[: len(GROUPS)], methods or board.MAIN_METHODS, seeds, board.AT_RANDOM)


def keep_oracles(study: Study, groups: Iterable[board.Group]) -> None:
    """Keep both oracles of every group beside the runs, so that a report needs no data."""
    from gelgap.adapt import Presses, geometry_oracle, pose_oracle
    from gelgap.domains import open_domain

    found = {}
    for group in groups:
        pair = [open_domain(study.data / "paired" / name) for name in group]
        pose, geometry = pose_oracle(*pair), geometry_oracle(*map(Presses.of, pair))
        found[" → ".join(group)] = {"pose_n": pose.mae_n, "geometry_n": geometry.mae_n}
    write_results(study.out / ORACLES, found)


def load_oracles(folder: Path) -> pd.DataFrame:
    """Return the oracles' MAE by group, N; `comparable`: an alignment of poses could reach the paper's DSAN figure."""
    kind = dict[str, dict[Literal["pose_n", "geometry_n"], tuple[float, float, float]]]
    found = pd.DataFrame(read_results(folder / ORACLES, kind)).T.rename_axis("group")
    papers = pd.Series(PAPER_MAE_N["dsan"], NAMES)
    for name in ("pose", "geometry"):
        found[[f"{name} F{axis}" for axis in AXES]] = found[f"{name}_n"].tolist()
        found[f"{name} oracle"] = found[f"{name}_n"].map(np.mean)
    return found.assign(comparable=found["pose oracle"] <= papers.reindex(found.index, fill_value=math.inf))


def load_headline(
    folder: Path, data: str = "paired", changes: board.Changes = board.BY_POINT
) -> pd.DataFrame:
    """Return the runs of a data set and split.

    Raises
    ------
    ValueError
        If the runs of a group are not all of one configuration.
    """
    runs = load_runs(folder / RUNS)
    runs = runs[(runs["data"] == data) & runs["changes"].isin([changes]) & runs["group"].isin(NAMES)]
    for group, own in runs.groupby("group"):
        if len(own[["profile", "configuration"]].drop_duplicates()) > 1:
            raise ValueError(
                f"{folder / RUNS}: the runs of {group}, {data} contacts, are of more than one configuration; only runs "
                "of one profile and of the same data can be compared"
            )
    return runs


def methods_of(runs: pd.DataFrame, *left_out: str) -> list[str]:
    """Return the methods that were run, in the board's order, others last."""
    there = list(runs["method"].unique())
    return [
        method
        for method in dict.fromkeys([*board.METHODS, *there])
        if method in there and method not in left_out
    ]


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


def stage1_s(runs: pd.DataFrame) -> float:
    """Return the median time of the first stage, which all methods of a source and seed share; NaN if none has one."""
    return float(runs.loc[runs["stage1_s"] > 0, "stage1_s"].median())


def tables(folder: Path) -> list[ResultTable]:
    """Return all tables about the groups that the finished runs allow."""
    if not is_benchmark(folder):
        return []
    designs = {design: runs for design in DESIGNS if len(runs := load_headline(folder, design))}
    oracles, at_random = load_oracles(folder), load_headline(folder, "paired", board.AT_RANDOM)

    def of_each(*kinds) -> list[ResultTable]:
        return [table(runs, design) for table in kinds for design, runs in designs.items()]

    found = of_each(method_table, control_table, partial(group_table, oracles=oracles))
    compared = {design: runs for design, runs in designs.items() if PLAIN in methods_of(runs)}
    for table, needed in ((adabn_table, {"adabn"}), (order_table, set(PAPER_MAE_N))):
        if compared and all(needed <= set(methods_of(runs)) for runs in compared.values()):
            found.append(table(compared))
    found += of_each(shear_table)
    if len(at_random) and "paired" in designs:
        found.append(split_table(at_random, designs["paired"]))
    return [*found, *of_each(check_table), oracle_table(oracles), *of_each(time_table)]


def summary(runs: pd.DataFrame) -> pd.DataFrame:
    """Return each method's error with its interval, R² per axis, and mean rank over the groups, the ceiling apart."""
    errors = counted(runs)
    frame = over_groups(errors).rename_axis("method").to_frame("mean MAE, N")
    frame["95 % interval"] = [bootstrap(errors[method].unstack(sort=False).to_numpy()) for method in errors]
    for column in R2:
        frame[column] = over_groups(counted(runs, column))
    return frame.assign(rank=ranks(by_group(errors)[methods_of(runs, CEILING)]).mean())


def method_table(runs: pd.DataFrame, design: str) -> ResultTable:
    """Each method's error, R² per axis and rank; in the note Friedman's test, with and without source-only."""
    from scipy.stats import friedmanchisquare

    frame, means, tests = summary(runs), by_group(counted(runs)), []
    for name, left_out in (("all", (CEILING,)), (f"without {PLAIN}", (CEILING, PLAIN))):
        found = ranks(means[methods_of(runs, *left_out)])
        if found.shape[1] > 2 and len(found) > 1:
            p = friedmanchisquare(*found.to_numpy().T).pvalue
            difference = critical_difference(found.shape[1], len(found))
            tests.append(f"{name}: Friedman's p = {p:.2g}, Nemenyi's difference {difference:.1f}")
    frame[f"without {PLAIN}"] = ranks(means[methods_of(runs, CEILING, PLAIN)]).mean()
    frame["collapsed"] = runs.groupby("method")["problem"].count()
    frame["paper, N"] = pd.DataFrame(PAPER_MAE_N).mean()
    tested = f"Ranks over group means, {'; '.join(tests)}. {CAVEAT}" if tests else ""
    return result_table(
        f"All methods, {design} contacts: mean over {len(means)} groups",
        frame,
        f"Split by contact point; {_seeds(runs)}. Intervals: bootstrap over groups and seeds. Ranks: means over the "
        f"groups. A run that collapsed counts with the constant mean's error. {tested}",
        {**FORMATS, f"without {PLAIN}": "{:.1f}", "collapsed": "{:d}"},
    )


def _seeds(runs: pd.DataFrame) -> str:
    whole, seeds = counted(runs).notna().any(axis=1), f"{runs['seed'].nunique()} seed(s)"
    finished = f"({whole.sum()} of {len(whole)} pairs of group and seed are finished by all methods)"
    return seeds if whole.all() else f"{seeds} {finished}"


def critical_difference(methods: int, cases: int, level: float = 0.05) -> float:
    """Return Nemenyi's critical difference of mean ranks (Demšar, JMLR 7, 2006)."""
    from scipy.stats import studentized_range

    q = studentized_range.ppf(1 - level, methods, np.inf) / np.sqrt(2)
    return float(q * np.sqrt(methods * (methods + 1) / (6 * cases)))


def control_table(runs: pd.DataFrame, design: str) -> ResultTable:
    """What each method's loss brings: its error less that of its own control over the same groups and seeds."""
    errors, controls = counted(runs), runs.groupby("method")["control"].first()
    methods = [method for method in errors if controls[method] in errors]
    gains = pd.DataFrame({method: errors[method] - errors[controls[method]] for method in methods})
    means = by_group(gains)
    pairs = [group.split(" → ") for group in means.index]
    kept = [[domain not in pair for pair in pairs] for domain in {d for pair in pairs for d in pair}]
    without = pd.DataFrame([means[rows].mean(skipna=False) for rows in kept if any(rows)], columns=methods)
    return result_table(
        f"Methods against their own controls, {design} contacts",
        pd.DataFrame(
            {
                "control": controls[methods],
                "difference, N": means.mean(skipna=False),
                "95 % interval": [bootstrap(gains[m].unstack(sort=False).to_numpy()) for m in methods],
                "better in": [f"{count} of {len(means)}" for count in (means < 0).sum()],
                "leaving out a domain": list(zip(without.min(), without.max(), strict=True)),
            }
        ).rename_axis("method"),
        f"Error less that of the control over the same groups and seeds, negative where the method is better; "
        f"{_seeds(runs)}. Interval: bootstrap over groups and seeds. Last column: range of the mean when the groups "
        "of one domain are left out.",
        {"": "{:+.4f}"},
    )


def group_table(runs: pd.DataFrame, design: str, oracles: pd.DataFrame) -> ResultTable:
    """The main methods group by group, beside baselines without learning; the oracles are those of paired contacts."""
    oracles = oracles if design == "paired" else oracles[:0]
    errors, constant = counted(runs), constant_mean(runs)
    means = by_group(errors)
    shown = [method for method in means if method in board.MAIN_METHODS]
    worse = means[PLAIN] > constant[means.index] if PLAIN in means else constant.isna()
    unfair = ~oracles["comparable"].reindex(means.index, fill_value=True).astype(bool)
    numbers = means[shown].join(oracles[["pose oracle", "geometry oracle"]]).dropna(axis=1, how="all")
    numbers.insert(0, "constant mean", constant)
    frame = numbers.astype(object)
    for method in shown:
        frame[method] = errors[method].groupby(level=0, sort=False).apply(mean_and_deviation).astype(object)
    frame.loc["mean"] = numbers.mean(skipna=False)
    marked = {group: group + " †" * int(worse[group]) + " *" * int(unfair[group]) for group in means.index}
    return result_table(
        f"Group by group, {design} contacts: mean MAE on the target's test frames, N",
        frame.rename(marked).rename_axis("group"),
        f"± standard deviation over {_seeds(runs)}. † {PLAIN} is worse than the source's mean force always: "
        f"{worse.sum()} of {len(means)} groups. * The pose oracle is worse than the paper's DSAN figure, so that "
        f"the group is not comparable: {unfair.sum()} of {len(means)}.",
        {"": "{:.3f}"},
    )


def adabn_table(designs: dict[str, pd.DataFrame]) -> ResultTable:
    """The share of the way from source-only to each method that AdaBN alone goes."""
    columns = {}
    for design, runs in designs.items():
        means = over_groups(counted(runs))
        columns[f"{design}: change from {PLAIN}"] = 100 * (means / means[PLAIN] - 1)
        share = (means[PLAIN] - means["adabn"]) / (means[PLAIN] - means)
        columns[f"{design}: AdaBN's share"] = 100 * share.where(means < means[PLAIN])
    shown = dict.fromkeys(method for runs in designs.values() for method in methods_of(runs, PLAIN, "adabn"))
    return result_table(
        "How much of each method's gain is batch normalisation",
        pd.DataFrame(columns).reindex(list(shown)).rename_axis("method"),
        f"Share: what AdaBN takes off {PLAIN}'s mean error over what the method takes off. Above 100 %, AdaBN alone is "
        "better.",
        {name: "{:.0f} %" if "share" in name else "{:+.0f} %" for name in columns},
    )


def order_table(designs: dict[str, pd.DataFrame]) -> ResultTable:
    """Whether the paper's order of its four methods is found, group by group."""
    order, columns, falling = list(PAPER_MAE_N), {}, -np.arange(len(PAPER_MAE_N))
    for design, runs in designs.items():
        errors = by_group(counted(runs))[order]
        errors.loc["of the means"] = errors.mean(skipna=False)
        found = errors.apply(lambda row: " > ".join(row.sort_values(ascending=False).index), axis=1)
        columns[f"{design}: order"] = found.where(errors.notna().all(axis=1))
        columns[f"{design}: τ"] = errors.apply(kendall_tau, axis=1, raw=True, second=falling)
        columns[f"{design}: the paper's"] = (errors.diff(axis=1).iloc[:, 1:] < 0).all(axis=1).astype(object)
    groups = dict.fromkeys(group for column in columns.values() for group in column.index[:-1])
    tau = np.mean([kendall_tau(column, falling) for column in np.transpose(list(PAPER_MAE_N.values()))])
    return result_table(
        "Is the paper's order of methods found?",
        pd.DataFrame(columns, index=pd.Index([*groups, "of the means"], name="group")),
        f"The paper's order of means, the worst first: {' > '.join(order)}. τ: Kendall's with it (1: the same order); "
        f"its own groups have {tau:.2f} in the mean.",
        {"": "{:+.2f}"},
    )


def shear_table(runs: pd.DataFrame, design: str) -> ResultTable:
    """Whether shear is read at all: R² of Fx and Fy by group."""
    shear = runs.assign(shear=runs[R2[:2]].mean(axis=1)).pivot_table("shear", "group", "method")
    return result_table(
        f"Shear, {design} contacts: R² on the target, mean of Fx and Fy",
        shear.reindex(NAMES).dropna(how="all")[[m for m in methods_of(runs) if m in board.MAIN_METHODS]],
        "Mean over seeds. At 0 or below a method is no better than the target's mean force.",
        {"": "{:.2f}"},
    )


def split_table(at_random: pd.DataFrame, by_point: pd.DataFrame) -> ResultTable:
    """The same methods with frames split at random and by contact point."""
    splits = {"at random": over_groups(counted(at_random)), "by point": over_groups(counted(by_point))}
    frame = pd.DataFrame(splits, index=[m for m in methods_of(at_random) if m in methods_of(by_point)])
    frame["by point over at random"] = frame["by point"] / frame["at random"]
    for name in splits:
        frame[f"rank {name}"] = ranks(frame[[name]].T).T
    return result_table(
        "Split at random or by contact point, paired contacts: mean MAE, N",
        frame.rename_axis("method"),
        f"At random: {_seeds(at_random)}; by point: {_seeds(by_point)}. At random, neighbours of every test frame were "
        "trained on.",
        {"": "{:.0f}", "at random": "{:.3f}", "by point": "{:.3f}", "by point over at random": "{:.2f}"},
    )


def check_table(runs: pd.DataFrame, design: str) -> ResultTable:
    """Whether the profile counts: R² of supervised-on-target and of source-only on its source."""
    names = {PLAIN: f"{PLAIN} on held-out source", CEILING: "supervised on target"}
    good = runs[runs["problem"].isna() & runs["method"].isin(list(names))]
    on_source = good["method"] == PLAIN
    r2 = good["source_held_out_r2"].where(on_source, good["r2"]).dropna()
    places = {
        "condition": good["method"].map(names),
        "domain": good["source"].where(on_source, good["target"]),
    }
    by_place = (
        pd.DataFrame(r2.tolist(), r2.index, R2).join(pd.DataFrame(places)).groupby(list(places), sort=False)
    )
    means, worst = by_place.mean(), by_place.min()
    frame = means.map("{:.2f}".format) + worst.map(" (≥ {:.2f})".format)
    frame["met"] = (means >= list(LEAST_R2)).all(axis=1).map({True: "yes", False: "NO"})
    return result_table(
        f"Does the profile count? {design.capitalize()} contacts",
        frame,
        "Needed in the mean over runs: R² of at least 0.8 in Fx and Fy and 0.9 in Fz (the worst run is in brackets).",
    )


def oracle_table(oracles: pd.DataFrame) -> ResultTable:
    """Both oracles per group and axis."""
    return result_table(
        "Oracles per axis, MAE in N",
        oracles[[f"{name} F{axis}" for name in ("pose", "geometry") for axis in AXES] + ["comparable"]],
        "From paired contacts. Pose: the source's force at the same command. Geometry: the source gel's force at the "
        "target's contact.",
        {"": "{:.4f}"},
    )


def time_table(runs: pd.DataFrame, design: str) -> ResultTable:
    """Error against training time."""
    times = {"stage 1, s": stage1_s(runs), "stage 2, s": runs.groupby("method")["stage2_s"].median()}
    return result_table(
        f"Target MAE against training time, {design} contacts",
        over_groups(counted(runs)).to_frame("mean MAE, N").assign(**times),
        "Medians of one core's wall time on a shared machine; stage 1 is shared by all methods of a source and seed.",
        {"mean MAE, N": "{:.3f}", "": "{:.1f}"},
    )


def figures(folder: Path) -> list[NamedFigure]:
    """Return errors by group, mean ranks (of two methods or more) and errors against time."""
    runs = load_headline(folder)
    found = [NamedFigure("groups", "Target MAE by group and method", plot_groups(runs, load_oracles(folder)))]
    errors = by_group(counted(runs))[methods_of(runs, CEILING)]
    if errors.shape[1] > 1:
        diagram = plot_critical_difference(errors, "Mean ranks over the groups")
        found.append(NamedFigure("critical-difference", "Mean ranks and critical difference", diagram))
    return [*found, NamedFigure("time", "Target MAE against training time", plot_time(runs))]


def plot_groups(runs: pd.DataFrame, oracles: pd.DataFrame) -> "Figure":
    """Draw the main methods' errors in each group as bars beside the constant mean and the pose oracle."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.8), layout="constrained")
    axes, errors = figure.subplots(), counted(runs)
    shown = [method for method in errors if method in board.MAIN_METHODS]
    means, deviations = by_group(errors)[shown], errors[shown].groupby(level=0, sort=False).std().fillna(0.0)
    means.plot.bar(ax=axes, yerr=deviations, width=0.8, rot=0, legend=False, fontsize=8, xlabel="")
    place = np.arange(len(means))
    for name, levels, style in (
        ("constant mean", constant_mean(runs), "dotted"),
        ("pose oracle", oracles["pose oracle"], "solid"),
    ):
        axes.hlines(levels[means.index], place - 0.4, place + 0.4, "k", style, label=name)
    axes.set_xticklabels([group.replace(" → ", "\n→ ") for group in means.index])
    axes.set_ylabel("target MAE, N")
    figure.legend(loc="outside upper center", fontsize=8, ncols=(len(shown) + 3) // 2)
    return figure


def plot_critical_difference(errors: pd.DataFrame, title: str) -> "Figure":
    """Draw the mean ranks of methods (columns) over cases; bars join those that Nemenyi's test does not tell apart."""
    from matplotlib.figure import Figure
    from scikit_posthocs import critical_difference_diagram, posthoc_nemenyi_friedman

    found = ranks(errors).reset_index(drop=True)
    cases, methods = found.shape
    figure = Figure(figsize=(8, 1.4 + 0.4 * methods), layout="constrained")
    axes = figure.subplots()
    critical_difference_diagram(
        found.mean().to_dict(),
        posthoc_nemenyi_friedman(found),
        cd=critical_difference(methods, cases),
        ax=axes,
        label_fmt_left="{label}  {rank:.2f}",
        label_fmt_right="{rank:.2f}  {label}",
        text_h_margin=0.1,
    )
    axes.set_title(f"{title} (1: least error)", pad=20)
    return figure


def plot_time(runs: pd.DataFrame) -> "Figure":
    """Draw each method's error against the training time of both stages."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5, 3.5), layout="constrained")
    axes = figure.subplots(subplot_kw={"xlabel": "both stages, s of one core", "ylabel": "target MAE, N"})
    seconds = np.nan_to_num(stage1_s(runs)) + runs.groupby("method")["stage2_s"].mean()
    for method, error in over_groups(counted(runs)).items():
        axes.plot(seconds[method], error, "o", alpha=0.7, label=method)
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=8)
    return figure


PART = Part(measure, tables, figures)
