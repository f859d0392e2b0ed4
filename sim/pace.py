"""How long solves take on this machine: its own record of past ones, or one short measurement."""

import contextlib
import json
import logging
import statistics
import time
from dataclasses import dataclass

from gelgap.assets.locks import cache_folder, key_lock
from gelgap.assets.whole_file import write_whole
from gelgap.sim.elastomer import Elastomer
from gelgap.sim.indenters.sphere import Sphere
from gelgap.sim.mesh.for_problem import unordered_mesh
from gelgap.sim.newton import SolveProgress, silent, solve
from gelgap.sim.problem import ContactProblem
from gelgap.sim.scene import Scene, Sharing
from gelgap.sim.solution import Solution
from gelgap.sim.thresholds import THRESHOLDS

LOG = logging.getLogger(__name__)
# Its name says of which method it is: another one's pace would be no guide.
RECORD = "condensed-pace.jsonl"
# Lines that the record keeps, and the last ones of a kind whose median counts.
_LINES_KEPT = 400
_LINES_COUNTED = 9
# An iteration on a mesh with n vertices takes about n^1.5.
_VERTICES = 3000
_EXPONENT = 1.5
# Seconds of a core per load step on a mesh of 3000 vertices, on a server of 2023; more where friction slides. Ordering
# such a mesh and compiling its model takes time as well.
_SECONDS_PER_STEP = 0.26
_TRAVEL_FACTOR = 1.3
_SECONDS_TO_BUILD = 0.4


@dataclass(frozen=True)
class Pace:
    """How many times slower solves are than the built-in figures say, by kind of problem, and over all kinds.

    `slowness` is None where nothing is known.
    """

    by_kind: dict[str, float]
    slowness: float | None

    def solve_s(self, problem: ContactProblem) -> float:
        """Return the expected seconds of a solve, alone on its core."""
        return built_in_s(problem) * self.by_kind.get(kind(problem), self.slowness or 1.0)


def shape(problem: ContactProblem) -> str:
    """Return which part of the gel is meshed."""
    return ("half " if problem.symmetric else "") + (
        "pad" if problem.pad_mm or not problem.symmetric else "disc"
    )


def kind(problem: ContactProblem) -> str:
    """Return what solves are compared by: quality, the meshed part, and whether the indenter travels sideways."""
    return f"{problem.quality.name} {shape(problem)}{' with travel' if problem.travel_mm else ''}"


def built_in_s(problem: ContactProblem) -> float:
    """Return the seconds of a core that a problem takes on the machine that the built-in figures are of."""
    first_contacts = len(THRESHOLDS.first_contact_shares) * problem.parents.count(-1)
    size = len(unordered_mesh(problem).vertices_mm) / _VERTICES
    step_s = size**_EXPONENT * _SECONDS_PER_STEP * (_TRAVEL_FACTOR if problem.travel_mm else 1.0)
    return size * _SECONDS_TO_BUILD + (problem.load_steps + first_contacts) * step_s


def known_pace() -> Pace:
    """Return the pace that the record of the user's cache folder says."""
    found: dict[str, list[float]] = {}
    with contextlib.suppress(OSError):
        for line in (cache_folder() / RECORD).read_text(encoding="utf-8", errors="replace").splitlines():
            with contextlib.suppress(ValueError, TypeError, KeyError):
                entry = json.loads(line)
                slowness = float(entry["slowness"])
                if 0 < slowness < float("inf"):
                    found.setdefault(str(entry["kind"]), []).append(slowness)
    by_kind = {name: statistics.median(values[-_LINES_COUNTED:]) for name, values in found.items()}
    return Pace(by_kind, statistics.median(by_kind.values()) if by_kind else None)


def measured_pace() -> Pace:
    """Return the known pace; on a machine that has solved nothing yet, solve one shallow press of a second first."""
    pace = known_pace()
    if pace.slowness is not None:
        return pace
    gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.8)
    scene = Scene(gel, Sphere(diameter_mm=3.0), "draft", Sharing())
    timed_solve(scene.problem(None, ((0.0, 0.0, -0.2),), (-1,)))
    return known_pace()


def timed_solve(problem: ContactProblem, progress: SolveProgress = silent) -> Solution:
    """Solve a problem and enter how long it took in the record."""
    # Imports are no part of the pace.
    import mujoco  # noqa: F401

    import gelgap.sim.contact_newton
    import gelgap.sim.mesh.ordering  # noqa: F401

    expected_s, start, start_core = known_pace().solve_s(problem), time.perf_counter(), time.thread_time()

    def tell(done: int, total: int) -> None:
        progress(done, total)
        if done == total:
            return
        passed_s = time.perf_counter() - start
        left_s = time_left_s(done / total, expected_s, passed_s)
        LOG.info("solving (%s): %d of %d load steps, about %.0f s left", kind(problem), done, total, left_s)

    solution = solve(problem, tell)
    _record(problem, time.thread_time() - start_core)
    return solution


def time_left_s(share_done: float, expected_s: float, passed_s: float) -> float:
    """Return the seconds left: by what was expected in the first half, in the second by what the first part took."""
    if share_done < 0.5:
        return max(expected_s * (1 - share_done), expected_s - passed_s)
    return passed_s * (1 - share_done) / share_done


def _record(problem: ContactProblem, core_s: float) -> None:
    """Add a line; a record that cannot be written is done without."""
    folder = cache_folder()
    entry = {"kind": kind(problem), "slowness": round(core_s / built_in_s(problem), 4)}
    with contextlib.suppress(OSError, RuntimeError), key_lock(folder, RECORD):
        path = folder / RECORD
        lines = path.read_bytes().splitlines() if path.is_file() else []
        lines = [*lines[-_LINES_KEPT + 1 :], json.dumps(entry).encode()]
        write_whole(path, b"\n".join(lines) + b"\n")
