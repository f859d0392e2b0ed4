"""What a generation will take: solves, frames, time and disk, before any of it is done."""

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gelgap.domains.frame_pictures import group_by_picture, led_to_camera, picture_cells
from gelgap.domains.plan import GenerationPlan, plan_generation
from gelgap.domains.recipe import DomainRecipe
from gelgap.sim import MembraneState, grid_axes

if TYPE_CHECKING:
    from gelgap.sim import Solve

# Seconds of one core per load step, measured on the gel of the paper-like presets.
SECONDS_PER_LOAD_STEP = {"draft": 0.7, "standard": 6.0, "fine": 20.0}


@dataclass(frozen=True)
class Estimate:
    """The size of a plan; `contacts` is what would be solved if nothing were shared."""

    domains: tuple[str, ...]
    frames: int
    shards: int
    contacts: int
    solves: int
    solves_cached: int
    solve_core_s: float
    frame_core_s: float
    disk_bytes: float
    workers: int

    @property
    def wall_s(self) -> float:
        """Time if all workers are always busy."""
        return (self.solve_core_s + self.frame_core_s) / self.workers

    def __str__(self) -> str:
        ms, kilobytes = 1e3 * self.frame_core_s / self.frames, self.disk_bytes / self.frames / 1e3
        return "\n".join(
            [
                f"domains  {', '.join(self.domains)}",
                f"frames   {self.frames} in {self.shards} shards",
                f"solves   {self.solves} for {self.contacts} contacts, {self.solves_cached} already known",
                f"time     about {_duration(self.wall_s)} with {self.workers} workers: "
                f"{_duration(self.solve_core_s)} of a core to solve, {_duration(self.frame_core_s)} to render "
                f"({ms:.1f} ms per frame)",
                f"disk     about {self.disk_bytes / 1e6:.0f} MB ({kilobytes:.1f} kB per frame)",
            ]
        )


def estimate(recipes: Sequence[DomainRecipe], workers: int | None = None) -> Estimate:
    """Plan domains and estimate their cost; a few frames of each light are rendered for it.

    Raises
    ------
    ValueError
        If workers is below 1.
    """
    if workers is not None and workers < 1:
        raise ValueError(f"workers = {workers}: must be 1 or more")
    from gelgap.sim import load_solution

    plan = plan_generation(recipes)
    seconds, size = _frame_costs(plan)
    contacts = {
        (recipe.elastomer, pose)
        for recipe in recipes
        for pose in recipe.solved_path().poses
        if pose.depth_mm > 0
    }
    return Estimate(
        domains=tuple(recipe.name for recipe in recipes),
        frames=plan.frames,
        shards=sum(len(batch.recipes) for batch in plan.batches),
        contacts=len(contacts),
        solves=len(plan.solves),
        solves_cached=sum(load_solution(key) is not None for key in plan.solves),
        solve_core_s=sum(_solve_s(solve) for key, solve in plan.solves.items() if load_solution(key) is None),
        frame_core_s=seconds,
        disk_bytes=size,
        workers=workers or len(os.sched_getaffinity(0)),
    )


def _solve_s(solve: "Solve") -> float:
    """Return the expected seconds of a solve."""
    problem = solve.problem
    return SECONDS_PER_LOAD_STEP[problem.quality.name] * problem.load_steps


def _frame_costs(plan: GenerationPlan) -> tuple[float, float]:
    """Return seconds of one core and bytes for all frames of a plan, from a few frames of each kind of batch."""
    state = _dent()
    seconds = size = 0.0
    samples: dict[tuple[DomainRecipe, ...], tuple[float, float]] = {}
    for batch in plan.batches:
        if batch.recipes not in samples:
            matrices = [led_to_camera(recipe) for recipe in batch.recipes]
            # The first frame compiles and starts the renderer.
            samples[batch.recipes] = min(_frame_cost(batch.recipes, matrices, state) for _ in range(4))
        seconds += samples[batch.recipes][0] * len(batch)
        size += samples[batch.recipes][1] * len(batch)
    return seconds, size


def _frame_cost(
    recipes: Sequence[DomainRecipe], matrices: Sequence[np.ndarray], state: MembraneState
) -> tuple[float, float]:
    start = time.process_time()
    cells = [
        row
        for members in group_by_picture(recipes)
        for row in picture_cells([recipes[index] for index in members], matrices[members[0]], 0, state)
    ]
    seconds = time.process_time() - start
    size = sum(len(cell["bytes"]) for row in cells for cell in row.values() if isinstance(cell, dict))
    return seconds, size


def _dent() -> MembraneState:
    """Return a membrane that looks like a contact to the renderer; no physics."""
    x_mm, y_mm = grid_axes()
    distance2 = x_mm[None, :] ** 2 + y_mm[:, None] ** 2
    displacement = np.zeros((len(y_mm), len(x_mm), 3), np.float32)
    displacement[..., 2] = -0.6 * np.exp(-distance2)
    return MembraneState(x_mm, y_mm, displacement, distance2 < 0.5, np.zeros(3))


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
