"""Where the time of a data set goes, stage by stage, beside the least that each could take; and how it scales."""

import cProfile
import inspect
import pstats
import shutil
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.benchmarks.common.tables import write_json
from gelgap.benchmarks.physics.cases import own_cache
from gelgap.benchmarks.render.speed import median_ms
from gelgap.domains import (
    DomainFolder,
    DomainRecipe,
    generate_recipes,
    make_recipes,
    plan_generation,
    preset_recipes,
)
from gelgap.domains.formats.pictures import encode_png, without_markers
from gelgap.domains.formats.shards import encode_shard
from gelgap.domains.generation.plan import GenerationPlan
from gelgap.domains.generation.shard import FrameBatch, render_batch
from gelgap.render import MembraneRenderer, imaging
from gelgap.render.surface import Membrane, shared_surface
from gelgap.sim import ContactPath, SolvePlan, load_solution

GEL_DOMAINS = ("mb0i0", "wmb0i0")
"""The domains whose frames are taken apart: two of the paper's, of one gel, the second with its dots inpainted."""
POINTS = {"small": (4, 1), "large": (8, 4)}
"""Columns and rows of contact points, 16 frames each, of a generation of one shard and of one of four."""
TABLED_WORKERS = (1, 2, 4, 8, 16, 32, 64)
REPEATS = 5
STAGES: Mapping[str, Sequence[Callable]] = {
    "membrane": (SolvePlan.state, Membrane.displacement_on),
    "light": (MembraneRenderer._radiance, shared_surface),
    "raster": (MembraneRenderer._geometry,),
    "pixels and dots": (MembraneRenderer._gather, MembraneRenderer._paint_markers),
    "noise": (imaging.sensor_noise,),
    "8 bits": (imaging.encode,),
    "inpainting": (without_markers,),
    "PNG": (encode_png,),
    "Parquet": (encode_shard,),
    "write": (DomainFolder.write_file,),
}
"""What each stage of a frame is made of: functions, none of which calls another of them."""


@dataclass(frozen=True)
class StageCost:
    """Processor time of one stage, ms per frame; `floor_ms` is what `floor` alone takes on this machine."""

    stage: str
    ms: float
    share: float
    floor_ms: float | None
    floor: str


@dataclass(frozen=True)
class SolveCost:
    """One small solve: seconds of a core, load steps, and Newton iterations, each of which factorises once or more."""

    core_s: float
    load_steps: int
    iterations: int


@dataclass(frozen=True)
class Scaling:
    """What n workers take of wall time: T(n) = start + max(longest solve, solves/n) + frames/n + client, in seconds.

    `frames_s` is the workers' time for all frames, `client_s` the client's, which none shares.
    """

    start_s: float
    frames_s: float
    client_s: float
    solves_s: float = 0.0
    longest_solve_s: float = 0.0

    def wall_s(self, workers: int) -> float:
        """Return T(workers)."""
        solving_s = max(self.longest_solve_s, self.solves_s / workers)
        return self.start_s + solving_s + self.frames_s / workers + self.client_s


@dataclass(frozen=True)
class Generated:
    """One generation whose solves were known: its wall time and the client's own processor time, s."""

    frames: int
    workers: int
    wall_s: float
    client_s: float


def run(quick: bool, out_dir: Path) -> None:
    """Take the frames of one small solve apart, time one and two workers, print tables and write `stages.json`.

    The quick form is at draft quality, the full one at standard quality.
    """
    quality, folder = "draft" if quick else "standard", out_dir / "stages"
    shutil.rmtree(folder, ignore_errors=True)
    paper = plan_generation(preset_recipes("paper", quality=quality))
    with own_cache(folder / "solves"):
        small, large = (plan_generation(recipes_of(size, quality)) for size in POINTS)
        solve = small_solve(large)
        costs = frame_costs(large.batches[0], inpainted_share(paper), folder / "frames")
        one = [generated(plan, folder / f"{plan.frames}-frames", 1) for plan in (small, large)]
        two = generated(large, folder / "two-workers", 2)
    alone = fitted(*one)
    stage_table(costs, solve, paper, quality).show()
    scaling_table(alone, [*one, two], paper, quality).show()
    write_json(out_dir / "stages.json", {"frame": costs, "solve": solve, "generated": [*one, two]})


def recipes_of(size: str, quality: str) -> tuple[DomainRecipe, ...]:
    """Return the domains on a path of one depth and travel, which one solve serves."""
    columns, rows = POINTS[size]
    x_mm, y_mm = np.linspace(-3.5, 3.5, columns), np.linspace(-2.1, 2.1, rows)
    directions = tuple(24.0 * k for k in range(15))
    path = ContactPath(size, tuple(x_mm.tolist()), tuple(y_mm.tolist()), (0.2,), (0.1,), directions)
    return make_recipes(GEL_DOMAINS, path, quality=quality)


