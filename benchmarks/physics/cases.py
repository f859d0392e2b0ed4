"""Cases of the physics benchmark: a scene at a quality and its true solution; each is solved in a fresh process.

Those processes import this module, so that it is light: what they take is what is measured.
"""

import importlib.metadata
import math
import resource
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelgap import sim
from gelgap.assets.checksums import sha256
from gelgap.benchmarks.common import Results, Setting, key_of, run_missing
from gelgap.sim import Elastomer, MembraneState, Pose, Sharing, Sphere
from gelgap.sim.plan import Solve, SolvePlan, plan_visit
from gelgap.sim.shapes import AnyIndenter
from gelgap.sim.solution import Solution, solution_bytes, solution_from_bytes
from gelgap.sim.solved import NoContact, SolvedPose

Floats = NDArray[np.float64]
SLOWEST_FIRST = ("fine", "standard", "draft")


@dataclass(frozen=True)
class Truth:
    """The solution that a case is compared with, by pose: forces (k, 3), N, NaN where they are not known.

    Presses of round bodies have contact radii (k,), and presses `profiles` (r, u_r, u_z) of the surface, or scattered
    points of it (x, y, u_x, u_y, u_z). The truth may be off itself by `uncertainty_percent`: in Fx of a drag, the
    contact radius of a sphere, Fz of another body.
    """

    force_n: Floats
    source: str = "table"
    uncertainty_percent: float = math.nan
    radius_mm: Floats = field(default_factory=lambda: np.empty(0))
    profiles: tuple[Floats, ...] = ()

    def state(self, index: int, like: MembraneState) -> MembraneState:
        """Return the true membrane at a pose, centred on the contact, on the rest grid of another."""
        from scipy.interpolate import LinearNDInterpolator

        profile, radius_mm = self.profiles[index], like.contact_radius_mm
        x, y = np.meshgrid(like.x_mm, like.y_mm)
        if len(profile) == 5:
            displacement_mm = LinearNDInterpolator(profile[:2].T, profile[2:].T)(x, y)
        else:
            r, u_r, u_z = profile
            radius, radius_mm = np.hypot(x, y), float(self.radius_mm[index])
            outward = np.interp(radius, r, u_r) / np.maximum(radius, 1e-9)
            displacement_mm = np.stack([outward * x, outward * y, np.interp(radius, r, u_z)], axis=-1)
        return replace(
            like,
            displacement_mm=displacement_mm,
            force_n=self.force_n[index],
            contact_radius_mm=radius_mm,
            converged=True,
        )


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

    @property
    def known(self) -> Truth:
        """The true solution.

        Raises
        ------
        ValueError
            If none is known.
        """
        if self.truth is None:
            raise ValueError(f"{self.name} has no known solution")
        return self.truth

    def down_to(self, depth_mm: float) -> "Case":
        """Return the part of a press that is no deeper."""
        count = sum(pose.depth_mm <= depth_mm for pose in self.poses)
        kept = {name: getattr(self.known, name)[:count] for name in ("force_n", "radius_mm", "profiles")}
        return replace(self, poses=self.poses[:count], truth=replace(self.known, **kept))

    def states(self, solution: Solution) -> tuple[SolvedPose | NoContact, ...]:
        """Return the membrane at each pose."""
        solutions = {self.solve.key: solution}
        return tuple(self.plan.state(index, solutions) for index in range(len(self.poses)))


def solved_cases(cases: Iterable[Case], folder: Path) -> dict[Case, Any]:
    """Solve cases, each in a fresh process, the slowest first; return what `_solved` says of each, and its `states`.

    What the folder has of the same solve and the same code of the simulator is read. There are as many processes at a
    time as cores.
    """
    ordered = sorted(cases, key=lambda case: SLOWEST_FIRST.index(case.quality))
    if not ordered:
        return {}
    settings = [
        {
            "what": f"{case.study}, {case.name}, {case.quality}",
            "of": sha256(f"{case.solve.key} {code_digest()}".encode())[:12],
        }
        for case in ordered
    ]
    solves = {key_of(setting): case.solve for setting, case in zip(settings, ordered, strict=True)}
    found = run_missing(partial(_solved, solves), settings, folder / "solved.jsonl", tasks_per_worker=1)
    solutions = [solution_from_bytes(data.tobytes()) for data in found["solution"]]
    states = [case.states(own) for case, own in zip(ordered, solutions, strict=True)]
    found = found.assign(solution=solutions, states=states)
    return dict(zip(ordered, found.itertuples(), strict=True))


def _solved(solves: Mapping[str, Solve], setting: Setting) -> Results:
    """Solve in this process, which is taken to be fresh; keep the solution as the bytes of its file.

    `core_s` is the processor time of the whole process, imports included.
    """
    solution = solves[key_of(setting)].run()
    return {
        "core_s": time.process_time(),
        "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "solution": np.frombuffer(solution_bytes(solution), np.uint8),
    }


@cache
def code_digest() -> str:
    """Return a short hash of the simulator's code and of MuJoCo's version."""
    files = sorted(Path(sim.__file__).parent.rglob("*.py"))
    code = sha256(b"".join(file.read_bytes() for file in files))
    return f"{code[:12]} {importlib.metadata.version('mujoco')}"
