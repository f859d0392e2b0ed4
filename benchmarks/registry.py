"""The benchmarks: name, what each measures, and where. Adding one is a file and an entry here; none knows this list.

A place is a function of a module, with `quick` and `out_dir`: it measures, prints tables and writes what it found below
`out_dir`. One that `needs_data` also takes `data`, the folder of the user's clones.
"""

from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name


@dataclass(frozen=True)
class Benchmark:
    """One benchmark; `place` is `module:function` below this package, imported when it runs."""

    description: str
    place: str
    has_quick_form: bool = True
    needs_data: bool = False

    def check(self, quick: bool, data: Path | None) -> None:
        """Refuse what it does not take.

        Raises
        ------
        ValueError
            If it has no quick form, or the folder of data is missing or not needed.
        """
        if quick and not self.has_quick_form:
            raise ValueError("--quick: this benchmark has no quick form; leave it out")
        if self.needs_data and data is None:
            raise ValueError("--data is missing; name the folder with clones of real data")
        if data is not None and not self.needs_data:
            raise ValueError("--data is for benchmarks of real data alone; leave it out")

    def run(self, quick: bool, out_dir: Path, data: Path | None) -> None:
        """Measure."""
        function = resolve_name(f"gelgap.benchmarks.{self.place}")
        if self.needs_data:
            function(quick, out_dir, data)
        else:
            function(quick, out_dir)


BENCHMARKS = {
    "physics": Benchmark("error of forces and displacements against run time", "physics.accuracy:run"),
    "physics-shapes": Benchmark(
        "other indenters than spheres against finite elements", "physics.accuracy:run_shapes"
    ),
    "stability": Benchmark("solves at the corners of what is allowed", "physics.stability:run"),
    "render": Benchmark("error of pictures against run time, beside a path tracer", "render.accuracy:run"),
    "sensors": Benchmark(
        "how well presses of real sensors are predicted from others", "sensor_sets:run", needs_data=True
    ),
    "throughput": Benchmark("time to generate and to read domains", "throughput:run"),
    "adaptation": Benchmark("all methods of adaptation on all groups", "adaptation.report:run_groups"),
    "adaptation-inputs": Benchmark(
        "what each input is worth, with five methods", "adaptation.report:run_inputs", has_quick_form=False
    ),
    "adaptation-lights": Benchmark(
        "training in random lights instead of adapting", "adaptation.report:run_lights", has_quick_form=False
    ),
}