def small_solve(plan: GenerationPlan) -> SolveCost:
    """Solve what a plan of one solve needs, into the cache, and return its cost."""
    (solve,) = plan.solves.values()
    start = time.process_time()
    solution = solve.run()
    core_s = time.process_time() - start
    iterations = sum(record.diagnostics.iterations for record in solution.records)
    return SolveCost(core_s, solve.problem.load_steps, iterations)


def inpainted_share(plan: GenerationPlan) -> float:
    """Return the share of a plan's frames that are inpainted."""
    by_recipe = [(recipe, len(batch)) for batch in plan.batches for recipe in batch.recipes]
    return sum(frames for recipe, frames in by_recipe if recipe.inpainted_from) / plan.frames


def frame_costs(batch: FrameBatch, inpainted: float, folder: Path) -> list[StageCost]:
    """Return what each stage of a labelled frame takes, if a share of the frames is `inpainted`.

    The batch has two domains, of which the second is inpainted: it is made with both, and with the first alone.
    """
    both, plain = (stages_ms(one, folder) for one in (batch, replace(batch, recipes=batch.recipes[:1])))
    # Of the frames of both, every second one is inpainted.
    ms = {name: 2 * inpainted * both[name] + (1 - 2 * inpainted) * plain[name] for name in both}
    floors, total_ms = floors_ms(batch.recipes[0], folder), sum(ms.values())
    return [
        StageCost(name, value, value / total_ms, *floors.get(name, (None, "–"))) for name, value in ms.items()
    ]


def stages_ms(batch: FrameBatch, folder: Path) -> dict[str, float]:
    """Return the ms per frame of each stage of a batch: shares by the profiler, of the time without it."""
    solutions = {key: load_solution(key) for key in batch.solve_keys}

    def work() -> None:
        for shard in render_batch(batch, solutions):
            (folder / shard.domain).mkdir(parents=True, exist_ok=True)
            DomainFolder(folder / shard.domain).write_file(shard.file, shard.data)

    frame_ms = median_ms(work, REPEATS, time.process_time) / (len(batch) * len(batch.recipes))
    profiler = cProfile.Profile(time.process_time)
    profiler.runcall(work)
    stats = pstats.Stats(profiler)
    shares = {name: _share(stats, functions) for name, functions in STAGES.items()}
    shares["labels, rest"] = 1 - sum(shares.values())
    return {name: share * frame_ms for name, share in shares.items()}


def _share(stats: pstats.Stats, functions: Sequence[Callable]) -> float:
    """Return the share of the whole time that some functions took with all that they call."""
    found_s = 0.0
    for function in functions:
        code = inspect.unwrap(function).__code__
        place = code.co_filename, code.co_firstlineno, code.co_name
        _, _, _, cumulative_s, _ = stats.stats.get(place, (0, 0, 0.0, 0.0, {}))
        found_s += cumulative_s
    return found_s / stats.total_tt


