"""One rule for all methods: the same grid and epochs, chosen without target labels on groups that are not compared."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.choice import Candidates, case_of
from gelgap.benchmarks.adaptation.data_sets import TUNING_CASES, TUNING_SETS
from gelgap.benchmarks.adaptation.jobs import BY_POINT, Bench, RunRecord, TrainingJob
from gelgap.benchmarks.adaptation.parts import Part
from gelgap.benchmarks.adaptation.running import run_missing
from gelgap.benchmarks.adaptation.tables import by_column, numbers
from gelgap.benchmarks.adaptation.work import scored_job
from gelgap.benchmarks.common.records import read_records

RECORD = "tuning.jsonl"
SEEDS = (0,)


@dataclass(frozen=True)
class Grid:
    """The setting by which a method's strength is tuned, and its candidates on a logarithmic scale, rising."""

    setting: str = "transfer_weight"
    values: tuple[float, ...] = (0.0003, 0.003, 0.03, 0.3, 3.0)


GRIDS = {
    **dict.fromkeys(
        ("coral", "dan", "jan", "dann", "cdan", "rsd", "daregram", "cod", "dsan", "dsan-soft"), Grid()
    ),
    **dict.fromkeys(("mean-teacher", "uga"), Grid()),
    "importance-weighting": Grid(values=(0.01, 0.03, 0.1, 0.3, 1.0)),  # 1 is the whole weight
    "tasfar": Grid("learning_rate", (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)),
    "ssa": Grid("learning_rate", (1e-5, 1e-4, 1e-3, 1e-2, 1e-1)),
}
"""What is tuned of each method: as many candidates for one as for another."""


def grid_jobs(
    cases: Iterable[tuple[str, tuple[str, str]]], methods: Iterable[str], seeds: Iterable[int]
) -> list[TrainingJob]:
    """Return the grid's runs on data sets and groups, one after the other."""
    return [
        TrainingJob(source, target, method, seed, data, BY_POINT, ((GRIDS[method].setting, value),))
        for seed in seeds
        for data, (source, target) in cases
        for method in methods
        for value in GRIDS[method].values
    ]


def measure(bench: Bench) -> None:
    """Do the grid's missing runs on the tuning groups, and print what the profile's file needs."""
    for data in TUNING_SETS:
        bench.generate_set(data)
    methods, seeds = tuned_methods(bench.methods), bench.seeds or SEEDS
    records = run_missing(bench, grid_jobs(TUNING_CASES, methods, seeds), RECORD, scored_job)
    print(settings_toml(records))


def tuned_methods(chosen: Sequence[str] | None = None) -> list[str]:
    """Return the methods that have a grid, or those chosen.

    Raises
    ------
    ValueError
        If a chosen method has no grid.
    """
    from gelgap.assets.names import unknown_name

    for method in chosen or ():
        if method not in GRIDS:
            raise ValueError(unknown_name("method", method, GRIDS, "methods with a grid"))
    return list(chosen or GRIDS)


def candidates_of(records: Iterable[RunRecord], method: str) -> Candidates:
    """Return a method's candidates among the records of a grid."""
    own = {
        (case_of(r), dict(r.job.settings)[GRIDS[method].setting]): r
        for r in records
        if r.job.method == method
    }
    return Candidates(GRIDS[method].values, own)


def chosen_values(records: Sequence[RunRecord]) -> dict[str, float]:
    """Return the value that is chosen for each method with a complete group."""
    found = {method: candidates_of(records, method) for method in GRIDS}
    return {method: own.names[own.choice()] for method, own in found.items() if own.cases}


def settings_toml(records: Sequence[RunRecord]) -> str:
    """Return the tables of the profile's file that freeze the choice."""
    tables = [
        f"[settings.{method}]\n{GRIDS[method].setting} = {value:g}"
        for method, value in chosen_values(records).items()
    ]
    return "\n".join(["# python -m gelgap.benchmarks.adaptation tuning", *tables])


def tables(folder: Path) -> list[ResultTable]:
    """Return the table of what was chosen, if anything was tuned."""
    records = read_records(folder / RECORD, RunRecord)
    return [choice_table(records)] if chosen_values(records) else []


def choice_table(records: Sequence[RunRecord]) -> ResultTable:
    """Each method's mean rank by candidate, what was chosen, and the regret on the tuning groups."""
    chosen = chosen_values(records)
    own = {method: candidates_of(records, method) for method in chosen}
    ranks = [own[method].ranks().mean(axis=0) for method in chosen]
    regrets = [own[m].regret_n(own[m].choice()) for m in chosen]
    columns = {
        "setting": [GRIDS[method].setting for method in chosen],
        "candidates": [", ".join(f"{value:g}" for value in GRIDS[method].values) for method in chosen],
        "mean ranks": [", ".join(numbers(rank, ".1f")) for rank in ranks],
        "chosen": [f"{value:g}" for value in chosen.values()],
        "regret, N": numbers([regret.mean() for regret in regrets]),
        "worst, N": numbers([regret.max() for regret in regrets]),
        "cases": [str(len(own[method].cases)) for method in chosen],
    }
    note = (
        "Mean ranks are over groups and designs by reverse validation, which sees no target label. Regret: test error "
        "of the chosen candidate less that of the best in each group."
    )
    return by_column("What was chosen for each method, on the tuning groups", "method", chosen, columns, note)


PART = Part(measure, tables)
run = PART.run
