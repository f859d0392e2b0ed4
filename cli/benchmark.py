"""`gelgap benchmark`: run time against error, and numerical stress."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gelgap.benchmarks.registry import BENCHMARKS
from gelgap.cli import options as opt

LOG = logging.getLogger(__name__)
LISTED = "; ".join(f"{name}: {benchmark.description}" for name, benchmark in BENCHMARKS.items())


@dataclass(frozen=True)
class Benchmark(opt.Command):
    """Measure run time and error in one table, with a baseline in the same run; results also as JSON and plots.

    Example: gelgap benchmark physics --quick
    """

    when_stopped = (
        "what keeps records goes on from them, the rest is measured anew; run the same command again"
    )
    fills_cache = True

    subject: Annotated[
        tyro.conf.Positional[Literal[*BENCHMARKS]], tyro.conf.arg(help=f"The subject to measure. {LISTED}.")
    ]
    quick: opt.Flag = False
    """A short form: one or two small cases of each table; a minute or two, for adaptation more."""
    data: Annotated[
        Path | None, opt.optional("PATH"), opt.input_folder("a folder with clones of real data")
    ] = None
    """For sensors: the folder with clones of published data sets, or presses of your own sensors."""
    out: Annotated[Path, opt.output_folder] = Path("benchmark-results")
    """Folder for JSON results and plots."""

    def run(self, started: float) -> None:
        """Run the chosen benchmark."""
        from gelgap.assets.locks import sole_use

        chosen = BENCHMARKS[self.subject]
        chosen.check(self.quick, self.data)
        with sole_use(self.out, f".lock-{self.subject}"):
            LOG.info("measuring %s", chosen.description)
            chosen.run(self.quick, self.out, self.data)
