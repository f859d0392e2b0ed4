"""What is chosen without target labels, on groups that are not compared: augmentations, and a setting of each method.

One rule for all: every case (data set, group, seed) ranks the candidates by the selector's score, those that collapsed
or look like constant predictors last, and the candidate of least mean rank is chosen, of equals the first. Regret is
the error of a choice less that of the best candidate. `transfer` asks whether the choice holds on the nine groups.
"""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gelgap.adapt import SELECTORS, ResultTable
from gelgap.assets.names import unknown_name
from gelgap.benchmarks.adaptation import board
from gelgap.benchmarks.adaptation.study import Part, Study, grid, load_runs, scored_run, with_errors
from gelgap.benchmarks.common import Setting, result_table

SELECTOR = "reverse validation"
"""Fixed before anything was tuned, for its regret in an earlier study; the others are shown beside it, not used."""
AUGMENTATIONS, TUNED, NINE_GROUPS = "augmentations.jsonl", "tuning.jsonl", "transfer.jsonl"
SEEDS = (0,)
NINE = [("paired", group) for group in board.GROUPS]
_WEIGHTED = ("coral", "dan", "jan", "dann", "cdan", "rsd", "daregram", "cod", "dsan", "dsan-soft")
GRIDS: dict[str, tuple[str, tuple[float, ...]]] = {
    **dict.fromkeys(
        (*_WEIGHTED, "mean-teacher", "uga"), ("transfer_weight", (0.0003, 0.003, 0.03, 0.3, 3.0))
    ),
    "importance-weighting": ("transfer_weight", (0.01, 0.03, 0.1, 0.3, 1.0)),  # 1 is the whole weight
    "tasfar": ("learning_rate", (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)),
    "ssa": ("learning_rate", (1e-5, 1e-4, 1e-3, 1e-2, 1e-1)),
}
"""The setting by which each method's strength is tuned, and its candidates: as many for one as for another, rising."""
METHOD = "no-transfer"
"""The method by which augmentations are chosen: no loss of a method has a say."""
SHOWN_METHODS = (board.PLAIN, METHOD)
FIELDS = ("shift_px", "colour_mixing", "marker_hiding")
SHIFT_PX = 3
"""About half the spacing of the contact points in the network's picture."""
AUGMENTED = {
    "none": (0, 0.0, 0.0),
    "shifts": (SHIFT_PX, 0.0, 0.0),
    "shifts, mixed colours": (SHIFT_PX, 0.5, 0.0),
    "shifts, hidden markers": (SHIFT_PX, 0.0, 0.5),
    "all three": (SHIFT_PX, 0.5, 0.5),
}
VARIANTS = {name: (*board.BY_POINT, *zip(FIELDS, own, strict=True)) for name, own in AUGMENTED.items()}
VARIANTS["shifts, inputs standardised by domain"] = (*VARIANTS["shifts"], ("input_standardisation", "domain"))
"""The candidates, and last a control that is none."""


def compared(runs: pd.DataFrame, candidates: Iterable) -> pd.DataFrame:
    """Return the cases (data set, group, seed) in which every candidate was run, with columns for each candidate.

    `error_n` is the test error on the target, which no selector sees, `regret_n` that less the best candidate's; under
    the name of a selector stands the rank by its score, 1 the best, ties shared.
    """
    names = list(candidates)
    runs = runs[runs["candidate"].isin(names)]
    values = runs.reindex(columns=[f"scores.{name}" for name in SELECTORS]).set_axis(list(SELECTORS), axis=1)
    values[runs["problem"].notna() | runs["alarm"].astype(bool)] = math.inf
    values = values.fillna(math.inf).assign(error_n=runs["error_n"])
    index = pd.MultiIndex.from_frame(runs[["data", "group", "seed", "candidate"]])
    columns = pd.MultiIndex.from_product([values.columns, names])
    table = values.set_axis(index).unstack().reindex(columns=columns)
    table = table[table["error_n"].notna().all(axis=1)]
    errors_n = table["error_n"]
    ranks = {name: table[name].rank(axis=1) for name in SELECTORS}
    least_n = errors_n.min(axis=1)
    return pd.concat({"error_n": errors_n, "regret_n": errors_n.sub(least_n, axis=0), **ranks}, axis=1)


def chosen(found: pd.DataFrame, selector: str = SELECTOR) -> Any:
    """Return the candidate of least mean rank over the cases; the first of equals."""
    return found[selector].mean().idxmin()


def regret_anew_n(found: pd.DataFrame, selector: str = SELECTOR) -> list[float]:
    """Return the regret of a selector that chooses in every case anew, N."""
    anew = found[selector].idxmin(axis=1)
    return [found["regret_n"].loc[case, candidate] for case, candidate in anew.items()]


