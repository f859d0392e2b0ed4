"""`gelgap benchmark`: run time against error, and numerical stress."""

import logging
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Literal, NamedTuple

import tyro

from gelgap.cli import options as opt

LOG = logging.getLogger(__name__)


class Subject(NamedTuple):
    """What a benchmark measures, and where: `place` is a function of `gelgap.benchmarks`, imported when it runs.

    It has `quick` and `out_dir`, and, if it `needs_data`, also `data`, the folder of the user's clones: it measures,
    prints tables and writes what it found below `out_dir`.
    """

    description: str
    place: str
    needs_data: bool = False


SUBJECTS = {
    "physics": Subject("error of forces and displacements against run time", "physics.accuracy:run"),
    "physics-shapes": Subject(
        "other indenters than spheres against finite elements", "physics.accuracy:run_shapes"
    ),
    "stability": Subject("solves at the corners of what is allowed", "physics.stability:run"),
    "render": Subject("error of pictures against run time, beside a path tracer", "render.accuracy:run"),
    "sensors": Subject("how well presses of real sensors are predicted from others", "sensor_sets:run", True),
    "throughput": Subject("time to generate and to read domains", "throughput:run"),
    "adaptation": Subject("all methods of adaptation on all groups", "adaptation.groups:run"),
}
"""Adding a benchmark is a file and an entry here."""
LISTED = "; ".join(f"{name}: {subject.description}" for name, subject in SUBJECTS.items())


@dataclass(frozen=True)
class Benchmark(opt.Command):
    """Measure run time and error in one table, with a baseline in the same run; results also as JSON and plots.

    Example: gelgap benchmark physics --quick
    """

    when_stopped = "what keeps records goes on from them, all else is measured anew; run the command again"
    fills_cache = True

    subject: Annotated[
        # A checker of types does not know the names of a table.
        tyro.conf.Positional[Literal[*SUBJECTS]],  # type: ignore[valid-type]
        tyro.conf.arg(help=f"The subject to measure. {LISTED}."),
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

        chosen = SUBJECTS[self.subject]
        if chosen.needs_data and self.data is None:
            raise ValueError("--data is missing; name the folder with clones of real data")
        if self.data is not None and not chosen.needs_data:
            raise ValueError("--data is for benchmarks of real data alone; leave it out")
        with sole_use(self.out, f".lock-{self.subject}"):
            LOG.info("measuring %s", chosen.description)
            measure = resolve_name(f"gelgap.benchmarks.{chosen.place}")
            measure(self.quick, self.out, *([self.data] if chosen.needs_data else []))
