"""Augmentations, chosen before anything else on the tuning groups, the same for all methods; and what each changes."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.choice import Candidates, case_of
from gelgap.benchmarks.adaptation.data_sets import TUNING_CASES, TUNING_SETS
from gelgap.benchmarks.adaptation.jobs import BY_POINT, Bench, Changes, RunRecord, TrainingJob
from gelgap.benchmarks.adaptation.paper import GROUPS
from gelgap.benchmarks.adaptation.parts import Part
from gelgap.benchmarks.adaptation.running import run_missing
from gelgap.benchmarks.adaptation.tables import AXES, by_column, numbers
from gelgap.benchmarks.adaptation.work import scored_job
from gelgap.benchmarks.common.records import read_records

RECORD = "augmentations.jsonl"
SEEDS = (0,)
METHOD = "no-transfer"
"""The method by which augmentations are chosen: no loss of a method has a say."""
SHOWN_METHODS = ("source-only", METHOD)


SHIFT_PX = 3
"""About half the spacing of the contact points in the network's picture."""


def _changes(shift_px: int, colours: float, markers: float, **further: str) -> Changes:
    chosen = {"shift_px": shift_px, "colour_mixing": colours, "marker_hiding": markers, **further}
    return (*BY_POINT, *chosen.items())


CANDIDATES = {
    "none": _changes(0, 0.0, 0.0),
    "shifts": _changes(SHIFT_PX, 0.0, 0.0),
    "shifts, mixed colours": _changes(SHIFT_PX, 0.5, 0.0),
    "shifts, hidden markers": _changes(SHIFT_PX, 0.0, 0.5),
    "all three": _changes(SHIFT_PX, 0.5, 0.5),
}
CONTROLS = {
    "shifts, inputs standardised by domain": _changes(SHIFT_PX, 0.0, 0.0, input_standardisation="domain")
}
"""What is shown beside the candidates, but is none."""
VARIANTS = {**CANDIDATES, **CONTROLS}


def variant_jobs(
    cases: Sequence[tuple[str, tuple[str, str]]], methods: Iterable[str], seeds: Iterable[int]
) -> list[TrainingJob]:
    """Return the runs of every variant on data sets and groups."""
    return [
        TrainingJob(source, target, method, seed, data, changes)
        for seed in seeds
        for changes in VARIANTS.values()
        for data, (source, target) in cases
        for method in methods
    ]


def measure(bench: Bench) -> None:
    """Do the missing runs on the tuning groups, print what the profile's file needs, then those on the nine groups."""
    for data in TUNING_SETS:
        bench.generate_set(data)
    seeds = bench.seeds or SEEDS
    records = run_missing(bench, variant_jobs(TUNING_CASES, [METHOD], seeds), RECORD, scored_job)
    print(augmentation_toml(records))
    bench.generate_set("paired")
    run_missing(
        bench, variant_jobs([("paired", group) for group in GROUPS], SHOWN_METHODS, seeds), RECORD, scored_job
    )


def candidates_of(records: Iterable[RunRecord]) -> Candidates:
    """Return the candidates' records on the tuning groups."""
    names = {changes: name for name, changes in CANDIDATES.items()}
    return Candidates(
        tuple(CANDIDATES),
        {
            (case_of(r), names[r.job.changes]): r
            for r in records
            if r.job.data in TUNING_SETS and r.job.changes in names
        },
    )


def augmentation_toml(records: Sequence[RunRecord]) -> str:
    """Return the lines of the profile's file that freeze the choice; nothing if no group is complete."""
    found = candidates_of(records)
    if not found.cases:
        return ""
    chosen = dict(CANDIDATES[found.names[found.choice()]])
    fields = [f"{name} = {chosen[name]:g}" for name in ("shift_px", "colour_mixing", "marker_hiding")]
    return "\n".join(["# python -m gelgap.benchmarks.adaptation augmentations", *fields])


def tables(folder: Path) -> list[ResultTable]:
    """Return what was chosen, and what each variant changed on the nine groups."""
    records = read_records(folder / RECORD, RunRecord)
    shown = [choice_table(records)] if candidates_of(records).cases else []
    for method in SHOWN_METHODS:
        own = [r for r in records if r.job.data == "paired" and r.job.method == method]
        shown += [axis_table(own, method)] if own else []
    return shown


def choice_table(records: Sequence[RunRecord]) -> ResultTable:
    """Each variant's mean rank by the selector, and its error on the tuning groups, which the choice did not see."""
    found = candidates_of(records)
    ranks = dict(zip(CANDIDATES, found.ranks().mean(axis=0), strict=True))
    chosen = found.names[found.choice()]
    of_variant = {name: _of(records, changes, TUNING_SETS) for name, changes in VARIANTS.items()}
    return by_column(
        f"Augmentations on the tuning groups, {METHOD}",
        "augmentation",
        VARIANTS,
        {
            "mean rank": numbers([ranks.get(name, np.nan) for name in VARIANTS], ".2f"),
            "chosen": ["yes" if name == chosen else "" for name in VARIANTS],
            **_axis_columns(of_variant.values()),
        },
        f"Mean over {len(found.cases)} cases of group and design. Ranks by reverse validation, which sees no target "
        "label; the errors were not used. The last row is a control, not a candidate.",
    )


def axis_table(records: Sequence[RunRecord], method: str) -> ResultTable:
    """What each variant changes on the nine groups, per axis."""
    of_variant = {name: _of(records, changes, ("paired",)) for name, changes in VARIANTS.items()}
    groups = {record.job.group for record in records}
    seeds = {record.job.seed for record in records}
    return by_column(
        f"What augmentations change, {method}, paired contacts",
        "augmentation",
        VARIANTS,
        _axis_columns(of_variant.values()),
        f"Mean over {len(groups)} groups and {len(seeds)} seed(s); split by contact point.",
    )


def _of(records: Iterable[RunRecord], changes: Changes, data: Sequence[str]) -> list[RunRecord]:
    return [record for record in records if record.job.changes == changes and record.job.data in data]


def _axis_columns(variants: Iterable[Sequence[RunRecord]]) -> dict[str, list[str]]:
    """Return the columns of mean MAE and R² per axis over each variant's records."""
    missing = (np.nan,) * 3
    variants = list(variants)
    mae_n = [np.mean([r.mae_n for r in own], axis=0) if own else missing for own in variants]
    r2 = [np.mean([r.r2 for r in own], axis=0) if own else missing for own in variants]
    columns = {"mean MAE, N": numbers([float(np.mean(values)) for values in mae_n])}
    for i, axis in enumerate(AXES):
        columns[f"MAE {axis}, N"] = numbers([values[i] for values in mae_n])
    for i, axis in enumerate(AXES):
        columns[f"R² {axis}"] = numbers([values[i] for values in r2], ".2f")
    return columns


PART = Part(measure, tables)
run = PART.run
