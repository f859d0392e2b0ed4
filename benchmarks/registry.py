"""The benchmarks: name, what each measures, and where. Adding one is a file and a line here.

Every module has `run(quick: bool, out_dir: Path) -> None`, which measures, prints tables and writes what it found below
`out_dir`; one that `needs_data` also takes `data`, the folder of the user's clones. The modules of the adaptation
benchmark also have a `PART`, which its report is made of.
"""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType


@dataclass(frozen=True)
class Benchmark:
    """One benchmark: a subject, or one part of a subject that has several.

    Without a choice of parts, those `by_default` are measured; `--quick` leaves out parts without a quick form.
    """

    subject: str
    part: str | None
    description: str
    module: str
    by_default: bool = True
    has_quick_form: bool = True
    needs_data: bool = False

    @property
    def resumes(self) -> bool:
        """Whether it goes on where it was stopped, when it is run again."""
        return self.module not in _BEGINS_ANEW

    def load(self) -> ModuleType:
        """Import the benchmark's module."""
        return import_module(f"gelgap.benchmarks.{self.module}")

    def run(self, quick: bool, out_dir: Path, data: Path | None = None) -> None:
        """Measure."""
        given = {"data": data} if self.needs_data else {}
        self.load().run(quick=quick, out_dir=out_dir, **given)


_BEGINS_ANEW = (
    "stages",
    "render.accuracy",
    "physics.stability",
    "render.stability",
    "view",
    "adaptation.losses",
    "adaptation.published_losses",
    "adaptation.speed",
    "real.session_transfer",
)
BENCHMARKS = (
    Benchmark("physics", None, "error of forces and displacements against run time", "physics.accuracy"),
    Benchmark("render", None, "error of pictures against run time, beside a path tracer", "render.accuracy"),
    Benchmark(
        "sensors",
        "prediction",
        "how well a real sensor's pictures are predicted from others of it",
        "render.sensors",
    ),
    Benchmark(
        "sensors",
        "unknown-ball",
        "the same where ball, scale and marks are hardly known",
        "render.unknown_ball",
        by_default=False,
    ),
    Benchmark(
        "sensors",
        "robustness",
        "what a fit to disturbed pictures still predicts",
        "render.sensor_robustness",
        by_default=False,
    ),
    Benchmark("stability", "physics", "solves at the corners of what is allowed", "physics.stability"),
    Benchmark(
        "stability", "render", "memory and time over many frames", "render.stability", by_default=False
    ),
    Benchmark(
        "stability", "losses", "adaptation losses in every known trap", "adaptation.losses", by_default=False
    ),
    Benchmark(
        "stability",
        "published",
        "adaptation losses beside public code",
        "adaptation.published_losses",
        by_default=False,
    ),
    Benchmark("view", None, "from a knob of gelgap view to the picture", "view"),
    Benchmark("throughput", "generation", "time to generate and to read domains", "throughput"),
    Benchmark(
        "throughput",
        "stages",
        "where the time of a data set goes, and how it scales",
        "stages",
        by_default=False,
    ),
    Benchmark(
        "adaptation",
        "augmentations",
        "augmentations, chosen on the tuning groups",
        "adaptation.augmentations",
        has_quick_form=False,
    ),
    Benchmark(
        "adaptation",
        "tuning",
        "each method's setting, chosen on the tuning groups",
        "adaptation.tuning",
        has_quick_form=False,
    ),
    Benchmark("adaptation", "groups", "all methods on the paper's nine groups", "adaptation.groups"),
    Benchmark(
        "adaptation",
        "transfer",
        "whether what was chosen holds on the nine groups",
        "adaptation.transfer",
        has_quick_form=False,
    ),
    Benchmark(
        "adaptation", "gaps", "error against the size of a gap", "adaptation.gaps", has_quick_form=False
    ),
    Benchmark(
        "adaptation",
        "labels",
        "how many target labels close a gap",
        "adaptation.labels",
        has_quick_form=False,
    ),
    Benchmark("adaptation", "speed", "training steps beside a plain loop", "adaptation.speed"),
    Benchmark(
        "real",
        "sessions",
        "force from one session's light to another's, on real grasps",
        "real.session_transfer",
        needs_data=True,
    ),
    Benchmark(
        "real",
        "networks",
        "the same with all methods of adaptation",
        "real.networks",
        by_default=False,
        needs_data=True,
    ),
    Benchmark(
        "real",
        "contact-point",
        "where a ball touches, from synthetic presses to real ones",
        "real.contact_point",
        by_default=False,
        needs_data=True,
    ),
    Benchmark(
        "real",
        "pretraining",
        "few labels, from scratch and pretrained on drawn domains",
        "real.pretraining",
        by_default=False,
        needs_data=True,
    ),
    Benchmark(
        "real",
        "randomisation",
        "what matters in the synthetic data, one factor of randomisation at a time",
        "real.randomisation",
        by_default=False,
        needs_data=True,
    ),
)


def subjects() -> tuple[str, ...]:
    """Return the names of all subjects."""
    return tuple(dict.fromkeys(benchmark.subject for benchmark in BENCHMARKS))


def parts_of(subject: str) -> tuple[Benchmark, ...]:
    """Return the parts of a subject; none if it has no parts."""
    return tuple(b for b in BENCHMARKS if b.subject == subject and b.part is not None)


def find_benchmarks(subject: str, part: str | None, quick: bool) -> tuple[Benchmark, ...]:
    """Return what is to be measured of a subject: one part, or without a choice those by default.

    Raises
    ------
    ValueError
        If the subject has no such part, or nothing of what was chosen has a quick form.
    """
    names = ", ".join(benchmark.part for benchmark in parts_of(subject))
    chosen = [b for b in BENCHMARKS if b.subject == subject and (b.part == part if part else b.by_default)]
    if not chosen:
        has = f"its parts are {names}" if names else "it has no parts"
        raise ValueError(f"--what {part} is no part of benchmark {subject}; {has}")
    found = tuple(b for b in chosen if b.has_quick_form or not quick)
    if not found:
        quick_names = ", ".join(b.part for b in parts_of(subject) if b.has_quick_form)
        raise ValueError(f"--quick: {part} has no quick form; {quick_names} have")
    return found
