"""Tables of runs: methods over groups of two sensors whose contact points are apart, several seeds, split by point.

The *gap closed* is (start − error)/(start − upper bound), numerator and denominator as means over the groups. The start
is source-only's error in a group and seed, or the constant mean's where that is less. The upper bound is the error of
the same network trained on the target's own labels, at its other contact points.

Groups of the same two sensors, in either direction or with other markers, are not independent, and a seed gives all
groups their split and weights: intervals and p-values draw pairs of sensors, with all their groups, and seeds.
"""

import math

import numpy as np
import pandas as pd
from scipy.stats import kendalltau

from gelgap.adapt.evaluation import BASELINES, CONSTANT
from gelgap.adapt.report import mean_and_deviation
from gelgap.adapt.result_table import ResultTable, cell
from gelgap.benchmarks.adaptation import protocol
from gelgap.benchmarks.adaptation.protocol import AXES, GROUPS, LIGHT_GROUPS, PLAIN, UPPER_BOUND
from gelgap.benchmarks.adaptation.study import with_errors
from gelgap.benchmarks.common import RESAMPLES, drawn_means, interval

LEAST_R2 = 0.9
"""R² that the upper bound must reach on each axis of a target; the gap closed leaves other targets out."""
R2 = [f"R² {axis}" for axis in AXES]
NAMES = [" → ".join(group) for group in (*GROUPS, *LIGHT_GROUPS)]
SHRUNK = "adabn's Fz, mean shear"
RULES = (*BASELINES, SHRUNK)
"""Rows that need no loss: rules without a network, and AdaBN with the source's mean for its shear."""
VALUES = {"mean": "error_n", "Fz": "MAE z, N", "shear": "shear_n"}
"""What methods are ranked by, each apart: a method that predicts no shear is good at neither by hiding it in a mean."""
NOISE_N = {"mean": 0.020, "Fz": 0.047, "shear": 0.009}
"""How far two equal runs of an adapted network come apart at most: docs/results/equal-runs.md."""
FORMATS = {"": "{:z.3f}", **dict.fromkeys(R2, "{:z.2f}")}
CAVEAT = (
    "Groups of the same two sensors are not independent cases, so pairs of sensors are drawn, with their groups, "
    "and seeds."
)


def of_data(runs: pd.DataFrame, data: str) -> pd.DataFrame:
    """Return the runs of a data set from one light to another, on pictures.

    Raises
    ------
    ValueError
        If the runs of a group are not all of one configuration.
    """
    own = runs[(runs["data"] == data) & (runs["shown"] == "pictures") & runs["group"].isin(NAMES)]
    for group, of_group in own.groupby("group"):
        check_one_configuration(of_group, f"the runs of {group}, {data} contacts")
    return own


def check_one_configuration(runs: pd.DataFrame, what: str) -> None:
    """Raise a ValueError if runs are not all of one profile and of the same labels and pictures."""
    if len(runs[["profile", "configuration"]].drop_duplicates()) > 1:
        raise ValueError(
            f"{what}, are of more than one configuration; only runs of one profile and of the same data can be compared"
        )


def upper_bounds(
    runs: pd.DataFrame, data: str = protocol.DATA, changes: protocol.Changes = protocol.BY_POINT
) -> pd.DataFrame:
    """Return a data set's runs of targets that were trained on themselves, on one input, by target and seed."""
    own = runs[(runs["data"] == data) & (runs["source"] == runs["target"]) & runs["changes"].isin([changes])]
    return own.set_index(["target", "seed"]).sort_index()


