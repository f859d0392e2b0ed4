"""One part of the adaptation benchmark: how it is measured, printed and shown in the report of all parts."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gelgap.adapt import NamedFigure, ResultTable, write_pages
from gelgap.benchmarks.adaptation.jobs import RUNS, Bench
from gelgap.benchmarks.adaptation.results import ORACLES, is_benchmark
from gelgap.benchmarks.adaptation.statistics import check_installed
from gelgap.benchmarks.registry import parts_of


@dataclass(frozen=True)
class Part:
    """One part: `measure` does what is missing; `tables` and `figures` show the records of a benchmark's folder."""

    measure: Callable[[Bench], None]
    tables: Callable[[Path], list[ResultTable]]
    figures: Callable[[Path], list[NamedFigure]] = lambda folder: []

    def run(self, quick: bool, out_dir: Path) -> None:
        """Measure with the cpu profile, or quickly with the smoke profile; print the tables, write the report."""
        folder = out_dir / "adaptation" / ("smoke" if quick else "cpu")
        self.carry_out(Bench.at(folder, workers=1 if quick else None))

    def carry_out(self, bench: Bench) -> None:
        """Measure, print the tables and write the report of all parts."""
        check_installed()
        self.measure(bench)
        for table in self.tables(bench.out):
            table.show()
        if is_benchmark(bench.out):
            print(f"wrote {write_benchmark_report(bench.out)}")


def write_benchmark_report(folder: Path, out_dir: Path | None = None) -> Path:
    """Write adaptation.md, .tex, .html and the figures of all parts that were run; return the HTML's path.

    Raises
    ------
    FileNotFoundError
        If the folder holds no records of the benchmark.
    ModuleNotFoundError
        If scikit-posthocs is not installed.
    """
    if not is_benchmark(folder):
        raise FileNotFoundError(
            f"{folder} holds no records of the adaptation benchmark ({RUNS} and {ORACLES}); "
            "`gelgap benchmark adaptation` writes them"
        )
    check_installed()
    parts = [entry.load().PART for entry in parts_of("adaptation")]
    tables = [table for part in parts for table in part.tables(folder)]
    figures = [figure for part in parts for figure in part.figures(folder)]
    title = f"Adaptation benchmark, profile {folder.name}"
    return write_pages(out_dir or folder, "adaptation", title, tables, figures)
