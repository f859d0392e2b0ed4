"""All methods on three groups: those of the paper's table and nine further ones."""

from pathlib import Path

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.groups import group_oracles, jobs_of
from gelgap.benchmarks.adaptation.jobs import Bench, run_missing
from gelgap.benchmarks.adaptation.paper import GROUPS, TABLE_METHODS
from gelgap.benchmarks.adaptation.parts import Part
from gelgap.benchmarks.adaptation.results import is_benchmark, load_further, write_oracles
from gelgap.benchmarks.adaptation.tables import further_table

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


def measure(bench: Bench) -> None:
    """Do the missing runs, by default of one seed."""
    bench.generate_preset()
    write_oracles(bench.out, group_oracles(bench.data, GROUPS))
    run_missing(bench, jobs_of(FURTHER_GROUPS, (*TABLE_METHODS, *FURTHER_METHODS), bench.seeds or (0,)))


def tables(folder: Path) -> list[ResultTable]:
    """Return the table of all methods, if any beside the paper's was run."""
    results = load_further(folder) if is_benchmark(folder) else None
    return [further_table(results)] if results and results.records else []


PART = Part(measure, tables)
run = PART.run