def with_rules(runs: pd.DataFrame) -> pd.DataFrame:
    """Return runs, and the rules of `RULES` as further methods; what a record does not have is left out."""
    plain, adabn = runs[runs["method"] == PLAIN], runs[runs["method"] == "adabn"]
    rules = []
    for name in BASELINES:
        columns = [f"baselines_mae_n.{name}", f"baselines_r2.{name}"]
        if set(columns) <= set(plain):
            known = plain.dropna(subset=columns)
            rules.append(known.assign(method=name, mae_n=known[columns[0]], r2=known[columns[1]]))
    if len(adabn):
        error = adabn["constant_mean_n"].str[:2] + adabn["mae_n"].str[2:]
        r2 = adabn[f"baselines_r2.{CONSTANT}"].str[:2] + adabn["r2"].str[2:]
        rules.append(adabn.assign(method=SHRUNK, mae_n=error, r2=r2))
    rules = [rule for rule in rules if len(rule)]
    if not rules:
        return runs
    found = pd.concat(rules).assign(problem=None, control=None, stage2_s=0.0)
    return with_errors(pd.concat([runs, found]))


def counted(runs: pd.DataFrame, values: str | list[str] = "error_n") -> pd.DataFrame:
    """Return values by group and seed (rows) and method, of the pairs that all methods have finished.

    Rules come first, then methods in the protocol's order, others last. Methods, the upper bound apart, are compared on
    what every one of them has finished. A run that collapsed counts with the error of the constant mean that it became.
    """
    tested = "frames_sha256.target_test"
    if tested in runs and (runs.groupby(["group", "seed"])[tested].nunique() > 1).any():
        raise ValueError(
            "runs of one group and seed were tested on different frames: measure them on the same data"
        )
    table = runs.pivot(index=["group", "seed"], columns="method", values=values)
    there = runs["method"].unique()
    methods = [method for method in dict.fromkeys([*RULES, *protocol.METHODS, *there]) if method in there]
    table = table.reindex(columns=methods, level="method" if isinstance(values, list) else None)
    table = table.reindex([name for name in NAMES if name in table.index.unique("group")], level="group")
    required = table.columns.get_level_values("method") != UPPER_BOUND
    return table[table.loc[:, required].notna().all(axis=1)]


def by_group(values: pd.DataFrame) -> pd.DataFrame:
    """Return the means over seeds by group and method."""
    return values.groupby(level="group", sort=False).mean()


def sensor_pair(group: str) -> tuple[str, ...]:
    """Return the two sensors, gel and light, of a group such as "mb0i0 → wmb1i1", in alphabetical order."""
    return tuple(sorted(name.removeprefix("w").removeprefix("m") for name in group.split(" → ")))


def draws_of(values: pd.DataFrame) -> np.ndarray:
    """Return bootstrap means (RESAMPLES, columns) of a table by group and seed, over drawn pairs of sensors and seeds.

    They are NaN if there are fewer than two pairs or seeds to choose from.
    """
    groups, seeds = (list(values.index.unique(level)) for level in ("group", "seed"))
    pairs = list(map(sensor_pair, groups))
    if len(set(pairs)) < 2 or len(seeds) < 2:
        return np.full((RESAMPLES, len(values.columns)), math.nan)
    cells = values.reindex(pd.MultiIndex.from_product([groups, seeds])).to_numpy(float)
    return drawn_means(cells.T.reshape(-1, len(groups), len(seeds)), pairs)


def intervals_of(draws: np.ndarray, names: pd.Index) -> pd.Series:
    """Return the 95 % interval of each column of draws (RESAMPLES, columns) by name; None where a draw is NaN."""
    return pd.Series([None if np.isnan(own).any() else interval(own) for own in draws.T], names, dtype=object)


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
    seeds = errors.index.get_level_values("seed")
    if seeds.nunique() < 2 or errors.shape[1] < 3:
        return ""
    of_halves = (by_group(errors[seeds.isin(seeds.unique()[half::2])]).mean() for half in (0, 1))
    return (
        f"Order of methods in two halves of the seeds: Kendall's τ = {kendalltau(*of_halves).statistic:.2f}."
    )


def usable(bounds: pd.DataFrame) -> list[str]:
    """Return the targets whose upper bound reaches R² ≥ 0.9 on each axis, in the mean over seeds."""
    if bounds.empty:
        return []
    least = bounds[R2].groupby(level="target").mean().min(axis=1)
    return list(least.index[least >= LEAST_R2])


