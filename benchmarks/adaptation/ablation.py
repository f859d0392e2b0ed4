"""Ablation of DSAN: classes, weight, warm-up, statistics, feedback and colour mixing."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.jobs import Bench, Changes, RunRecord, TrainingJob, run_missing
from gelgap.benchmarks.adaptation.parts import Part
from gelgap.benchmarks.adaptation.tables import group_name, numbers, spread
from gelgap.benchmarks.common.records import read_records

RECORD = "ablation.jsonl"
GROUPS = (("mb0i0", "wmb0i0"), ("wmb0i0", "wmb1i1"))
"""A group that differs in markers alone, and one that differs in gel and light."""


@dataclass(frozen=True)
class Variation:
    """One changed thing: what it is called, the method, and the profile's fields that differ."""

    name: str
    method: str
    changes: Changes = ()


def variations() -> tuple[Variation, ...]:
    """Return what is compared; the first is the profile as it is."""

    def dsan(name: str, **changes) -> Variation:
        return Variation(name, "dsan", tuple(changes.items()))

    def each(name: str, **changes) -> tuple[Variation, ...]:
        methods = {"source-only": "source-only", "AdaBN": "adabn", "DSAN": "dsan", "supervised": "supervised"}
        return tuple(
            Variation(f"{name}: {m}", method, tuple(changes.items())) for m, method in methods.items()
        )

    return (
        dsan("DSAN as in the profile"),
        Variation("no transfer loss", "no-transfer"),
        Variation("no stage 2 (AdaBN)", "adabn"),
        *each("no mixed colours (the paper)", colour_mixing=0.0),
        Variation("classes: groups of depth and direction", "dsan-coarse"),
        Variation("classes: soft, by force", "dsan-soft"),
        Variation("classes: none (MK-MMD)", "dan"),
        dsan("weight 0.001", transfer_weight=0.001),
        dsan("weight 0.01", transfer_weight=0.01),
        dsan("weight 0.1", transfer_weight=0.1),
        dsan("weight 1 (the paper)", transfer_weight=1.0),
        dsan("weight 1, after half of stage 2", transfer_weight=1.0, transfer_warmup=0.5),
        dsan("no warm-up", transfer_warmup=0.0),
        dsan("warm-up of half of stage 2", transfer_warmup=0.5),
        dsan("no ramp", transfer_ramp=0.0),
        dsan("classification's whole gradient (the paper)", classification_feedback=1.0),
        dsan("joint statistics", batch_statistics="joint"),
        *each("split by contact point", split_by="point"),
    )


def ablation_jobs(groups: Sequence[tuple[str, str]], seeds: Sequence[int]) -> list[TrainingJob]:
    """Return all runs."""
    return [
        TrainingJob(s, t, v.method, seed, v.changes)
        for seed in seeds
        for v in variations()
        for s, t in groups
    ]


def measure(bench: Bench) -> None:
    """Do the missing runs, by default of one seed."""
    bench.generate_preset()
    run_missing(bench, ablation_jobs(GROUPS, bench.seeds or (0,)), RECORD)


def tables(folder: Path) -> list[ResultTable]:
    """Return the table of the ablation, if it was run."""
    records = read_records(folder / RECORD, RunRecord)
    return [ablation_table(records)] if records else []


def ablation_table(records: Sequence[RunRecord]) -> ResultTable:
    """Error and R² of every variation on every group, mean over seeds."""
    of_job: dict[tuple, list[RunRecord]] = {}
    for record in records:
        of_job.setdefault((record.job.group, record.job.method, record.job.changes), []).append(record)
    rows = [
        [v.name, *(cell for group in GROUPS for cell in _cells(of_job.get((group, v.method, v.changes), [])))]
        for v in variations()
    ]
    columns = [column for group in GROUPS for column in (f"{group_name(group)}, N", "R² x, y, z")]
    note = "± standard deviation over seeds, where there are several."
    return ResultTable("What decides", ["variation", *columns], rows, note)


def _cells(records: Sequence[RunRecord]) -> tuple[str, str]:
    good = [record for record in records if record.problem is None]
    if not good:
        return ("collapsed" if records else "–"), "–"
    lost = f" ({len(records) - len(good)} of {len(records)} collapsed)" if len(good) < len(records) else ""
    error = spread(np.array([record.mean_mae_n for record in good]))
    return error + lost, ", ".join(numbers(np.mean([record.r2 for record in good], axis=0), ".2f"))


PART = Part(measure, tables)
run = PART.run
