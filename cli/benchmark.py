"""`gelgap benchmark`: run time against error, and numerical stress."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gelgap.benchmarks.registry import BENCHMARKS, find_benchmarks, parts_of, subjects
from gelgap.cli import options as opt

LOG = logging.getLogger(__name__)
ALONE = ", ".join(f"{b.subject} ({b.description})" for b in BENCHMARKS if b.part is None)


def _help_on_parts() -> str:
    sentences = []
    for subject in subjects():
        if parts := parts_of(subject):
            usual = [p.part for p in parts if p.by_default]
            default = "all" if len(usual) == len(parts) else usual[0]
            names = ", ".join(f"{p.part} ({p.description})" for p in parts)
            sentences.append(f"Of {subject} (default: {default}): {names}.")
    return f"One part. {' '.join(sentences)}"


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
        tyro.conf.Positional[Literal[*subjects()]],
        tyro.conf.arg(help=f"What to measure: {ALONE}, or a subject with parts."),
    ]
    what: Annotated[str | None, opt.optional("PART", help=_help_on_parts())] = None
    quick: opt.Flag = False
    """A short form: one or two small cases of each table; a minute or two, for adaptation more."""
    data: Annotated[
        Path | None, opt.optional("PATH"), opt.input_folder("a folder with clones of real data")
    ] = None
    """For real, and for sensors: the folder with clones of published data sets, or presses of your own sensors."""
    out: Annotated[Path, opt.output_folder] = Path("benchmark-results")
    """Folder for JSON results and plots."""

    def run(self, started: float) -> None:
        """Run the chosen benchmarks, one after the other."""
        from gelgap.assets.locks import sole_use

        chosen = find_benchmarks(self.subject, self.what, self.quick, self.data is not None)
        if any(benchmark.needs_data for benchmark in chosen) != (self.data is not None):
            what = (
                "is missing; name the folder with clones of real data"
                if self.data is None
                else "is for benchmarks of real data alone; leave it out"
            )
            raise ValueError(f"--data {what} (benchmark {self.subject})")
        with sole_use(self.out, f".lock-{self.subject}"):
            for benchmark in chosen:
                LOG.info("measuring %s", benchmark.description)
                benchmark.run(self.quick, self.out, self.data)
