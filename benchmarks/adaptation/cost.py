"""What cheaper data cost an adaptation: draft physics or rendering, independent instead of paired contacts."""

import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.jobs import Job, run_missing, study_parser
from gelgap.benchmarks.adaptation.tables import spread
from gelgap.benchmarks.common.tables import write_json

if TYPE_CHECKING:
    from gelgap.domains import DomainRecipe

SOURCE, TARGET = "mb0i0", "wmb1i1"
METHODS = ("source-only", "adabn", "no-transfer", "daregram", "dsan", "supervised")
RESULTS = "cost.json"

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
    """One kind of data: its methods' errors (N, one a seed), and the time it took to make (NaN if it was there)."""

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


def measure(
    variant: str, out_dir: Path, seeds: Sequence[int], workers: int | None, minutes: float = math.inf
) -> Cost:
    """Make one kind of data, run every method on it, and return what came out."""
    from gelgap.domains import generate_recipes

    folder = out_dir / variant.replace(", ", "-").replace(" ", "-")
    start = time.perf_counter()
    scheduler = "synchronous" if workers == 1 else None
    report = generate_recipes(recipes(variant), folder / "data", scheduler=scheduler, workers=workers)
    generate_s = time.perf_counter() - start if report.frames_written else math.nan
    jobs = [Job(SOURCE, TARGET, method, seed) for seed in seeds for method in METHODS]
    lines = run_missing(folder / "data", folder / "runs", PROFILE, jobs, workers=workers, minutes=minutes)
    errors = {m: [line.mean_mae_n for line in lines if line.job.method == m] for m in METHODS}
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
        mean = {m: float(np.mean(errors)) if errors else math.nan for m, errors in cost.errors_n.items()}
        order = " < ".join(sorted(names, key=mean.__getitem__))
        made = "–" if math.isnan(cost.generate_s) else f"{cost.generate_s:.0f}"
        rows.append(
            [
                cost.variant,
                *(spread(np.array(cost.errors_n[m])) for m in METHODS),
                order,
                made,
                f"{cost.train_s:.0f}",
            ]
        )
    return ResultTable(
        f"The same adaptation on cheaper data, {SOURCE} → {TARGET}, profile {PROFILE}: target MAE, N",
        ["data", *METHODS, "order", "made in, s", "training a seed, s"],
        rows,
        f"{costs[0].frames // 2} frames a domain; ± standard deviation over seeds. Physics found in the cache "
        "makes the time of the data short. Fine physics is left out for its time.",
    )


def run(
    out_dir: Path,
    seeds: Sequence[int] = (0, 1, 2),
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
    parser = study_parser(__doc__, seeds=(0, 1, 2))
    parser.add_argument("--out", type=Path, default=Path("benchmark-results/cost"))
    parser.add_argument("--variants", nargs="+", choices=list(VARIANTS), default=list(VARIANTS))
    chosen = parser.parse_args()
    run(chosen.out, chosen.seeds, chosen.workers, chosen.minutes, chosen.variants)
