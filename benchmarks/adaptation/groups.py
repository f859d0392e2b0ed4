"""The paper's nine groups with its methods and their controls, several seeds, beside baselines without learning."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from gelgap.adapt import NamedFigure, ResultTable
from gelgap.benchmarks.adaptation.figures import group_figures, prediction_figures
from gelgap.benchmarks.adaptation.jobs import Bench, TrainingJob, run_missing
from gelgap.benchmarks.adaptation.paper import GROUPS, TABLE_METHODS
from gelgap.benchmarks.adaptation.parts import Part
from gelgap.benchmarks.adaptation.results import GroupOracles, is_benchmark, load_results, write_oracles
from gelgap.benchmarks.adaptation.tables import group_tables

SEEDS = (0, 1, 2)


def measure(bench: Bench) -> None:
    """Do the missing runs; with the smoke profile, of one group and one seed."""
    bench.generate_preset()
    quick = bench.profile == "smoke"
    groups, seeds = (GROUPS[6:7], SEEDS[:1]) if quick else (GROUPS, SEEDS)
    write_oracles(bench.out, group_oracles(bench.data, groups))
    run_missing(bench, jobs_of(groups, TABLE_METHODS, bench.seeds or seeds))


def tables(folder: Path) -> list[ResultTable]:
    """Return the tables of the paper's methods."""
    return group_tables(load_results(folder)) if is_benchmark(folder) else []


def figures(folder: Path) -> list[NamedFigure]:
    """Return the figures of the paper's methods."""
    return [*group_figures(load_results(folder)), *prediction_figures(folder)]


PART = Part(measure, tables, figures)
run = PART.run


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


def jobs_of(
    groups: Sequence[tuple[str, str]], methods: Sequence[str], seeds: Sequence[int]
) -> list[TrainingJob]:
    """Return the runs of a table, one seed after the other."""
    return [TrainingJob(s, t, method, seed) for seed in seeds for s, t in groups for method in methods]
