"""Estimated beside taken time: what `generate --dry-run` and a solve's progress say, and what then happens."""

import resource
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gelgap.benchmarks.common.tables import print_table, write_json
from gelgap.benchmarks.physics.cases import own_cache
from gelgap.domains import DomainRecipe, GenerationProgress, estimate, generate_recipes, make_recipes
from gelgap.domains.generation.progress import TimeLeft, Workload
from gelgap.sim import ContactPath, Elastomer, Pose, PosePath, Sharing, Sphere, plan_solves
from gelgap.sim.pace import known_pace, measured_pace, timed_solve
from gelgap.sim.problem import ContactProblem

GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.8)
SMALL = {"quality": "draft", "render_quality": "draft", "size_px": (160, 120)}
AIM = 1.5
COLUMNS = (
    *("work", "processes", "core s estimated", "taken", "over estimated"),
    *("wall s estimated", "taken", "over estimated"),
    "true over told time left",
)
NOTE = (
    f"aim: between 1/{AIM:g} and {AIM:g}; a fresh cache, whose record begins with one short press; "
    "wall time depends on what else the machine does meanwhile"
)


@dataclass(frozen=True)
class Guess:
    """One piece of work: seconds of a core and of the clock, as estimated before and as taken.

    `left_ratio` is the true time left over the told one, where that is worst in the middle half of the time.
    """

    work: str
    processes: int
    core_estimated_s: float
    core_taken_s: float
    wall_estimated_s: float | None
    wall_taken_s: float
    left_ratio: float | None = None

    @property
    def core_ratio(self) -> float:
        return self.core_taken_s / self.core_estimated_s

    @property
    def row(self) -> list[object]:
        """The row of the table."""
        core = (self.core_estimated_s, self.core_taken_s, self.core_ratio)
        wall = self.wall_estimated_s
        ratio = None if wall is None else self.wall_taken_s / wall
        return [self.work, self.processes, *core, wall, self.wall_taken_s, ratio, self.left_ratio]


class ToldTimeLeft(GenerationProgress):
    """Keeps what a generation tells of the time left: pairs of time passed and time left, s."""

    def __init__(self) -> None:
        self.told: list[tuple[float, float]] = []

    def begin(self, solves: int, frames: int, load: Workload | None = None) -> None:
        assert load is not None, "a local cluster's work is known"
        self._left, self._start = TimeLeft(load), time.monotonic()

    def stepped(self, solve: str, done: int) -> None:
        self._left.step(solve, done, self._passed_s)
        self._note()

    def solved(self, solve: str = "") -> None:
        self._left.solve(solve, self._passed_s)
        self._note()

    def written(self, frames: int) -> None:
        self._left.write(frames, self._passed_s)
        self._note()

    def worst_ratio(self) -> float | None:
        """Return true over told time left where it is furthest from 1, in the middle half of the time."""
        end_s = max(passed_s for passed_s, _ in self.told)
        middle = [pair for pair in self.told if 0.25 * end_s <= pair[0] <= 0.75 * end_s and pair[1] > 0]
        ratios = [(end_s - passed_s) / left_s for passed_s, left_s in middle]
        return max(ratios, key=lambda ratio: max(ratio, 1 / ratio), default=None)

    @property
    def _passed_s(self) -> float:
        return time.monotonic() - self._start

    def _note(self) -> None:
        left_s = self._left.left_s(self._passed_s)
        if left_s is not None:
            self.told.append((self._passed_s, left_s))


def run(quick: bool, out_dir: Path) -> None:
    """Estimate, then do, several kinds of work; print the table and write `estimates.json`.

    Solves go to an empty cache of the benchmark's own, so that the machine is as if nothing had been solved on it. The
    quick form leaves out what takes longest: solves at `standard`, and the smoke data set.
    """
    folder = out_dir / "estimates"
    shutil.rmtree(folder, ignore_errors=True)
    with own_cache(folder / "solves"):
        measured_pace()
        guesses = []
        for guess in (*presses(quick), *generations(folder, quick)):
            print(f"{guess.work}: {guess.core_ratio:.2f} of what was estimated", flush=True)
            guesses.append(guess)
    print_table("Estimated and taken time", COLUMNS, [guess.row for guess in guesses], NOTE)
    write_json(out_dir / "estimates.json", guesses)


def press(quality: str, diameter_mm: float = 3.0, **pose: float) -> ContactProblem:
    """Return the problem of one pose."""
    path = PosePath("one", (Pose(**pose),))
    return (
        plan_solves(GEL, Sphere(diameter_mm=diameter_mm), path, quality, Sharing(cache=False))
        .solves[0]
        .problem
    )


def presses(quick: bool) -> Iterator[Guess]:
    """Solve problems of several kinds, one process each."""
    problems = {
        "press, draft": press("draft", depth_mm=0.6),
        "press and drag, draft": press("draft", depth_mm=0.6, shear_x_mm=0.3),
        "press near an edge, draft": press("draft", depth_mm=0.4, point_x_mm=10.0),
    }
    if not quick:
        problems |= {
            "press, standard": press("standard", depth_mm=0.6),
            "press and drag, standard": press("standard", depth_mm=0.6, shear_x_mm=0.3),
            "sphere of 12 mm, standard": press("standard", 12.0, depth_mm=0.6),
        }
    for work, problem in problems.items():
        expected_s = known_pace().solve_s(problem)
        core, wall = time.process_time(), time.perf_counter()
        timed_solve(problem)
        taken_s = time.process_time() - core, time.perf_counter() - wall
        yield Guess(work, 1, expected_s, taken_s[0], None, taken_s[1])


def generations(folder: Path, quick: bool) -> Iterator[Guess]:
    """Generate a small data set of new and of known solves, with one and with two processes."""
    path = ContactPath(
        "small", (-2.25, 2.25), (-1.3, 1.3), (0.2,), (0.1,), tuple(15.0 * k for k in range(24))
    )
    small = make_recipes(["mb0i0", "wmb1i1"], path, **SMALL)
    yield generation("100 frames each of two gels", small, folder / "cold", 1)
    yield generation("the same, solves known", small, folder / "warm", 1)
    yield generation("the same, two processes", small, folder / "two", 2)
    if not quick:
        smoke = make_recipes(["mb0i0", "wmb1i1"], "smoke", quality="standard")
        yield generation("the smoke data set, standard", smoke, folder / "smoke", 2)


def generation(work: str, recipes: Sequence[DomainRecipe], out_dir: Path, workers: int) -> Guess:
    """Estimate a generation as `--dry-run` does, and generate."""
    told = estimate(recipes, workers)
    core, wall = _core_s(), time.perf_counter()
    left = ToldTimeLeft()
    generate_recipes(recipes, out_dir, workers=workers, progress=left)
    taken_s = _core_s() - core, time.perf_counter() - wall
    return Guess(work, workers, told.core_s, taken_s[0], told.wall_s, taken_s[1], left.worst_ratio())


def _core_s() -> float:
    """Return the processor time of this process and of those that it has waited for."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime
