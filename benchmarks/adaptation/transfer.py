"""Whether what was chosen on the tuning groups holds: the grid of a few methods on the nine groups."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.choice import SELECTOR
from gelgap.benchmarks.adaptation.jobs import Bench, RunRecord
from gelgap.benchmarks.adaptation.paper import GROUPS, PAPER_METHODS
from gelgap.benchmarks.adaptation.parts import Part
from gelgap.benchmarks.adaptation.running import run_missing
from gelgap.benchmarks.adaptation.tables import by_column, numbers
from gelgap.benchmarks.adaptation.tuning import (
    GRIDS,
    candidates_of,
    chosen_values,
    grid_jobs,
    tuned_methods,
)
from gelgap.benchmarks.adaptation.tuning import RECORD as TUNING_RECORD
from gelgap.benchmarks.adaptation.work import scored_job
from gelgap.benchmarks.common.records import read_records

RECORD = "transfer.jsonl"
SEEDS = (0,)


def measure(bench: Bench) -> None:
    """Do the grid's missing runs on the nine groups, by default of one seed."""
    bench.generate_set("paired")
    methods = tuned_methods(bench.methods or PAPER_METHODS)
    cases = [("paired", group) for group in GROUPS]
    run_missing(bench, grid_jobs(cases, methods, bench.seeds or SEEDS), RECORD, scored_job)


def tables(folder: Path) -> list[ResultTable]:
    """Return the regret of the frozen choice on the nine groups, and that of every selector."""
    tuning, nine = (read_records(folder / name, RunRecord) for name in (TUNING_RECORD, RECORD))
    chosen = chosen_values(tuning)
    shown = [m for m in chosen if candidates_of(nine, m).cases]
    tables = [frozen_table(nine, {m: chosen[m] for m in shown})] if shown else []
    return [*tables, selector_table(tuning, nine)] if chosen else []


def frozen_table(nine: Sequence[RunRecord], chosen: dict[str, float]) -> ResultTable:
    """Error on the nine groups by candidate, and the regret of the frozen one."""
    found = {method: candidates_of(nine, method) for method in chosen}
    regrets = [own.regret_n(own.names.index(chosen[method])) for method, own in found.items()]
    best = [own.errors_n.mean(axis=0).argmin() for own in found.values()]
    return by_column(
        "Does the choice transfer? The frozen settings on the nine groups",
        "method",
        chosen,
        {
            "candidates": [", ".join(f"{value:g}" for value in own.names) for own in found.values()],
            "mean MAE, N": [", ".join(numbers(own.errors_n.mean(axis=0))) for own in found.values()],
            "frozen": [f"{value:g}" for value in chosen.values()],
            "best one for all groups": [
                f"{own.names[i]:g}" for own, i in zip(found.values(), best, strict=True)
            ],
            "regret, N": numbers([regret.mean() for regret in regrets]),
            "worst, N": numbers([regret.max() for regret in regrets]),
        },
        "Paired contacts, split by contact point. Regret: test error of the frozen candidate less that of the best in "
        "each group, which only the target's labels tell.",
    )


def selector_table(tuning: Sequence[RunRecord], nine: Sequence[RunRecord]) -> ResultTable:
    """The regret of each selector, frozen on the tuning groups or choosing in each group anew."""
    from gelgap.adapt import SELECTORS

    on_tuning = [own for own in (candidates_of(tuning, m) for m in GRIDS) if own.cases]
    on_nine = {m: own for m in GRIDS if (own := candidates_of(nine, m)).cases}

    def frozen(selector: str) -> float:
        own = [
            found.regret_n(candidates_of(tuning, method).choice(selector))
            for method, found in on_nine.items()
            if candidates_of(tuning, method).cases
        ]
        return float(np.concatenate(own).mean()) if own else np.nan

    return by_column(
        "Regret of selectors without target labels, N",
        "selector",
        [f"{name} (used)" if name == SELECTOR else name for name in SELECTORS],
        {
            "tuning groups, one choice for all": numbers(
                [_mean([own.regret_n(own.choice(name)) for own in on_tuning]) for name in SELECTORS]
            ),
            "tuning groups, each anew": numbers(
                [_mean([own.own_regret_n(name) for own in on_tuning]) for name in SELECTORS]
            ),
            "nine groups, chosen on tuning groups": numbers([frozen(name) for name in SELECTORS]),
            "nine groups, each anew": numbers(
                [_mean([own.own_regret_n(name) for own in on_nine.values()]) for name in SELECTORS]
            ),
        },
        f"Mean over methods and cases; on the nine groups of {', '.join(on_nine) or 'no method'}.",
    )


def _mean(regrets: Sequence[np.ndarray]) -> float:
    return float(np.concatenate(regrets).mean()) if regrets else np.nan


PART = Part(measure, tables)
run = PART.run
