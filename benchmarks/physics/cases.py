"""Cases of the physics benchmark: a scene at a quality and its true solution; each is solved in a fresh process.

Those processes import this module, so that it is light: what they take is what is measured.
"""

import hashlib
import importlib.metadata
import resource
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gelgap import sim
from gelgap.benchmarks import fem
from gelgap.benchmarks.common import Results, Setting, key_of, run_missing
from gelgap.sim import (
    Elastomer,
    MembraneState,
    Pose,
    PosePath,
    Sharing,
    Solve,
    SolvePlan,
    Sphere,
    plan_solves,
)
from gelgap.sim.solution import solution_bytes, solution_from_bytes

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
    indenter: Sphere = field(default_factory=Sphere)
    sharing: Sharing = field(default_factory=lambda: Sharing(cache=False))
    truth: Truth | None = field(default=None, compare=False, repr=False)

    @cached_property
    def plan(self) -> SolvePlan:
        """The one solve that the poses need."""
        path = PosePath("visit", tuple(replace(pose, trajectory=0) for pose in self.poses))
        return plan_solves(self.elastomer, self.indenter, path, self.quality, self.sharing)

    def down_to(self, depth_mm: float) -> "Case":
        """Return the part of a press that is no deeper."""
        truth, count = self.truth, sum(pose.depth_mm <= depth_mm for pose in self.poses)
        arrays = ("force_n", "radius_mm", "radius_uncertainty_mm", "profiles")
        kept = {name: getattr(truth, name)[:count] for name in arrays}
        return replace(self, poses=self.poses[:count], truth=replace(truth, **kept))


@dataclass(frozen=True)
class SolvedCase:
    """A case's states, and what its process took: wall and processor s per pose (imports included), peak MiB."""

    case: Case
    states: tuple[MembraneState, ...]
    wall_s_per_pose: float
    core_s_per_pose: float
    peak_mib: float

    @property
    def force_n(self) -> Floats:
        """Forces (poses, 3)."""
        return np.array([state.force_n for state in self.states])

    @property
    def unconverged(self) -> int:
        return sum(not state.converged for state in self.states)


@dataclass(frozen=True)
class Solver:
    """How many processes solve (None: one per core), and the folder that keeps what they have finished."""

    processes: int | None
    folder: Path

    def solve(self, cases: Iterable[Case]) -> dict[Case, SolvedCase]:
        """Solve each case, the slowest first; one that is in the folder already is read."""
        ordered = sorted(cases, key=lambda case: SLOWEST_FIRST.index(case.quality))
        found = self.problems({f"{c.study}, {c.name}, {c.quality}": c.plan.solves[0] for c in ordered})
        solved = {}
        for case, one in zip(ordered, found.itertuples(), strict=True):
            count = len(case.poses)
            states = tuple(case.plan.state(index, one.solution) for index in range(count))
            solved[case] = SolvedCase(case, states, one.wall_s / count, one.core_s / count, one.peak_mib)
        return solved

    def problems(self, solves: Mapping[str, Solve]) -> "pd.DataFrame":
        """Solve problems, each in a process of its own; return solution, wall_s, core_s, peak_mib of each.

        `core_s` is that of the whole process, `solve_s` of the solve in it.
        """
        settings = [{"what": name, "of": digest(solve.key)} for name, solve in solves.items()]
        by_key = {key_of(setting): solve for setting, solve in zip(settings, solves.values(), strict=True)}
        found = run_missing(
            partial(solve_problem, by_key),
            settings,
            self.folder / "solves.jsonl",
            workers=self.processes,
            tasks_per_worker=1,
            describe=lambda record: f"{record['core_s']:.1f} s",
        )
        found["solution"] = [solution_from_bytes(data.tobytes()) for data in found["solution"]]
        return found


def solve_problem(solves: Mapping[str, Solve], setting: Setting) -> Results:
    """Solve in this process, which is taken to be fresh; keep the solution as the bytes of its file."""
    started, imports_s = time.perf_counter(), time.process_time()
    solution = solves[key_of(setting)].run()
    return {
        "wall_s": time.perf_counter() - started,
        "core_s": time.process_time(),
        "solve_s": time.process_time() - imports_s,
        "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "solution": np.frombuffer(solution_bytes(solution), np.uint8),
    }


def digest(of: str) -> str:
    """Return a short hash of what is solved, of the solvers' code, and of MuJoCo's version."""
    return hashlib.sha256(f"{of} {_code_digest()}".encode()).hexdigest()[:12]


@cache
def _code_digest() -> str:
    files = [file for room in (sim, fem) for file in sorted(Path(room.__file__).parent.rglob("*.py"))]
    code = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
    return f"{code} {importlib.metadata.version('mujoco')}"
