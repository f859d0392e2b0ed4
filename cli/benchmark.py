"""`gelgap benchmark`: run time against error, and numerical stress."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gelgap.benchmarks.registry import BENCHMARKS, find_benchmarks, parts_of, subjects
from gelgap.cli.arguments import Flag, optional
from gelgap.cli.rules import OutputFolder

_PARTS = tuple(dict.fromkeys(benchmark.part for benchmark in BENCHMARKS if benchmark.part))


def _help_on_subjects() -> str:
    alone = [f"{b.subject} ({b.description})" for b in BENCHMARKS if b.part is None]
    return f"What to measure: {', '.join(alone)}, or a subject with parts."


def _help_on_parts() -> str:
    sentences = []
    for subject in subjects():
        if parts := parts_of(subject):
            default = (
                "all" if all(p.by_default for p in parts) else next(p.part for p in parts if p.by_default)
            )
            names = ", ".join(f"{p.part} ({p.description})" for p in parts)
            sentences.append(f"Of {subject} (default: {default}): {names}.")
    return f"One part. {' '.join(sentences)}"


@dataclass(frozen=True)
class Benchmark:
    """Measure run time and error in one table, with a baseline in the same run; results also as JSON and plots.

    Example: gelgap benchmark physics --quick
    """

    subject: Annotated[tyro.conf.Positional[Literal[*subjects()]], tyro.conf.arg(help=_help_on_subjects())]
    what: Annotated[Literal[*_PARTS] | None, optional("PART", help=_help_on_parts())] = None
    quick: Flag = False
    """A short form: the smallest case or two of each table; seconds to minutes."""
    out: Annotated[Path, OutputFolder()] = Path("benchmark-results")
    """Folder for JSON results and plots."""

    def run(self, started: float) -> None:
        """Run the chosen benchmarks, one after the other."""
        for benchmark in find_benchmarks(self.subject, self.what, self.quick):
            benchmark.run(self.quick, self.out)