def gap_to_close(errors: pd.DataFrame, upper_bound: pd.Series) -> pd.DataFrame:
    """Return by group and seed (rows) start − error of each method, and in the column `upper_bound` the whole gap.

    `upper_bound` has the errors by target and seed; groups and seeds without one are left out.
    """
    start = errors[[name for name in (PLAIN, CONSTANT) if name in errors]].min(axis=1)
    targets = [(group.partition(" → ")[2], seed) for group, seed in errors.index]
    upper_bound = upper_bound.reindex(targets).set_axis(errors.index)
    return errors.rsub(start, axis=0).assign(upper_bound=start - upper_bound)[upper_bound.notna()]


def closed(runs: pd.DataFrame, bounds: pd.DataFrame, values: str = "error_n") -> pd.DataFrame:
    """Return the share of the gap that each method closes, %, its 95 % interval, and of how many groups.

    Only of groups whose target's upper bound is one.
    """
    errors = counted(runs, values)
    found = pd.DataFrame({"share": math.nan, "interval": None, "groups": 0}, errors.columns)
    good = bounds
    if len(good):
        good = good[good.index.isin(usable(good), level="target")]
    if PLAIN not in errors or good.empty or (gains := gap_to_close(errors, good[values])).empty:
        return found
    means, draws = by_group(gains).mean(), draws_of(gains)
    found["groups"] = len(by_group(gains))
    if means["upper_bound"] > 0:
        found["share"] = 100 * means / means["upper_bound"]
    shares = 100 * draws / np.where(draws[:, -1:] > 0, draws[:, -1:], math.nan)
    return found.assign(interval=intervals_of(shares[:, :-1], found.index))


def summary(runs: pd.DataFrame, bounds: pd.DataFrame) -> pd.DataFrame:
    """Return each method's gap closed, errors, R² per axis, and its rank by mean, Fz and shear."""
    mean_shear = runs["constant_mean_n"].map(lambda mae_n: float(np.mean(mae_n[:2])))
    runs = runs.assign(no_shear=(2 * mean_shear + runs["MAE z, N"]) / 3)
    columns = {f"{name}, N": column for name, column in VALUES.items()} | {"no shear, N": "no_shear"}
    of_groups = by_group(counted(runs, [*columns.values(), *R2]))
    # A method that lacks a group has no mean.
    means = of_groups.mean(skipna=False).unstack(level=0)
    shares = {name: closed(runs, bounds, column) for name, column in VALUES.items()}
    frame = shares["mean"][["share", "interval"]].rename(columns={"share": "closed"}).rename_axis("method")
    frame["closed Fz"], frame["closed shear"] = shares["Fz"]["share"], shares["shear"]["share"]
    for name, column in columns.items():
        frame[name] = means[column]
    frame = frame.join(means[R2])
    number = len(counted(runs))
    for name, column in VALUES.items():
        own = means[column].drop(UPPER_BOUND, errors="ignore")
        frame[f"rank {name}"] = ranks(own, NOISE_N[name] / math.sqrt(number or 1))
    return frame.dropna(axis=1, how="all")


def ranks(errors: pd.Series, apart_n: float) -> pd.Series:
    """Return each error's rank, as a range where others are no more than `apart_n` away: 1, 2–4."""
    own = errors.to_numpy()
    further = own[:, None] - own > apart_n
    first, last = 1 + further.sum(axis=1), np.isfinite(own).sum() - further.sum(axis=0)
    found = [f"{low}" if low == high else f"{low}–{high}" for low, high in zip(first, last, strict=True)]
    return pd.Series(found, errors.index).where(errors.notna())


SUMMARY_FORMATS = (
    FORMATS | {"interval": "{:.0f}"} | dict.fromkeys(("closed", "closed Fz", "closed shear"), "{:z.0f} %")
)


