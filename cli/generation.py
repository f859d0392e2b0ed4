"""What the commands that generate domains share: where the work is done, and its options."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from gelgap import domains
from gelgap.cli import options as opt


def workers(given: str) -> None:
    """Check a number of processes, `synchronous`, or an address with a port."""
    from gelgap.domains.generation.scheduler import check_scheduler

    if re.fullmatch(r"[+-]?\d+", given):
        opt.between(1, 4096)(int(given))
    else:
        check_scheduler(given)


Workers = Annotated[
    str | None,
    opt.optional(
        "N | ADDRESS",
        "one process per core",
        help="Processes on this machine, or the address of a Dask scheduler, such as tcp://host:8786; `synchronous`: "
        "this process.",
    ),
    workers,
]


def processes_and_scheduler(given: str | None) -> tuple[int | None, str | None]:
    """Return what --workers says: a number of processes or a scheduler, the other None."""
    return (int(given), None) if given and given.isdigit() else (None, given)


@dataclass(frozen=True)
class GenerationOptions:
    """Where and how domains are generated."""

    workers: Workers = None
    dry_run: opt.Flag = False
    """Only say what would be done: solves, frames, estimated time and disk."""
    overwrite: opt.Flag = False
    """Replace domains under --out that hold another configuration."""

    def generate(self, recipes: "Sequence[domains.DomainRecipe]", out: Path) -> None:
        """Generate domains, and print the report."""
        processes, scheduler = processes_and_scheduler(self.workers)
        report = domains.generate_recipes(
            recipes, out, scheduler=scheduler, workers=processes, overwrite=self.overwrite
        )
        print(report)

    def estimate(self, recipes: "Sequence[domains.DomainRecipe]") -> None:
        """Print what generating domains would take."""
        print(domains.estimate(recipes, processes_and_scheduler(self.workers)[0]))


LOCALLY = GenerationOptions()