def floors_ms(recipe: DomainRecipe, folder: Path) -> dict[str, tuple[float, str]]:
    """Return the least time per frame of stages, ms, and of what: one pass of one library over the same numbers."""
    renderer = MembraneRenderer(recipe.sensor, recipe.illumination, recipe.size_px, recipe.render_quality)
    lattice, (width, height) = renderer.lattice, recipe.size_px
    grid = np.ones((lattice.rows, lattice.columns, 3), np.float32)
    light = np.ones((len(recipe.illumination.leds), lattice.rows, lattice.columns), np.float32)
    pixels = np.ones((height, width, 3), np.float32)
    rng = np.random.default_rng(0)
    raw = rng.bytes(pixels.size)
    packed = raw[: len(raw) // 3]  # what compression leaves
    file = folder / "floor"
    work: dict[str, tuple[Callable[[], object], str]] = {
        "membrane": (grid.copy, "copying three numbers for each vertex"),
        "light": (lambda: light * light + light, "a product and a sum for each vertex and LED"),
        "raster": (pixels.copy, "copying three numbers for each pixel"),
        "pixels and dots": (pixels.copy, "copying three numbers for each pixel"),
        "noise": (lambda: rng.bytes(pixels.size), "a random byte for each pixel and colour"),
        "8 bits": (lambda: pixels.astype(np.uint8), "rounding three numbers for each pixel"),
        "PNG": (lambda: (zlib.crc32(raw), zlib.adler32(raw)), "its two checksums of the picture"),
        "Parquet": (lambda: bytearray(raw), "copying the bytes of the picture"),
        "write": (lambda: file.write_bytes(packed), "giving the bytes of the file to the system"),
    }
    return {name: (median_ms(job, REPEATS, time.process_time), what) for name, (job, what) in work.items()}


def generated(plan: GenerationPlan, folder: Path, workers: int) -> Generated:
    """Generate a plan's domains, whose solves are known."""
    wall_s, client_s = time.perf_counter(), time.process_time()
    generate_recipes(plan.recipes, folder, workers=workers)
    return Generated(plan.frames, workers, time.perf_counter() - wall_s, time.process_time() - client_s)


def fitted(small: Generated, large: Generated) -> Scaling:
    """Return the scaling of the larger of two generations by one worker each, from what more frames took."""
    more = large.frames - small.frames
    frame_s, client_s = (large.wall_s - small.wall_s) / more, (large.client_s - small.client_s) / more
    return Scaling(
        start_s=large.wall_s - frame_s * large.frames,
        frames_s=(frame_s - client_s) * large.frames,
        client_s=client_s * large.frames,
    )


def of_plan(alone: Scaling, frames: int, plan: GenerationPlan) -> Scaling:
    """Return the scaling of another plan, with the solves that it needs."""
    times = plan.frames / frames
    solves_s = [solve.expected_core_s for solve in plan.solves.values()]
    return Scaling(
        alone.start_s, times * alone.frames_s, times * alone.client_s, sum(solves_s), max(solves_s)
    )


def stage_table(
    costs: Sequence[StageCost], solve: SolveCost, plan: GenerationPlan, quality: str
) -> ResultTable:
    """Each stage's time per frame and in the whole data set, beside its floor."""
    solves_s = sum(one.expected_core_s for one in plan.solves.values())
    total_s = solves_s + 1e-3 * plan.frames * sum(cost.ms for cost in costs)
    least = solve.load_steps / solve.iterations
    rows = [
        [
            *("solve", 1e3 * solves_s / plan.frames, solves_s, 100 * solves_s / total_s),
            *(1e3 * least * solves_s / plan.frames, 1 / least, "one Newton iteration for each load step"),
        ]
    ]
    for cost in costs:
        stage_s = 1e-3 * plan.frames * cost.ms
        times = None if cost.floor_ms is None else cost.ms / cost.floor_ms
        rows.append([cost.stage, cost.ms, stage_s, 100 * stage_s / total_s, cost.floor_ms, times, cost.floor])
    return ResultTable(
        f"Where the processor time of the paper's data set goes, {quality} quality",
        ["stage", "ms per frame", "s in all", "share, %", "floor, ms per frame", "times the floor", "floor"],
        rows,
        f"{plan.frames} frames of 320×240 px, {total_s:.0f} s. Frames: {' and '.join(GEL_DOMAINS)}, shares by the "
        f"profiler, of the time without it. Solves: {len(plan.solves)}, by this machine's record of past ones; a small "
        f"one took {solve.iterations} iterations for {solve.load_steps} load steps in {solve.core_s:.1f} s. "
        "A floor is the least that the stage must do, done here by one call of a library.",
    )


def scaling_table(
    alone: Scaling, generations: Sequence[Generated], plan: GenerationPlan, quality: str
) -> ResultTable:
    """Wall time by workers: measured, by the model, and by the model for the paper's data set."""
    large = max(generations, key=lambda one: one.frames).frames
    paper, measured = (
        of_plan(alone, large, plan),
        {g.workers: g.wall_s for g in generations if g.frames == large},
    )
    rows = [
        [
            *(workers, measured.get(workers), alone.wall_s(workers), paper.wall_s(workers)),
            *(paper.wall_s(1) / paper.wall_s(workers),),
        ]
        for workers in TABLED_WORKERS
    ]
    return ResultTable(
        f"Wall time by workers, {quality} quality",
        [
            "workers",
            f"{large} frames measured, s",
            "by the model, s",
            "paper's data set by the model, s",
            "speed-up",
        ],
        rows,
        "T(n) = start + max(longest solve, solves/n) + frames/n + client. Start, frames and client are fitted to "
        f"generations of {min(g.frames for g in generations)} and {large} frames by one worker, with solves known; two "
        f"workers test it. Paper's data set: start {paper.start_s:.1f}, solves {paper.solves_s:.0f}, the longest "
        f"{paper.longest_solve_s:.0f}, frames {paper.frames_s:.0f}, client {paper.client_s:.1f} s.",
    )