def method_table(runs: pd.DataFrame, shown: str, bounds: pd.DataFrame) -> ResultTable:
    """Each method's gap closed, errors, R² per axis, ranks and time; in the note how stable the order is."""
    frame, errors = summary(runs, bounds), counted(runs)
    frame["stage 2, s"] = runs.groupby("method")["stage2_s"].median()
    stage1_s = float(runs.loc[runs["stage1_s"] > 0, "stage1_s"].median())
    collapsed = runs.groupby("method")["problem"].count()
    frame = frame.assign(collapsed=collapsed) if collapsed.any() else frame
    groups = closed(runs, bounds)["groups"].max()
    shares = (
        f"Closed: of the gap, from {PLAIN}'s error, or the constant mean's where less, to that of training on the "
        f"target itself; {groups} groups, whose targets' upper bounds have R² ≥ {LEAST_R2:g} on every axis. "
    )
    return ResultTable.of(
        f"All methods, {shown}: mean over {len(by_group(errors))} groups",
        frame,
        f"Split by contact point; {_seeds(runs)}. {shares if groups else ''}No shear: the method's Fz beside the "
        f"source's mean shear. Intervals: bootstrap, 95 %. {CAVEAT} A run that collapsed counts with the constant "
        "mean's error. Stage 2: median time of a core; stage 1, which all methods of a source and seed share, "
        f"took {cell(stage1_s, '{:.1f}') or '–'} s. {halves(errors)}",
        {**SUMMARY_FORMATS, "collapsed": "{:d}", "stage 2, s": "{:.1f}"},
    )


def _seeds(runs: pd.DataFrame) -> str:
    pairs, whole = len(runs[["group", "seed"]].drop_duplicates()), len(counted(runs))
    finished = f" ({whole} of {pairs} pairs of group and seed are finished by all methods)"
    return f"{runs['seed'].nunique()} seed(s){finished if whole < pairs else ''}"


