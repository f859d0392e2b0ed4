"""`gelgap report`: tables and figures of adaptation runs."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from gelgap.cli.arguments import optional
from gelgap.cli.rules import FinishedRuns, OutputFolder

LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Report:
    """Write tables and figures of the runs that `gelgap adapt` and `gelgap benchmark adaptation` left in a folder.

    A folder with the benchmark's records gets the benchmark's report: the groups beside the paper, oracles, tests,
    selectors, gap curves.

    For example:
      gelgap report runs
    """

    when_stopped: ClassVar[str] = (
        "files of an older report may stand beside new ones; run the same command again to write all of them"
    )

    runs: Annotated[tyro.conf.Positional[Path], FinishedRuns()]
    """Folder with finished runs, at any depth."""
    out: Annotated[Path | None, optional("PATH", "the folder of the runs"), OutputFolder()] = None
    """Folder for the report."""

    def run(self, started: float) -> None:
        """Write the report and say where it is."""
        from gelgap.adapt import write_report
        from gelgap.assets.locks import sole_use
        from gelgap.benchmarks.adaptation.study import is_benchmark, write_benchmark_report

        if not self.runs.is_dir():
            raise FileNotFoundError(
                f"{self.runs} does not exist; name a folder that `gelgap adapt --out` wrote"
            )
        write = write_benchmark_report if is_benchmark(self.runs) else write_report
        LOG.info("drawing the report of %s", self.runs)
        with sole_use(self.out or self.runs):
            print(f"wrote {write(self.runs, self.out)}")
