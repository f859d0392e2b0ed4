"""Public names that are kept for one version more, with a warning that names what replaces them."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Self

from gelgap.sim.indenter import Indenter
from gelgap.sim.membrane import SolvedPose
from gelgap.sim.path import ContactPath
from gelgap.sim.plan import Solve, SolvePlan, plan_solves
from gelgap.sim.press import solve_in_full
from gelgap.sim.scene import Elastomer, Pose
from gelgap.sim.solution import Solution

PATH_DEPTHS_MM = (0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
PATH_TRAVELS_MM = (0.0, 0.2, 0.4, 0.6)
_WITHOUT_EDGES = {"pad_size_mm": (100.0, 100.0)}


def known_pace() -> SimpleNamespace:
    """Return how long solves take. Deprecated: use `Solve.expected_core_s`; no record of past solves is kept."""
    _warn("known_pace and measured_pace are deprecated: use Solve.expected_core_s")
    return SimpleNamespace(slowness=None, solve_s=lambda problem: Solve(problem).expected_core_s)


measured_pace = known_pace


def plan_path(elastomer: Elastomer, indenter: Indenter, quality: str = "draft") -> SolvePlan:
    """Return the solves of `PATH_DEPTHS_MM` and `PATH_TRAVELS_MM`. Deprecated: use `gelgap.domains.LibraryPlan`."""
    _warn("plan_path is deprecated: use gelgap.domains.LibraryPlan")
    grid = ContactPath("grid", (0.0,), (0.0,), PATH_DEPTHS_MM, PATH_TRAVELS_MM, (0.0,))
    return plan_solves(elastomer.model_copy(update=_WITHOUT_EDGES), indenter, grid, quality)


@dataclass(frozen=True)
class SolvedPath:
    """Any pose of a gel. Deprecated: `gelgap.domains.PoseLibrary` interpolates poses; this solves each by itself."""

    indenter: Indenter
    quality: str

    @classmethod
    def from_solutions(cls, plan: SolvePlan, solutions: Mapping[str, Solution]) -> Self:
        """Return the path of a plan of `plan_path`; its solutions are no longer needed."""
        _warn("SolvedPath is deprecated: use gelgap.domains.PoseLibrary")
        return cls(plan.indenter, plan.solves[0].problem.quality.name)

    def pose(self, elastomer: Elastomer, pose: Pose) -> SolvedPose:
        """Return a pose on a pad without edges, solved by itself."""
        gel = elastomer.model_copy(update=_WITHOUT_EDGES)
        return solve_in_full(gel, self.indenter, pose, self.quality)


def _warn(message: str) -> None:
    warnings.warn(message, DeprecationWarning, stacklevel=3)
