"""The benchmarks: name, what each measures, and where. Adding one is a file and a line here.

A place is a module, or `module:NAME` of a thing in it, with `run(quick: bool, out_dir: Path) -> None`, or is such a
function itself. It measures, prints tables and writes what it found below `out_dir`; one that `needs_data` also takes
`data`, the folder of the user's clones. The parts of the adaptation benchmark are each a `Part`, which its report is
made of.
"""

from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from gelgap.assets.names import quoted


@dataclass(frozen=True)
class Benchmark:
    """One benchmark: a subject, or one part of a subject that has several.

    Without a choice of parts, those `by_default` are measured; `--quick` leaves out parts without a quick form.
    """

    subject: str
    part: str | None
    description: str
    place: str
    by_default: bool = True
    has_quick_form: bool = True
    needs_data: bool = False

    def load(self) -> Any:
        """Import the benchmark's module, or the thing in it."""
        return resolve_name(f"gelgap.benchmarks.{self.place}")

    def run(self, quick: bool, out_dir: Path, data: Path | None = None) -> None:
        """Measure."""
        given = {"data": data} if self.needs_data else {}
        place = self.load()
        getattr(place, "run", place)(quick=quick, out_dir=out_dir, **given)


EXTRA, LONG = "not by default", "no quick form"
_MEASURED = {
    "physics": [
        ("accuracy", "error of forces and displacements against run time", "physics.accuracy"),
        ("estimate", "each pose's estimate of its error beside the true one", "physics.estimate", EXTRA),
        (
            "shapes",
            "other indenters than spheres against finite elements",
            "physics.accuracy:run_shapes",
            EXTRA,
        ),
    ],
    "render": [(None, "error of pictures against run time, beside a path tracer", "render.accuracy")],
    "sensors": [
        ("prediction", "how well a real sensor's pictures are predicted from others of it", "render.sensors"),
        (
            "unknown-ball",
            "the same where ball, scale and marks are hardly known",
            "render.sensors:run_unknown_ball",
            EXTRA,
        ),
        ("sets", "other sensors' presses, whatever sets are in --data", "real.sensor_sets"),
    ],
    "stability": [("physics", "solves at the corners of what is allowed", "physics.stability")],
    "view": [(None, "from a knob of gelgap view to the picture", "view")],
    "throughput": [
        ("generation", "time to generate and to read domains", "throughput"),
        ("frames", "random contacts from a library, a stream, a sensor in a loop", "frames", EXTRA),
    ],
    "adaptation": [
        ("tuning", "each method's setting, chosen on the tuning groups", "adaptation.tuning:PART", LONG),
        ("groups", "all methods on the paper's nine groups", "adaptation.groups:PART"),
        ("calm", "how far two runs come apart that differ in rounding", "adaptation.calm:PART", LONG),
        ("inputs", "what each input is worth, with five methods", "adaptation.rivals:INPUT_PART", LONG),
        ("lights", "training in drawn lights instead of adapting", "adaptation.rivals:LIGHT_PART", LONG),
        ("crossed", "gel, friction, markers and parts of the light", "adaptation.rivals:CROSSED_PART", LONG),
        ("training", "longer, with more weight, on more pixels", "adaptation.rivals:TRAINING_PART", LONG),
        ("labels", "how many target labels close a gap", "adaptation.labels:PART", LONG),
    ],
    "real": [
        ("sessions", "force from one session's light to another's, on real grasps", "real.sessions"),
        ("networks", "the same with all methods of adaptation", "real.sessions:networks", EXTRA),
        (
            "pretraining",
            "few labels, from scratch and pretrained on drawn domains",
            "real.few_labels:pretraining",
            EXTRA,
        ),
        (
            "randomisation",
            "what matters in the synthetic data, one factor of randomisation at a time",
            "real.few_labels:randomisation",
            EXTRA,
        ),
    ],
}
BENCHMARKS = tuple(
    Benchmark(
        *(subject, part, description, place),
        *(flag not in flags for flag in (EXTRA, LONG)),
        needs_data=place.startswith("real."),
    )
    for subject, rows in _MEASURED.items()
    for part, description, place, *flags in rows
)


def subjects() -> tuple[str, ...]:
    """Return the names of all subjects."""
    return tuple(dict.fromkeys(benchmark.subject for benchmark in BENCHMARKS))


def parts_of(subject: str) -> tuple[Benchmark, ...]:
    """Return the parts of a subject; none if it has no parts."""
    return tuple(b for b in BENCHMARKS if b.subject == subject and b.part is not None)


def find_benchmarks(
    subject: str, part: str | None, quick: bool, with_data: bool = False
) -> tuple[Benchmark, ...]:
    """Return what is to be measured of a subject: one part, or without a choice those by default.

    Of these the ones that take a folder of data if there is one, and otherwise the others.

    Raises
    ------
    ValueError
        If the subject has no such part, or nothing of what was chosen has a quick form.
    """
    chosen = [b for b in BENCHMARKS if b.subject == subject and (b.part == part if part else b.by_default)]
    if part is None:
        chosen = [benchmark for benchmark in chosen if benchmark.needs_data == with_data] or chosen
    if not chosen:
        names = ", ".join(benchmark.part for benchmark in parts_of(subject))
        has = f"its parts are {names}" if names else "it has no parts"
        raise ValueError(f"--what {quoted(part)} is no part of benchmark {subject}; {has}")
    found = tuple(benchmark for benchmark in chosen if benchmark.has_quick_form or not quick)
    if not found:
        names = ", ".join(benchmark.part for benchmark in parts_of(subject) if benchmark.has_quick_form)
        raise ValueError(f"--quick: {part} has no quick form; {names} have")
    return found
