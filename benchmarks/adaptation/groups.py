"""The adaptation benchmark: the paper's nine groups, every method, several seeds; resumable, one run a core."""

import math
from collections.abc import Sequence
from pathlib import Path

from gelgap.benchmarks.adaptation.jobs import Job, run_missing, study_parser
from gelgap.benchmarks.adaptation.results import (
    RUNS,
    is_benchmark,
    load_further,
    load_results,
    write_benchmark_report,
    write_oracles,
)
from gelgap.benchmarks.adaptation.tables import (
    GROUPS,
    TABLE_METHODS,
    GroupOracles,
    further_table,
    result_tables,
)

SEEDS = (0, 1, 2)
FURTHER_METHODS = (
    "coral",
    "dan",
    "jan",
    "rsd",
    "daregram-tikhonov",
    "dsan-coarse",
    "dsan-soft",
    "cod",
    "ssa",
)
FURTHER_GROUPS = (("mb0i0", "wmb0i0"), ("wmb0i0", "wmb1i1"), ("wmb1i1", "mb0i0"))
"""Markers alone differ; gel and light do; all three do."""

QUICK_PARTS = ("speed", "groups")


def run(quick: bool, out_dir: Path, parts: Sequence[str]) -> None:
    """Do what is missing of some parts, print their tables and write the report.

    `quick` is one group of the smoke data with one seed, of the parts that have such a form. Data that are missing are
    generated.

    Raises
    ------
    ValueError
        If no part has a quick form.
    """
    chosen = [part for part in parts if part in QUICK_PARTS or not quick]
    if not chosen:
        raise ValueError(f"--quick: {', '.join(parts)} has no quick form; {', '.join(QUICK_PARTS)} have")
    out = out_dir / "adaptation" / ("smoke" if quick else "cpu")
    for part in chosen:
        _run_part(part, out)
    if is_benchmark(out):
        print(f"wrote {write_benchmark_report(out)}")


def _run_part(name: str, out: Path) -> None:
    """Run one part with the profile that `out` is named after."""
    from gelgap.benchmarks.adaptation import (
        ablation,
        cost,
        gaps,
        search,
        speed,
    )

    match name:
        case "speed":
            speed.run(out)
        case "groups" if out.name == "smoke":
            run_groups(_data(out), out, GROUPS[6:7], SEEDS[:1])
        case "groups":
            run_groups(_data(out), out)
        case "methods":
            run_further(_data(out), out)
        case "search":
            search.run(_data(out), out)
        case "ablation":
            ablation.run(_data(out), out)
        case "gaps":
            gaps.run(out / "gaps")
        case "cost":
            cost.run(out / "cost")


def _data(out: Path) -> Path:
    """Return the folder of the profile's data, generated if they are missing."""
    from gelgap.domains import generate_recipes, preset_recipes

    data = out.parent / f"data-{out.name}"
    print(generate_recipes(preset_recipes(out.name, quality="standard", seed=0), data))
    return data


def group_oracles(data: Path, groups: Sequence[tuple[str, str]]) -> dict[tuple[str, str], GroupOracles]:
    """Return both oracles of every group."""
    from gelgap.adapt import Presses, geometry_oracle, pose_oracle
    from gelgap.domains import open_domain

    domains = {name: open_domain(data / name) for name in dict.fromkeys(n for group in groups for n in group)}
    presses = {name: Presses.of(domain) for name, domain in domains.items()}
    return {
        (s, t): GroupOracles(
            pose_oracle(domains[s], domains[t]).mae_n, geometry_oracle(presses[s], presses[t]).mae_n
        )
        for s, t in groups
    }


def jobs_of(groups: Sequence[tuple[str, str]], methods: Sequence[str], seeds: Sequence[int]) -> list[Job]:
    """Return the runs of the table, one seed after the other."""
    return [Job(s, t, m, seed) for seed in seeds for s, t in groups for m in methods]


def run_groups(
    data: Path,
    out: Path,
    groups: Sequence[tuple[str, str]] = GROUPS,
    seeds: Sequence[int] = SEEDS,
    workers: int | None = None,
    minutes: float = math.inf,
) -> None:
    """Do the missing runs of the paper's methods, with the profile that `out` is named after; print all tables."""
    write_oracles(out, group_oracles(data, groups))
    run_missing(data, out, out.name, jobs_of(groups, TABLE_METHODS, seeds), workers=workers, minutes=minutes)
    if (out / RUNS).is_file():
        for table in result_tables(load_results(out)):
            table.show()


def run_further(
    data: Path,
    out: Path,
    seeds: Sequence[int] = SEEDS[:1],
    workers: int | None = None,
    minutes: float = math.inf,
) -> None:
    """Do the missing runs of all methods on three groups; print their table."""
    jobs = jobs_of(FURTHER_GROUPS, (*TABLE_METHODS, *FURTHER_METHODS), seeds)
    write_oracles(out, group_oracles(data, GROUPS))
    run_missing(data, out, out.name, jobs, workers=workers, minutes=minutes)
    further_table(load_further(out)).show()


if __name__ == "__main__":
    parser = study_parser("The nine groups in pieces: what is missing, for so many minutes.", SEEDS)
    parser.add_argument("--data", type=Path, required=True, help="folder of the four domains")
    parser.add_argument(
        "--out", type=Path, required=True, help="records; named after the profile, such as …/cpu"
    )
    chosen = parser.parse_args()
    run_groups(chosen.data, chosen.out, seeds=chosen.seeds, workers=chosen.workers, minutes=chosen.minutes)
