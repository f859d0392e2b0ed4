"""What cheaper data cost an adaptation: draft physics or rendering, independent instead of paired contacts."""

import argparse
import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gelgap.benchmarks.adaptation import ResultTable
from gelgap.benchmarks.adaptation_jobs import Job, run_missing
from gelgap.benchmarks.adaptation_statistics import ranks
from gelgap.benchmarks.tables import write_json

if TYPE_CHECKING:
    from gelgap.domains.recipe import DomainRecipe

SOURCE, TARGET = "mb0i0", "wmb1i1"
METHODS = ("source-only", "adabn", "daregram", "dsan", "supervised")
RESULTS = "cost.json"

VARIANTS = {
    "standard": ("cpu", {}),
    "draft physics": ("cpu", {"quality": "draft"}),
    "draft physics and rendering": ("cpu", {"quality": "draft", "render_quality": "draft"}),
    "inner points, draft physics, paired": ("inner", {"quality": "draft"}),
    "inner points, draft physics, independent": ("inner", {"quality": "draft", "contacts": "independent"}),
}
"""Path and settings of each kind of data. Independent contacts leave the interior of the pad where points lie far out,
and every one would be a solve of its own: hence the inner points."""


@dataclass(frozen=True)
class Cost:
    """One kind of data: its methods' errors (N, mean over seeds) and the time that it took to make, if known."""

    variant: str
    frames: int
    generate_s: float
    solves: int
    errors_n: dict[str, float]
    train_s: float


def recipes(variant: str) -> "tuple[DomainRecipe, ...]":
    """Return both domains of one kind of data."""
    from gelgap.domains.recipe import make_recipes
    from gelgap.sim.path import ContactPath

    name, settings = VARIANTS[variant]
    path = ContactPath.preset("cpu")
    if name == "inner":
        path = replace(path, name=name, points_x_mm=(-2.25, -0.75, 0.75, 2.25), points_y_mm=(-1.3, 0.0, 1.3))
    return make_recipes([SOURCE, TARGET], path, **settings)


def measure(
    variant: str, out_dir: Path, seeds: Sequence[int], workers: int | None, minutes: float = math.inf
) -> Cost:
    """Make one kind of data, run every method on it, and return what came out."""
    from gelgap.domains.generate import generate_recipes

    folder = out_dir / variant.replace(", ", "-").replace(" ", "-")
    start = time.perf_counter()
    report = generate_recipes(recipes(variant), folder / "data", workers=workers)
    generate_s = time.perf_counter() - start if report.frames_written else math.nan
    jobs = [Job(SOURCE, TARGET, method, seed) for seed in seeds for method in METHODS]
    lines = run_missing(folder / "data", folder / "runs", "cpu", jobs, workers=workers, minutes=minutes)
    errors = {
        m: float(np.mean([line.mean_mae_n for line in lines if line.job.method == m] or [math.nan]))
        for m in METHODS
    }
    train_s = sum(line.stage1_s + line.stage2_s for line in lines) / len(seeds)
    return Cost(variant, report.frames, generate_s, report.solves, errors, train_s)


def load_costs(path: Path) -> list[Cost]:
    """Read what `run` wrote."""
    return [Cost(**content) for content in json.loads(path.read_text(encoding="utf-8"))]


def cost_table(costs: Sequence[Cost]) -> ResultTable:
    """Every method's error on every kind of data, and its rank within it."""
    names = [m for m in METHODS if m != "supervised"]
    rows = []
    for cost in costs:
        order = ranks(np.array([[cost.errors_n[m]] for m in names]))[:, 0]
        best = [name for _, name in sorted(zip(order, names, strict=True))]
        errors = [f"{cost.errors_n[m]:.3f}" for m in METHODS]
        rows.append([cost.variant, *errors, " < ".join(best), f"{cost.train_s:.0f}"])
    return ResultTable(
        f"The same adaptation on cheaper data, {SOURCE} → {TARGET}: target MAE, N",
        ["data", *METHODS, "order of the adapted", "training a seed, s"],
        rows,
        f"{costs[0].frames // 2} frames a domain. Fine physics is left out: its eight solves take most of an hour.",
    )


def run(
    out_dir: Path,
    seeds: Sequence[int] = (0,),
    workers: int | None = None,
    minutes: float = math.inf,
    variants: Sequence[str] = tuple(VARIANTS),
) -> None:
    """Measure the variants, write `cost.json`, print the table."""
    start = time.perf_counter()
    costs = []
    for variant in variants:
        left = minutes - (time.perf_counter() - start) / 60
        costs.append(measure(variant, out_dir, seeds, workers, max(left, 0.0)))
    write_json(out_dir / RESULTS, [asdict(cost) for cost in costs])
    cost_table(costs).show()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmark-results/cost"))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--workers", type=int, help="processes; default: one a core")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no run after so many minutes")
    parser.add_argument("--variants", nargs="+", choices=list(VARIANTS), default=list(VARIANTS))
    chosen = parser.parse_args()
    run(chosen.out, chosen.seeds, chosen.workers, chosen.minutes, chosen.variants)
