"""What decides in DSAN: classes, weight, warm-up, statistics or feedback; and what mixed colours change."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.jobs import Changes, Job, Line, run_missing, study_parser
from gelgap.benchmarks.adaptation.tables import spread

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


def ablation_jobs(groups: Sequence[tuple[str, str]], seeds: Sequence[int]) -> list[Job]:
    """Return all runs."""
    return [Job(s, t, v.method, seed, v.changes) for seed in seeds for v in variations() for s, t in groups]


def ablation_table(lines: Sequence[Line], groups: Sequence[tuple[str, str]]) -> ResultTable:
    """Error and R² of every variation on every group, mean over seeds."""
    header = ["variation"]
    for group in groups:
        header += [" → ".join(group) + ", N", "R² x, y, z"]
    rows = []
    for variation in variations():
        row = [variation.name]
        for source, target in groups:
            own = [
                line
                for line in lines
                if (line.job.source, line.job.target) == (source, target)
                and (line.job.method, line.job.changes) == (variation.method, variation.changes)
            ]
            row += _cells(own)
        rows.append(row)
    return ResultTable(
        "What decides", header, rows, "± standard deviation over seeds, where there are several."
    )


def _cells(own: Sequence[Line]) -> list[str]:
    good = [line for line in own if line.problem is None]
    if not own:
        return ["–", "–"]
    if not good:
        return ["collapsed", "–"]
    r2 = np.mean([line.r2 for line in good], axis=0)
    lost = f" ({len(own) - len(good)} of {len(own)} collapsed)" if len(good) < len(own) else ""
    error = spread(np.array([line.mean_mae_n for line in good]))
    return [error + lost, ", ".join(f"{x:.2f}" for x in r2)]


def run(
    data: Path, out: Path, seeds: Sequence[int] = (0,), workers: int | None = None, minutes: float = math.inf
) -> list[Line]:
    """Do the missing runs and print the table."""
    lines = run_missing(
        data, out, out.name, ablation_jobs(GROUPS, seeds), record=RECORD, workers=workers, minutes=minutes
    )
    ablation_table(lines, GROUPS).show()
    return lines


if __name__ == "__main__":
    parser = study_parser(__doc__, seeds=(0,))
    parser.add_argument("--data", type=Path, required=True, help="folder of the cpu data set")
    parser.add_argument("--out", type=Path, default=Path("benchmark-results/adaptation/cpu"))
    chosen = parser.parse_args()
    run(chosen.data, chosen.out, chosen.seeds, chosen.workers, chosen.minutes)
