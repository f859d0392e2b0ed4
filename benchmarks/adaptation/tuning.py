"""What is chosen without target labels, on groups that are not compared: a setting of each method.

One rule for all: every case (data set, group, seed) ranks the candidates by the selector's score, those that collapsed
or look like constant predictors last, and the candidate of least mean rank is chosen, of equals the first. Regret is
the error of a choice less that of the best candidate.
"""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation import board
from gelgap.benchmarks.adaptation.study import Part, Study, grid, load_runs, short, trained, with_errors
from gelgap.benchmarks.common import Results, Setting

SELECTOR = "reverse validation"
"""Fixed by argument: of the six it alone goes by the target's predictions back to known forces, so that features which
are aligned wrongly cost it as much as features which are not."""
TUNED = "tuning.jsonl"
SEEDS = (0,)


def ranked(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the runs of the cases in which a method has every candidate, with their rank and their regret.

    `rank` is that by the selector's score, 1 the best, ties shared; `regret_n` is the test error on the target, which
    the selector does not see, less the best candidate's.
    """
    case = ["method", "data", "group", "seed"]
    number = runs.groupby(case)["candidate"].transform("nunique")
    runs = runs[number == runs.groupby("method")["candidate"].transform("nunique")]
    score = runs.get(f"scores.{SELECTOR}", pd.Series(math.nan, runs.index))
    useless = runs["problem"].notna() | runs["alarm"].astype(bool)
    runs = runs.assign(score=score.mask(useless).fillna(math.inf))
    of_case = runs.groupby(case)
    best_n = of_case["error_n"].transform("min")
    return runs.assign(rank=of_case["score"].rank(), regret_n=runs["error_n"] - best_n)


def chosen(found: pd.DataFrame) -> Any:
    """Return the candidate of least mean rank over the cases; the first of equals."""
    return found.groupby("candidate")["rank"].mean().idxmin()


def of_grid(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the ranked candidates of each method that has a complete case among the runs of a grid."""
    found = ranked(runs.assign(candidate=[settings[0][1] for settings in runs["settings"]]))
    methods = dict.fromkeys([*board.METHODS, *found["method"]])
    return {method: own for method in methods if len(own := found[found["method"] == method])}


def tuned_methods(chosen: Sequence[str] | None = None) -> list[str]:
    """Return the methods of the board that have a grid, or those chosen, whose grids are checked.

    Raises
    ------
    ValueError
        If a chosen method has no grid, or a candidate is none that its settings may have.
    """
    from gelgap.adapt.methods.registry import find_method, use_method

    if not chosen:
        return [method for method in board.METHODS if find_method(method).grid]
    for method in (tuned := list(map(use_method, chosen))):
        found = find_method(method)
        if not found.grid:
            raise ValueError(f"method {method} has no grid, so that nothing can be tuned")
        name, values = found.grid
        if list(values) != sorted(set(values)):
            raise ValueError(f"method {method}: grid {values} must rise")
        for value in values:
            found.Settings(**{name: value})
    return tuned


def grid_runs(
    cases: Iterable[tuple[str, board.Group]], methods: Iterable[str], seeds: Iterable[int]
) -> list[Setting]:
    """Return the runs of every candidate of some methods."""
    from gelgap.adapt import find_method

    methods = list(methods)
    grids = {method: find_method(method).grid for method in methods}
    settings = {method: [((name, value),) for value in values] for method, (name, values) in grids.items()}
    return grid(cases, methods, seeds, settings=settings.get)


def tune(study: Study) -> None:
    """Do the grid's missing runs on the tuning groups, and print what the profile's file needs."""
    runs = grid_runs(board.TUNING_CASES, tuned_methods(study.methods), study.seeds or SEEDS)
    study.generate_for(runs)
    print(settings_toml(with_errors(study.run(scored_run, runs, TUNED))))


def scored_run(study: Study, run: Setting) -> Results:
    """Do one run, and score it by the selectors, which see no target label; `alarm`: it may predict a constant."""
    from gelgap.adapt.evaluation import as_judged_on_source
    from gelgap.adapt.selection import Candidate, alarm, scores

    frames, model, results = trained(study, run)
    if model is None:
        return results | {"scores": None, "alarm": False}
    on_source = as_judged_on_source(model, frames.source_train)
    candidate = Candidate(
        source_features=on_source.features(frames.source_held_out),
        source_force_n=frames.source_held_out.force_n,
        source_prediction_n=on_source.predict_n(frames.source_held_out),
        target_features=model.features(frames.target_validation),
        target_prediction_n=model.predict_n(frames.target_validation),
    )
    return results | {"scores": short(scores(candidate)), "alarm": bool(alarm(candidate))}


def settings_toml(runs: pd.DataFrame) -> str:
    """Return the tables of the profile's file that freeze the choice."""
    names = {method: own["settings"].iloc[0][0][0] for method, own in runs.groupby("method")}
    found = [f'[settings."{m}"]\n{names[m]} = {chosen(own):g}' for m, own in of_grid(runs).items()]
    return "\n".join(["# python -m gelgap.benchmarks.adaptation tuning", *found])


def edge_of(value: float, values: Sequence[float]) -> str:
    """Say whether a chosen value ends its grid, so that a further one may be better still."""
    return {values[0]: "lowest", values[-1]: "highest"}.get(value, "")


def tables(folder: Path) -> list[ResultTable]:
    """Return each method's mean rank by candidate, what was chosen, and the regret on the tuning groups."""
    rows = {}
    for method, own in of_grid(load_runs(folder / TUNED)).items():
        value, ranks = chosen(own), own.groupby("candidate")["rank"].mean()
        regret_n = own.loc[own["candidate"] == value, "regret_n"]
        rows[method] = {
            "candidates": ", ".join(map("{:g}".format, ranks.index)),
            "mean ranks": ", ".join(map("{:.1f}".format, ranks)),
            "chosen": f"{value:g}",
            "on the edge": edge_of(value, list(ranks.index)),
            "regret, N": regret_n.mean(),
            "worst, N": regret_n.max(),
            "cases": len(regret_n),
        }
    if not rows:
        return []
    table = ResultTable.of(
        "What was chosen for each method, on the tuning groups",
        pd.DataFrame.from_dict(rows, orient="index").rename_axis("method"),
        "Mean ranks are over groups and designs by reverse validation, which sees no target label. Regret: test error "
        "of the chosen candidate less that of the best in each group. Of 0 as the lowest no loss is better.",
        {"": "{:.3f}", "cases": "{:d}"},
    )
    return [table]


PART = Part(tune, tables, chosen=("seeds", "methods"))