def of_grid(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the candidates of each method that has a complete case among the runs of a grid."""
    runs = runs.assign(candidate=[settings[0][1] for settings in runs["settings"]])
    found = {
        method: compared(runs[runs["method"] == method], values) for method, (_, values) in GRIDS.items()
    }
    return {method: own for method, own in found.items() if len(own)}


def augmented(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the augmentations among the runs on the tuning groups."""
    return compared(_named(runs)[runs["data"].isin(board.TUNING_SETS)], AUGMENTED)


def _named(runs: pd.DataFrame) -> pd.DataFrame:
    return runs.assign(candidate=runs["changes"].map({changes: name for name, changes in VARIANTS.items()}))


def tuned_methods(chosen: Sequence[str] | None = None) -> list[str]:
    """Return the methods that have a grid, or those chosen.

    Raises
    ------
    ValueError
        If a chosen method has no grid.
    """
    for method in chosen or ():
        if method not in GRIDS:
            raise ValueError(unknown_name("method", method, GRIDS, "methods with a grid"))
    return list(chosen or GRIDS)


def grid_runs(
    cases: Iterable[tuple[str, board.Group]], methods: Iterable[str], seeds: Iterable[int]
) -> list[Setting]:
    """Return the runs of every candidate of some methods."""
    settings = {method: [((name, value),) for value in values] for method, (name, values) in GRIDS.items()}
    return grid(cases, methods, seeds, settings=settings.get)


def variant_runs(
    cases: Sequence[tuple[str, board.Group]], methods: Sequence[str], seeds: Iterable[int]
) -> list[Setting]:
    """Return the runs of every variant of the augmentations."""
    return [run for seed in seeds for own in VARIANTS.values() for run in grid(cases, methods, [seed], own)]


def tune(study: Study) -> None:
    """Do the grid's missing runs on the tuning groups, and print what the profile's file needs."""
    runs = grid_runs(board.TUNING_CASES, tuned_methods(study.methods), study.seeds or SEEDS)
    study.generate_sets(*board.TUNING_SETS)
    print(settings_toml(with_errors(study.run(scored_run, runs, TUNED))))


def transfer(study: Study) -> None:
    """Do the grid's missing runs on the nine groups, by default of the paper's methods and one seed."""
    runs = grid_runs(NINE, tuned_methods(study.methods or board.PAPER_METHODS), study.seeds or SEEDS)
    study.generate_sets("paired")
    study.run(scored_run, runs, NINE_GROUPS)


def augment(study: Study) -> None:
    """Do the missing runs on the tuning groups, print what the profile's file needs, then those on the nine groups."""
    seeds = study.seeds or SEEDS
    study.generate_sets(*board.TUNING_SETS)
    found = study.run(scored_run, variant_runs(board.TUNING_CASES, [METHOD], seeds), AUGMENTATIONS)
    print(augmentation_toml(with_errors(found)))
    study.generate_sets("paired")
    study.run(scored_run, variant_runs(NINE, SHOWN_METHODS, seeds), AUGMENTATIONS)


def settings_toml(runs: pd.DataFrame) -> str:
    """Return the tables of the profile's file that freeze the choice."""
    found = [f"[settings.{m}]\n{GRIDS[m][0]} = {chosen(own):g}" for m, own in of_grid(runs).items()]
    return "\n".join(["# python -m gelgap.benchmarks.adaptation tuning", *found])


def augmentation_toml(runs: pd.DataFrame) -> str:
    """Return the lines of the profile's file that freeze the choice; nothing if no group is complete."""
    found = augmented(runs)
    if found.empty:
        return ""
    fields = [f"{name} = {value:g}" for name, value in zip(FIELDS, AUGMENTED[chosen(found)], strict=True)]
    return "\n".join(["# python -m gelgap.benchmarks.adaptation augmentations", *fields])


def choice_frame(found: dict[str, pd.DataFrame], choice: dict[str, float]) -> pd.DataFrame:
    """Return what is known of each method's candidates and of the chosen one, whose regret is over the cases."""
    rows = {}
    for method, value in choice.items():
        own, means = found[method], found[method].mean()
        regret_n = own["regret_n", value]
        rows[method] = {
            "setting": GRIDS[method][0],
            "candidates": ", ".join(map("{:g}".format, GRIDS[method][1])),
            "mean ranks": ", ".join(map("{:.1f}".format, means[SELECTOR])),
            "mean MAE, N": ", ".join(map("{:.3f}".format, means["error_n"])),
            "chosen": f"{value:g}",
            "best one for all groups": f"{means['error_n'].idxmin():g}",
            "regret, N": regret_n.mean(),
            "worst, N": regret_n.max(),
            "cases": len(own),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("method")


def tuning_tables(folder: Path) -> list[ResultTable]:
    """Return each method's mean rank by candidate, what was chosen, and the regret on the tuning groups."""
    found = of_grid(load_runs(folder / TUNED))
    if not found:
        return []
    frame = choice_frame(found, {method: chosen(own) for method, own in found.items()})
    table = result_table(
        "What was chosen for each method, on the tuning groups",
        frame.drop(columns=["mean MAE, N", "best one for all groups"]),
        "Mean ranks are over groups and designs by reverse validation, which sees no target label. Regret: test error "
        "of the chosen candidate less that of the best in each group.",
        {"": "{:.3f}", "cases": "{:d}"},
    )
    return [table]


def transfer_tables(folder: Path) -> list[ResultTable]:
    """Return the regret of the frozen choice on the nine groups, and that of every selector."""
    tuned, nine = (of_grid(load_runs(folder / name)) for name in (TUNED, NINE_GROUPS))
    tables, frozen = [], {method: chosen(own) for method, own in tuned.items() if method in nine}
    if frozen:
        frame = choice_frame(nine, frozen).drop(columns=["setting", "mean ranks", "cases"])
        note = (
            "Paired contacts, split by contact point. Regret: test error of the frozen candidate less that of the best "
            "in each group, which only the target's labels tell."
        )
        title = "Does the choice transfer? The frozen settings on the nine groups"
        tables.append(result_table(title, frame.rename(columns={"chosen": "frozen"}), note, {"": "{:.3f}"}))
    return [*tables, selector_table(tuned, nine)] if tuned else []


def selector_table(tuned: dict[str, pd.DataFrame], nine: dict[str, pd.DataFrame]) -> ResultTable:
    """The regret of each selector, frozen on the tuning groups or choosing in each group anew."""
    rows = {}
    for name in SELECTORS:
        regrets_n = {}
        for cases, found, one in (
            ("tuning groups", tuned, "one choice for all"),
            ("nine groups", nine, "chosen on tuning groups"),
        ):
            frozen = [found[m]["regret_n", chosen(own, name)] for m, own in tuned.items() if m in found]
            regrets_n[f"{cases}, {one}"] = frozen
            regrets_n[f"{cases}, each anew"] = [regret_anew_n(own, name) for own in found.values()]
        means = {column: np.mean(np.concatenate(own)) for column, own in regrets_n.items() if own}
        rows[f"{name} (used)" if name == SELECTOR else name] = means
    return result_table(
        "Regret of selectors without target labels, N",
        pd.DataFrame.from_dict(rows, orient="index", columns=list(regrets_n)).rename_axis("selector"),
        f"Mean over methods and cases; on the nine groups of {', '.join(nine) or 'no method'}.",
        {"": "{:.3f}"},
    )


def augmentation_tables(folder: Path) -> list[ResultTable]:
    """Return what was chosen on the tuning groups by the selector, and what each variant changes on the nine groups."""
    runs, tables = load_runs(folder / AUGMENTATIONS), []
    found, on_tuning = augmented(runs), runs["data"].isin(board.TUNING_SETS)
    formats = {"": "{:.3f}", "mean rank": "{:.2f}", **{f"R² {axis}": "{:.2f}" for axis in board.AXES}}
    if len(found):
        frame = axis_frame(runs[on_tuning])
        frame.insert(0, "mean rank", found[SELECTOR].mean())
        frame.insert(1, "chosen", ["yes" if name == chosen(found) else "" for name in frame.index])
        note = (
            f"Mean over {len(found)} cases of group and design. Ranks by reverse validation, which sees no "
            "target label; the errors were not used. The last row is a control, not a candidate."
        )
        tables.append(result_table(f"Augmentations on the tuning groups, {METHOD}", frame, note, formats))
    for method in SHOWN_METHODS:
        own = runs[~on_tuning & (runs["method"] == method)]
        groups, seeds = own["group"].nunique(), own["seed"].nunique()
        note = f"Mean over {groups} groups and {seeds} seed(s); split by contact point."
        title = f"What augmentations change, {method}, paired contacts"
        tables += [result_table(title, axis_frame(own), note, formats)] if len(own) else []
    return tables


def axis_frame(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the mean MAE and R² per axis over each variant's runs."""
    columns = [form.format(axis) for form in ("MAE {}, N", "R² {}") for axis in board.AXES]
    means = _named(runs).groupby("candidate")[["error_n", *columns]].mean().reindex(list(VARIANTS))
    return means.rename(columns={"error_n": "mean MAE, N"}).rename_axis("augmentation")


AUGMENT = Part(augment, augmentation_tables)
TUNE = Part(tune, tuning_tables)
TRANSFER = Part(transfer, transfer_tables)
