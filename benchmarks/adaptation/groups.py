"""The headline: all methods on the nine groups, paired and independent contacts, several seeds, split by point."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from gelgap.adapt import NamedFigure, ResultTable
from gelgap.benchmarks.adaptation.compared import MAIN_METHODS, METHODS
from gelgap.benchmarks.adaptation.data_sets import DESIGNS, quick_recipes
from gelgap.benchmarks.adaptation.figures import (
    SHOWN_GROUPS,
    SHOWN_METHODS,
    group_figures,
    prediction_figures,
)
from gelgap.benchmarks.adaptation.headline_tables import group_tables
from gelgap.benchmarks.adaptation.jobs import AT_RANDOM, BY_POINT, RUNS, Bench, Changes, TrainingJob
from gelgap.benchmarks.adaptation.paper import GROUPS
from gelgap.benchmarks.adaptation.parts import Part
from gelgap.benchmarks.adaptation.results import (
    GroupOracles,
    is_benchmark,
    load_results,
    read_oracles,
    write_oracles,
)
from gelgap.benchmarks.adaptation.running import run_missing
from gelgap.benchmarks.adaptation.work import adapt_job

SEEDS = (0, 1, 2, 3, 4)
QUICK_GROUP = ("mb0i0", "wmb1i1")
QUICK_METHODS = ("source-only", "adabn", "classifier-only", "dsan", "supervised")


def measure(bench: Bench) -> None:
    """Do the missing runs; then those of the paper's split, which come last."""
    from gelgap.adapt.methods.registry import use_method

    chosen = None if bench.methods is None else tuple(map(use_method, bench.methods))
    if bench.is_quick:
        measure_quickly(bench, chosen or QUICK_METHODS)
        return
    for data in DESIGNS:
        bench.generate_set(data)
    seeds = bench.seeds or SEEDS
    write_oracles(bench.out, group_oracles(bench.data / "paired", GROUPS))
    jobs = headline_jobs(GROUPS, chosen or METHODS, seeds)
    jobs += jobs_of("paired", GROUPS, chosen or MAIN_METHODS, seeds, AT_RANDOM)
    run_missing(bench, jobs, RUNS, adapt_job)
    if not bench.is_over():
        keep_examples(bench)


def measure_quickly(bench: Bench, methods: Sequence[str]) -> None:
    """Run some methods on one small group, one design and one seed."""
    bench.generate(quick_recipes(QUICK_GROUP))
    write_oracles(bench.out, group_oracles(bench.data / "paired", (QUICK_GROUP,)))
    jobs = jobs_of("paired", (QUICK_GROUP,), methods, bench.seeds or SEEDS[:1], BY_POINT)
    run_missing(bench, jobs, RUNS, adapt_job)


def headline_jobs(
    groups: Sequence[tuple[str, str]],
    methods: Sequence[str],
    seeds: Iterable[int],
    designs: Sequence[str] = DESIGNS,
) -> list[TrainingJob]:
    """Return the headline's runs, one seed after the other, so that those that are done are complete."""
    return [
        job
        for seed in seeds
        for design in designs
        for job in jobs_of(design, groups, methods, (seed,), BY_POINT)
    ]


def jobs_of(
    data: str,
    groups: Sequence[tuple[str, str]],
    methods: Sequence[str],
    seeds: Iterable[int],
    changes: Changes,
) -> list[TrainingJob]:
    """Return the runs of some methods on a data set, one seed after the other."""
    return [
        TrainingJob(source, target, method, seed, data, changes)
        for seed in seeds
        for source, target in groups
        for method in methods
    ]


def keep_examples(bench: Bench) -> None:
    """Keep whole runs, predictions and features included, of the groups that are drawn."""
    from gelgap.adapt import adapt_folders

    for source, target in SHOWN_GROUPS:
        for method in SHOWN_METHODS:
            profile = TrainingJob(source, target, method, 0, changes=BY_POINT).profile(bench.profile)
            folders = (bench.data / "paired" / name for name in (source, target))
            adapt_folders(*folders, [method], profile, 0, out_dir=bench.out)


def group_oracles(data: Path, groups: Iterable[tuple[str, str]]) -> dict[tuple[str, str], GroupOracles]:
    """Return both oracles of every group."""
    from gelgap.adapt import Presses, geometry_oracle, pose_oracle
    from gelgap.domains import open_domain

    domains = {name: open_domain(data / name) for name in {n for group in groups for n in group}}
    found = {}
    for group in groups:
        pair = [domains[name] for name in group]
        presses = map(Presses.of, pair)
        found[group] = GroupOracles(pose_oracle(*pair).mae_n, geometry_oracle(*presses).mae_n)
    return found


def tables(folder: Path) -> list[ResultTable]:
    """Return the tables of both designs."""
    return group_tables(folder) if is_benchmark(folder) else []


def figures(folder: Path) -> list[NamedFigure]:
    """Return the figures of the groups."""
    return [*group_figures(load_results(folder), read_oracles(folder)), *prediction_figures(folder)]


PART = Part(measure, tables, figures)
run = PART.run
