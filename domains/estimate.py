"""What a generation will take: solves, frames, time and disk, before any of it is done."""

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gelgap.assets.names import comma_list
from gelgap.domains.frame_pictures import group_by_picture, led_to_camera, picture_cells
from gelgap.domains.plan import GenerationPlan, plan_generation
from gelgap.domains.recipe import DomainRecipe
from gelgap.domains.time_left import START_S, SolveSize, Workload, frame_core_s
from gelgap.sim import MembraneState, grid_axes, has_solution, known_pace, measured_pace

LOG = logging.getLogger(__name__)
# What a frame takes besides its pictures: the membrane, its table and Parquet, as shares of the pictures' own time.
FRAME_SHARE = 1.5


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
    longest_solve_s: float = 0.0
    busy: float = 1.0
    start_s: float = START_S

    @property
    def core_s(self) -> float:
        """Processor time of all processes; a start is this one's preparation, and then as much by each worker."""
        return self.start_s / 2 * (self.workers + 1) + self.solve_core_s + self.frame_core_s

    @property
    def wall_s(self) -> float:
        """Time on the machine as busy as it is now: one solve is not shared, frames are shared as shards."""
        solving_s = max(self.solve_core_s / self.workers, self.longest_solve_s)
        return self.busy * (
            self.start_s + solving_s + self.frame_core_s / min(self.workers, self.shards or 1)
        )

    def __str__(self) -> str:
        ms, kilobytes = 1e3 * self.frame_core_s / self.frames, self.disk_bytes / self.frames / 1e3
        return "\n".join(
            [
                f"domains  {comma_list(self.domains)}",
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
    LOG.info("planning and rendering sample frames of %s", comma_list([recipe.name for recipe in recipes]))
    plan = plan_generation(recipes)
    solves_s = [size.core_s for size in solve_sizes(plan, measured=True).values()]
    wall_start, core_start = time.perf_counter(), time.process_time()
    seconds, size = _frame_costs(plan)
    # On a busy machine a second of a core takes longer; the sample frames have just shown by how much.
    busy = (time.perf_counter() - wall_start) / max(time.process_time() - core_start, 1e-3)
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
        solves_cached=len(plan.solves) - len(solves_s),
        solve_core_s=sum(solves_s),
        longest_solve_s=max(solves_s, default=0.0),
        busy=max(1.0, busy),
        start_s=START_S * (known_pace().slowness or 1.0),
        frame_core_s=seconds,
        disk_bytes=size,
        workers=plan.processes(workers),
    )


def solve_sizes(plan: GenerationPlan, measured: bool = False) -> dict[str, SolveSize]:
    """Return how large each solve is that the cache lacks, by its key, and how long it takes by this machine's record.

    With `measured`, a machine that has no record yet solves one small press first.
    """
    problems = {key: solve.problem for key, solve in plan.solves.items() if not has_solution(key)}
    pace = measured_pace() if measured and problems else known_pace()
    return {key: SolveSize(problem.load_steps, pace.solve_s(problem)) for key, problem in problems.items()}


def workload(plan: GenerationPlan, workers: int | None, busy: float) -> Workload:
    """Return what a plan is expected to take on this machine, by its record; nothing is rendered for it."""
    slowness = known_pace().slowness or 1.0
    pixels = max((recipe.size_px[0] * recipe.size_px[1] for recipe in plan.recipes), default=0)
    return Workload(
        solves=solve_sizes(plan),
        frames=plan.frames,
        frame_core_s=frame_core_s(pixels, slowness),
        workers=workers,
        renderers=max(1, min(workers or 1, len(plan.batches))),
        start_s=START_S * slowness,
        busy=busy,
    )


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
    return FRAME_SHARE * seconds, size


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
