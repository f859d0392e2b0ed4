"""Cases of the physics benchmark: a scene at a quality and its true solution; each is solved in a fresh process.

Those processes import this module, so that it is light: what they take is what is measured.
"""

import hashlib
import importlib.metadata
import resource
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gelgap import sim
from gelgap.benchmarks import fem
from gelgap.benchmarks.common import Results, Setting, key_of, run_missing
from gelgap.sim import AnyIndenter, Elastomer, MembraneState, Pose, Sharing, Solve, SolvePlan, Sphere
from gelgap.sim.plan import plan_visit
from gelgap.sim.solution import Solution, solution_bytes, solution_from_bytes

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]
SLOWEST_FIRST = ("fine", "standard", "draft")


@dataclass(frozen=True)
class Truth:
    """The solution that a case is compared with, by pose: forces (k, 3), N, NaN where they are not known.

    `fx_uncertainty` is how far Fx may be off, as a share. Presses have contact radii (k,), their uncertainty, and
    `profiles` (r, u_r, u_z) of the surface.
    """

    force_n: Floats
    source: str = "table"
    fx_uncertainty: float = 0.0
    radius_mm: Floats | None = None
    radius_uncertainty_mm: Floats | None = None
    profiles: tuple[Floats, ...] = ()

    def displacement_mm(self, index: int, x_mm: Floats, y_mm: Floats) -> Floats:
        """Return the surface's displacement (ny, nx, 3) on a rest grid centred on the contact."""
        r, u_r, u_z = self.profiles[index]
        x, y = np.meshgrid(x_mm, y_mm)
        radius = np.hypot(x, y)
        outward = np.interp(radius, r, u_r) / np.maximum(radius, 1e-9)
        return np.stack([outward * x, outward * y, np.interp(radius, r, u_z)], axis=-1)


@dataclass(frozen=True)
class Case:
    """Poses that the indenter visits one after the other at one point; the simulator's cache is off by default."""

    study: str
    name: str
    elastomer: Elastomer
    poses: tuple[Pose, ...]
    quality: str = "standard"
    indenter: AnyIndenter = field(default_factory=Sphere)
    sharing: Sharing = field(default_factory=lambda: Sharing(cache=False))
    truth: Truth | None = field(default=None, compare=False, repr=False)

    @cached_property
    def plan(self) -> SolvePlan:
        """The one solve that the poses need."""
        return plan_visit(self.elastomer, self.indenter, self.poses, self.quality, self.sharing)

    @property
    def solve(self) -> Solve:
        return self.plan.solves[0]

    def down_to(self, depth_mm: float) -> "Case":
        """Return the part of a press that is no deeper."""
        count = sum(pose.depth_mm <= depth_mm for pose in self.poses)
        arrays = ("force_n", "radius_mm", "radius_uncertainty_mm", "profiles")
        there = {name: own for name in arrays if (own := getattr(self.truth, name)) is not None}
        kept = {name: own[:count] for name, own in there.items()}
        return replace(self, poses=self.poses[:count], truth=replace(self.truth, **kept))

    def states(self, solution: Solution) -> tuple[MembraneState, ...]:
        """Return the membrane at each pose."""
        return tuple(self.plan.state(index, solution) for index in range(len(self.poses)))


@dataclass(frozen=True)
class Solver:
    """How many processes measure (None: one per core), and the folder that keeps what they have finished."""

    processes: int | None
    folder: Path

    def measure(
        self, function: Callable[[Any], Results], things: Mapping[str, Any], tasks_per_worker: int | None = 1
    ) -> "pd.DataFrame":
        """Call a function with each thing, in a fresh process; return the results by the things' names.

        What the folder has of the same thing and the same code of the solvers is read.
        """
        settings = [
            {"study": function.__name__.replace("_", " "), "what": name, "of": _digest(thing)}
            for name, thing in things.items()
        ]
        by_key = dict(zip(map(key_of, settings), things.values(), strict=True))
        found = run_missing(
            partial(_called, function, by_key),
            settings,
            self.folder / f"{function.__name__}.jsonl",
            workers=self.processes,
            tasks_per_worker=tasks_per_worker,
        )
        return found.set_index("what").drop(columns=["study", "of"])

    def solve(self, solves: Mapping[str, Solve]) -> "pd.DataFrame":
        """Return solution, wall_s, core_s, solve_s and peak_mib of each solve; see `solved`."""
        found = self.measure(solved, solves)
        return found.assign(solution=[solution_from_bytes(data.tobytes()) for data in found["solution"]])

    def cases(self, cases: Iterable[Case]) -> dict[Case, Any]:
        """Solve cases, the slowest first; each has its `states` beside what `solve` returns."""
        ordered = sorted(cases, key=lambda case: SLOWEST_FIRST.index(case.quality))
        if not ordered:
            return {}
        found = self.solve({f"{case.study}, {case.name}, {case.quality}": case.solve for case in ordered})
        found["states"] = [case.states(own) for case, own in zip(ordered, found["solution"], strict=True)]
        return dict(zip(ordered, found.itertuples(), strict=True))


def solved(solve: Solve) -> Results:
    """Solve in this process, which is taken to be fresh; keep the solution as the bytes of its file.

    `core_s` is the processor time of the whole process, imports included, `solve_s` that of the solve in it.
    """
    started, imports_s = time.perf_counter(), time.process_time()
    solution = solve.run()
    return {
        "wall_s": time.perf_counter() - started,
        "core_s": time.process_time(),
        "solve_s": time.process_time() - imports_s,
        "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "solution": np.frombuffer(solution_bytes(solution), np.uint8),
    }


def _called(function: Callable[[Any], Results], things: Mapping[str, Any], setting: Setting) -> Results:
    return function(things[key_of(setting)])


def _digest(thing: Any) -> str:
    return hashlib.sha256(f"{thing!r} {code_digest()}".encode()).hexdigest()[:12]


@cache
def code_digest() -> str:
    """Return a short hash of the solvers' code and of MuJoCo's version."""
    files = [file for room in (sim, fem) for file in sorted(Path(room.__file__).parent.rglob("*.py"))]
    code = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
    return f"{code[:12]} {importlib.metadata.version('mujoco')}"
