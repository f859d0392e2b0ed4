"""What a generation will take, before anything is solved: solves, frames, time, disk, forces beyond the range."""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gelgap.assets.names import comma_list
from gelgap.domains.generation.plan import GenerationPlan, plan_generation
from gelgap.domains.generation.scheduler import check_scheduler
from gelgap.domains.generation.shard import picture_cells
from gelgap.domains.recipe import DomainRecipe
from gelgap.sim import MembraneState
from gelgap.sim.cost import DEAR_S
from gelgap.sim.membrane import grid_axes
from gelgap.sim.press import expected_force_n
from gelgap.sim.solution import has_solution

LOG = logging.getLogger(__name__)
# Seconds of a core of a server of 2023: the start of a process, a frame.
_START_S = 4.0
_FRAME_S, _FRAME_PIXEL_S = 0.006, 1e-7
# A range that is proposed is wider than the force that is expected, by what the expectation may be short of.
_ROOM_FOR_FORCE = 1.5
_LEAST_LIKELY_MM = 0.005


@dataclass(frozen=True)
class Estimate:
    """The size of a plan, and what it takes.

    `wall_s` is the time on an idle machine whose cores are like a server's of 2023. `exact` is the estimate of the same
    domains with each pose solved, None where they are so anyway.
    """

    plan: GenerationPlan
    workers: int
    solves_cached: int
    wall_s: float
    disk_bytes: float
    exact: "Estimate | None" = None

    @property
    def wall(self) -> str:
        return f"{self.wall_s:.0f} s" if self.wall_s < 90 else f"{self.wall_s / 60:.0f} min"

    def __str__(self) -> str:
        plan = self.plan
        frame_kb = self.disk_bytes / self.plan.frames / 1e3
        lines = [
            f"domains  {comma_list([recipe.name for recipe in plan.recipes])}",
            f"frames   {plan.frames} in {plan.shards} shards",
            f"solves   {len(plan.solves)}, of which {self.solves_cached} are already known",
            f"time     about {self.wall} with {self.workers} workers",
            f"disk     about {self.disk_bytes / 1e6:.0f} MB ({frame_kb:.1f} kB per frame)",
        ]
        if self.exact:
            lines.append(
                "library  poses are interpolated, at most two solves more where its error is too large; each solved "
                f"by itself (--set interpolated=false): {len(self.exact.plan.solves)} solves, about {self.exact.wall}"
            )
        lines += [f"indenter {line}" for line in _by_indenter(plan)]
        lines += [f"note     {note}" for note in (*_dear_notes(plan), *force_notes(plan.recipes))]
        return "\n".join(lines)


def estimate(recipes: Sequence[DomainRecipe], workers: int | None = None) -> Estimate:
    """Plan domains and estimate their cost; one frame is rendered for it.

    Raises
    ------
    ValueError
        If workers is below 1, or a contact cannot be solved.
    """
    check_scheduler(None, workers)
    LOG.info("planning and rendering a sample frame of %s", comma_list([recipe.name for recipe in recipes]))
    plan = plan_generation(recipes)
    processes = plan.processes(workers)
    solve_s = [solve.expected_core_s for key, solve in plan.solves.items() if not has_solution(key)]
    pixels = max(recipe.size_px[0] * recipe.size_px[1] for recipe in recipes)
    # One solve is not shared; frames are shared as shards.
    solving_s = max(sum(solve_s) / processes, *solve_s, 0.0)
    rendering_s = (_FRAME_S + _FRAME_PIXEL_S * pixels) * plan.frames / min(processes, plan.shards)
    (sample,) = picture_cells(recipes[:1], 0, _dent())
    frame_bytes = sum(len(cell["bytes"]) for cell in sample.values() if isinstance(cell, dict))
    has_libraries = any(batch.contacts.library for batch in plan.batches)
    exact = [recipe.model_copy(update={"interpolated": False}) for recipe in recipes]
    return Estimate(
        plan,
        processes,
        solves_cached=len(plan.solves) - len(solve_s),
        wall_s=_START_S + solving_s + rendering_s,
        disk_bytes=frame_bytes * plan.frames,
        exact=estimate(exact, workers) if has_libraries else None,
    )


def _by_indenter(plan: GenerationPlan) -> list[str]:
    """Return what the solves of each indenter take."""
    by_label: dict[str, list[float]] = {}
    for solve in plan.solves.values():
        turns = ", turning" if solve.problem.turns_deg else ""
        by_label.setdefault(solve.problem.indenter.label + turns, []).append(solve.expected_core_s)
    return [
        f"{label}: {len(core_s)} solves, {sum(core_s):.0f} s of a core" for label, core_s in by_label.items()
    ]


def _dear_notes(plan: GenerationPlan) -> list[str]:
    """Return what would make the dearest solve cheaper, if it is dear."""
    dearest = max(plan.solves.values(), key=lambda solve: solve.expected_core_s, default=None)
    if dearest is None or dearest.expected_core_s <= DEAR_S[dearest.problem.quality.name]:
        return []
    return [f"the longest solve takes {dearest.forecast}"]


def force_notes(recipes: Sequence[DomainRecipe]) -> list[str]:
    """Return in sentences which forces will probably be outside their declared range, or next to nothing."""
    if (most_mm := max(pose.depth_mm for recipe in recipes for pose in recipe.path.poses)) < _LEAST_LIKELY_MM:
        return [f"the deepest press is {most_mm:g} mm deep: are depths in mm?"]
    beyond = []
    for recipe in recipes:
        deepest_mm = max(pose.depth_mm for pose in recipe.path.poses)
        force_n = expected_force_n(recipe.elastomer, recipe.indenter, deepest_mm) if deepest_mm else 0.0
        if force_n > -recipe.force_range_n[2][0]:
            beyond.append((force_n, recipe))
    if not beyond:
        return []
    force_n, recipe = max(beyond, key=lambda pair: pair[0])
    others = f" (and {len(beyond) - 1} other domains)" if len(beyond) > 1 else ""
    wide = math.ceil(_ROOM_FOR_FORCE * force_n)
    return [
        f"the deepest press of {recipe.name}{others} takes about {force_n:.3g} N, beyond the declared Fz = "
        f"{recipe.force_range_n[2][0]:g} N: training refuses such frames; declare a wider range, "
        f"for gelgap pretrain as force_range_n = [[-{wide}, {wide}], [-{wide}, {wide}], [-{wide}, 0]] in the file of "
        f"--ranges, for gelgap generate as --range fx_n=-{wide}:{wide} fy_n=-{wide}:{wide} fz_n=-{wide}:0"
    ]


def _dent() -> MembraneState:
    """Return a membrane that looks like a contact to the renderer; no physics."""
    x_mm, y_mm = grid_axes()
    distance2 = x_mm[None, :] ** 2 + y_mm[:, None] ** 2
    displacement = np.zeros((len(y_mm), len(x_mm), 3), np.float32)
    displacement[..., 2] = -0.6 * np.exp(-distance2)
    return MembraneState(x_mm, y_mm, displacement, distance2 < 0.5, np.zeros(3))