def control_table(runs: pd.DataFrame, shown: str, bounds: pd.DataFrame) -> ResultTable:
    """What each method's loss brings: its error less that of its own control over the same groups and seeds."""
    errors, controls = counted(runs), runs.groupby("method")["control"].first()
    methods = [method for method in errors if controls.get(method) in errors]
    gains = errors[methods] - errors[controls[methods]].to_numpy()
    means, draws = by_group(gains), draws_of(gains).T
    pairs = means.index.map(sensor_pair)
    kept = [means[pairs != pair] for pair in pairs.unique()] if pairs.nunique() > 1 else []
    without = pd.DataFrame([others.mean(skipna=False) for others in kept], columns=methods)
    p = pd.Series(map(p_value, draws), methods, dtype=float)
    return ResultTable.of(
        f"Methods beside their own controls, {shown}",
        pd.DataFrame(
            {
                "control": controls[methods],
                "difference, N": means.mean(skipna=False),
                "95 % interval": list(map(interval, draws)),
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


def group_table(runs: pd.DataFrame, shown: str, bounds: pd.DataFrame) -> ResultTable:
    """The main methods group by group, beside rules and the upper bound."""
    errors = counted(runs)
    kept = (CONSTANT, SHRUNK, *protocol.MAIN_METHODS)
    errors = errors[[method for method in errors if method in kept]]
    frame = by_group(errors)
    frame.loc["mean"] = by_group(errors).mean(skipna=False)
    if len(bounds):
        own = bounds["error_n"].groupby(level="target").mean()
        frame["upper bound"] = [own.get(group.partition(" → ")[2]) for group in frame.index]
    return ResultTable.of(
        f"Group by group, {shown}: mean MAE on the target's test frames, N",
        frame,
        f"Means over {_seeds(runs)}.",
        {"": "{:.3f}"},
    )


def upper_bound_table(bounds: pd.DataFrame) -> ResultTable:
    """What training on the target itself reaches, and whether that is an upper bound."""
    columns = ["error_n", *[f"MAE {axis}, N" for axis in AXES], *R2]
    frame = bounds[columns].groupby(level="target").mean().rename(columns={"error_n": "mean MAE, N"})
    frame["used"] = ["yes" if target in usable(bounds) else "NO" for target in frame.index]
    return ResultTable.of(
        "The upper bound: trained on the target's own labels",
        frame,
        f"{bounds.index.get_level_values('seed').nunique()} seed(s); on the target's test points, which training "
        f"does not show. A target whose R² is below {LEAST_R2:g} on an axis is left out of the gap closed.",
        FORMATS,
    )


def in_order(runs: pd.DataFrame) -> pd.DataFrame:
    """Return runs by what they show and by method, in the protocol's order; methods from outside come last."""
    methods = list(dict.fromkeys([*protocol.METHODS, *runs["method"]]))
    places = runs.assign(
        shown=runs["shown"].map(protocol.SHOWN.index), method=runs["method"].map(methods.index)
    )
    return runs.loc[places.sort_values(["shown", "method"], kind="stable").index]


def worth_table(
    title: str, runs: pd.DataFrame, bounds: dict[str, pd.DataFrame], note: str = ""
) -> ResultTable:
    """Return what methods close on whatever they are shown; start and rules are those of pictures.

    `bounds` has the upper bounds by input: on the same input, or on pictures where none was trained on it.
    """
    pictures = with_rules(runs[runs["shown"] == "pictures"])
    found: list[pd.DataFrame] = []
    orders: list[str] = []
    for name, own in runs.groupby("shown", sort=False):
        start = pictures[pictures["group"].isin(own["group"])]
        if not found:
            rules = _with_interval(start, bounds["pictures"])
            found.append(rules.drop(own["method"].unique(), errors="ignore"))
        if order := halves(counted(own)):
            orders.append(f"On {name}: {order}")
        renamed = own.assign(method=own["method"] + f" / {name}")
        rows = _with_interval(pd.concat([start, renamed]), bounds[name])
        found.append(rows[rows.index.isin(renamed["method"])])
    frame = pd.concat(found).reindex(columns=WORTH).dropna(axis=1, how="all").rename_axis("method / shown")
    groups = ", ".join(sorted(runs["group"].unique()))
    return ResultTable.of(
        title,
        frame,
        f"{groups}; split by contact point. 95 %: bootstrap over pairs of sensors and seeds. Runs: pairs of group and "
        f"seed that all methods have. {' '.join(orders)}{note}",
        SUMMARY_FORMATS | {"runs": "{:.0f}", "95 %, N": "{:.3f}"},
    )


WORTH = ["closed", "mean, N", "95 %, N", "Fz, N", "shear, N", *R2, "runs"]


def _with_interval(runs: pd.DataFrame, own_bounds: pd.DataFrame) -> pd.DataFrame:
    """Return `summary` with a bootstrap interval of the mean error, over pairs of sensors and seeds."""
    errors = counted(runs)
    frame = summary(runs, own_bounds)
    frame["95 %, N"], frame["runs"] = intervals_of(draws_of(errors), errors.columns), len(errors)
    return frame


def target_table(title: str, runs: pd.DataFrame) -> ResultTable:
    """Return errors and R² of shear target by target: a row for each method on what it is shown."""
    frames = []
    for target, own in runs.groupby("target"):
        by_row = own.groupby(["shown", "method"], sort=False)
        r2 = by_row[R2[:2]].mean()
        columns = {
            "mean, N": by_row["error_n"].agg(mean_and_deviation),
            "Fz, N": by_row["MAE z, N"].mean(),
            "shear, N": by_row["shear_n"].mean(),
            "R² of shear": list(zip(r2.min(axis=1), r2.max(axis=1), strict=True)),
        }
        frames.append(pd.DataFrame({f"{target}: {name}": column for name, column in columns.items()}))
    frame = pd.concat(frames, axis=1)
    patterns = {name: "{:z.2f}" for name in frame if "R²" in name}
    seeds = runs["seed"].nunique()
    note = f"± standard deviation over {seeds} seed(s); R² of Fx and Fy, the lesser and the greater."
    return ResultTable.of(title, frame, note, {"": "{:z.3f}"} | patterns)
