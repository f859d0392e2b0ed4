"""What cheaper data cost an adaptation: draft physics or rendering, independent instead of paired contacts."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.jobs import Bench, TrainingJob, run_missing
from gelgap.benchmarks.adaptation.parts import Part
from gelgap.benchmarks.adaptation.tables import by_column, number, spread
from gelgap.benchmarks.common.records import read_results, write_results

if TYPE_CHECKING:
    from gelgap.domains import DomainRecipe

SOURCE, TARGET = "mb0i0", "wmb1i1"
METHODS = ("source-only", "adabn", "no-transfer", "daregram", "dsan", "supervised")
RESULTS = "cost/cost.json"
SEEDS = (0, 1, 2)
PATH = PROFILE = "smoke"

VARIANTS = {
    "standard": {},
    "draft physics": {"quality": "draft"},
    "draft physics and rendering": {"quality": "draft", "render_quality": "draft"},
    "draft physics, independent contacts": {"quality": "draft", "contacts": "independent"},
}
"""How each kind of data differs from the standard one, whose contacts are paired."""


@dataclass(frozen=True)
class Cost:
    """One kind of data: its methods' errors (N, one per seed), and the time it took to make (NaN if it was there)."""

    variant: str
    frames: int
    generate_s: float
    solves: int
    errors_n: dict[str, list[float]]
    train_s: float


def recipes(variant: str) -> "tuple[DomainRecipe, ...]":
    """Return both domains of one kind of data."""
    from gelgap.domains import make_recipes

    return make_recipes([SOURCE, TARGET], PATH, **VARIANTS[variant])


def measure(bench: Bench) -> None:
    """Make every kind of data and run every method on it; what was measured is written after each kind."""
    costs = []
    for variant in VARIANTS:
        folder = variant.replace(", ", "-").replace(" ", "-")
        costs.append(measure_variant(bench.within(f"cost/{folder}", PROFILE), variant))
        write_results(bench.out / RESULTS, costs)


def measure_variant(bench: Bench, variant: str) -> Cost:
    """Make one kind of data, run every method on it, and return what came out."""
    start = time.perf_counter()
    report = bench.generate(recipes(variant))
    generate_s = time.perf_counter() - start if report.frames_written else math.nan
    seeds = bench.seeds or SEEDS
    records = run_missing(bench, [TrainingJob(SOURCE, TARGET, m, seed) for seed in seeds for m in METHODS])
    errors = {m: [record.mean_mae_n for record in records if record.job.method == m] for m in METHODS}
    train_s = sum(record.stage1_s + record.stage2_s for record in records) / len(seeds)
    return Cost(variant, report.frames, generate_s, report.solves, errors, train_s)


def tables(folder: Path) -> list[ResultTable]:
    """Return the table of costs, if they were measured."""
    path = folder / RESULTS
    return [cost_table(read_results(path, list[Cost]))] if path.is_file() else []


def cost_table(costs: Sequence[Cost]) -> ResultTable:
    """Every method's error on every kind of data, and its rank within it."""
    errors = {method: [spread(np.array(cost.errors_n[method])) for cost in costs] for method in METHODS}
    return by_column(
        f"The same adaptation on cheaper data, {SOURCE} → {TARGET}, profile {PROFILE}: target MAE, N",
        "data",
        [cost.variant for cost in costs],
        {
            **errors,
            "order": list(map(_order, costs)),
            "made in, s": [number(cost.generate_s, ".0f") for cost in costs],
            "training a seed, s": [number(cost.train_s, ".0f") for cost in costs],
        },
        f"{costs[0].frames // 2} frames per domain; ± standard deviation over seeds. Physics found in the cache "
        "makes the time of the data short. Fine physics is left out for its time.",
    )


def _order(cost: Cost) -> str:
    mean = {m: np.mean(errors) if errors else math.nan for m, errors in cost.errors_n.items()}
    return " < ".join(sorted((m for m in METHODS if m != "supervised"), key=mean.__getitem__))


PART = Part(measure, tables)
run = PART.run
