"""`gelgap report`: tables and figures of adaptation runs."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gelgap.cli.arguments import optional
from gelgap.cli.rules import FinishedRuns, OutputFolder


@dataclass(frozen=True)
class Report:
    """Write tables and figures of the runs that `gelgap adapt` and `gelgap benchmark adaptation` left in a folder.

    A folder with the benchmark's records gets the benchmark's report: the groups beside the paper, oracles, tests,
    selectors, gap curves.

    For example:
      gelgap report runs
    """

    runs: Annotated[tyro.conf.Positional[Path], FinishedRuns()]
    """Folder with finished runs, at any depth."""
    out: Annotated[Path | None, optional("PATH", "the folder of the runs"), OutputFolder()] = None
    """Folder for the report."""

    def run(self, started: float) -> None:
        """Write the report and say where it is."""
        from gelgap.adapt import write_report
        from gelgap.benchmarks.adaptation.parts import write_benchmark_report
        from gelgap.benchmarks.adaptation.results import is_benchmark

        write = write_benchmark_report if is_benchmark(self.runs) else write_report
        print(f"wrote {write(self.runs, self.out)}")
