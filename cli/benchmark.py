"""`gelgap benchmark`: run time against error, and numerical stress."""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import tyro

PARTS = {
    "stability": ("physics", "render", "losses"),
    "adaptation": ("speed", "groups", "methods", "search", "ablation", "gaps", "cost"),
}
"""The parts of the subjects that have any."""

MODULES = {
    ("physics", None): "physics.accuracy",
    ("render", None): "render.accuracy",
    ("throughput", None): "data.throughput",
    ("faults", None): "data.faults",
    ("stability", "physics"): "physics.stability",
    ("stability", "render"): "render.stability",
    ("stability", "losses"): "adaptation.losses",
}
"""Where each subject, or part of it, is measured."""


@dataclass(frozen=True)
class Benchmark:
    """Measure run time and error in one table, with a baseline in the same run; results also as JSON and plots.

    Example: gelgap benchmark physics --quick
    """

    subject: tyro.conf.Positional[
        Literal["physics", "render", "stability", "throughput", "faults", "adaptation"]
    ]
    """What to measure."""
    what: Literal[*PARTS["stability"], *PARTS["adaptation"]] | None = None
    """One part: the room that `stability` stresses (default: physics), or of `adaptation` speed, groups, methods,
    search, ablation, gaps or cost (default: all)."""
    quick: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """A form that takes under two minutes."""
    out: Path = Path("benchmark-results")
    """Folder for JSON results and plots."""

    def run(self, started: float) -> None:
        """Run the benchmark's module."""
        known = PARTS.get(self.subject, ())
        if self.what not in (None, *known):
            has = f"its parts are {', '.join(known)}" if known else "it has no parts"
            raise ValueError(f"--what {self.what} is no part of benchmark {self.subject}; {has}")
        if self.subject == "adaptation":
            from gelgap.benchmarks.adaptation.groups import run

            run(self.quick, self.out, (self.what,) if self.what else known)
            return
        module = MODULES[self.subject, self.what or known[0] if known else None]
        import_module(f"gelgap.benchmarks.{module}").run(quick=self.quick, out_dir=self.out)
