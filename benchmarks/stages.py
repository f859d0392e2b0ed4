"""Where the time of a data set goes, stage by stage, and how it scales."""

import cProfile
import inspect
import os
import pstats
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import processor_s, show, write_json
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
from gelgap.domains.generation.plan import FrameBatch, GenerationPlan
from gelgap.domains.generation.shard import render_batch
from gelgap.render import MembraneRenderer, imaging
from gelgap.render.surface import Membrane, shared_surface
from gelgap.sim import ContactPath, SolvePlan, load_solution

GEL_DOMAINS = ("mb0i0", "wmb0i0")
"""The domains whose frames are taken apart: two of the paper's, of one gel, the second with its dots inpainted."""
POINTS = {"small": (4, 1), "large": (8, 4)}
"""Columns and rows of contact points, 16 frames each, of a generation of one shard and of one of four."""
TABLED_WORKERS = (1, 2, 4, 8, 16, 32, 64)
REPEATS = 5
STAGES: dict[str, Sequence[Callable]] = {
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


def run(quick: bool, out_dir: Path) -> None:
    """Solve what the paper's data set needs, take frames apart, time one and two workers; write `stages.json`.

    The quick form is at draft quality, the full one at standard quality.
    """
    quality, folder = "draft" if quick else "standard", out_dir / "stages"
    shutil.rmtree(folder, ignore_errors=True)
    paper = plan_generation(preset_recipes("paper", quality=quality))
    small, large = (plan_generation(recipes_of(size, quality)) for size in POINTS)
    with patch.dict(os.environ, GELGAP_CACHE=str(folder / "solves")):
        for solve in large.solves.values():
            solve.run()
        solves_s = pd.Series([processor_s(solve.run) for solve in paper.solves.values()])
        costs = stage_costs(large.batches[0], paper, solves_s.sum(), folder / "frames")
        generated = []
        for plan, workers in ((small, 1), (large, 1), (large, 2)):
            wall_s, client_s = time.perf_counter(), time.process_time()
            generate_recipes(plan.recipes, folder / f"{plan.frames}-{workers}", workers=workers)
            wall_s, client_s = time.perf_counter() - wall_s, time.process_time() - client_s
            generated.append((plan.frames, workers, wall_s, client_s))
    show(
        f"Where the processor time of the paper's data set goes, {quality} quality",
        costs,
        f"{paper.frames} frames of 320×240 px, {costs['s in all'].sum():.0f} s. Frames: {' and '.join(GEL_DOMAINS)}, "
        "shares by the profiler, of the time without it.",
    )
    times = pd.DataFrame(generated, columns=["frames", "workers", "wall_s", "client_s"])
    title = f"Wall time by workers, {quality} quality"
    show(title, *scaling(times, paper.frames, solves_s))
    write_json(out_dir / "stages.json", {"stages": costs, "solves_s": solves_s.tolist(), "generated": times})


def recipes_of(size: str, quality: str) -> tuple[DomainRecipe, ...]:
    """Return the domains on a path of one depth and travel, which one solve serves."""
    columns, rows = POINTS[size]
    x_mm, y_mm = np.linspace(-3.5, 3.5, columns), np.linspace(-2.1, 2.1, rows)
    directions = tuple(24.0 * k for k in range(15))
    path = ContactPath(size, tuple(x_mm.tolist()), tuple(y_mm.tolist()), (0.2,), (0.1,), directions)
    return make_recipes(GEL_DOMAINS, path, quality=quality)


def rendering(batch: FrameBatch, folder: Path | None = None) -> Callable[[], None]:
    """Return what a worker does with a batch whose solves are known; its shards are written if there is a folder."""
    solutions = {key: load_solution(key) for key in batch.solve_keys}

    def work() -> None:
        for shard in render_batch(batch, solutions):
            if folder is not None:
                (folder / shard.domain).mkdir(parents=True, exist_ok=True)
                DomainFolder(folder / shard.domain).write_file(shard.file, shard.data)

    return work


def stage_costs(batch: FrameBatch, plan: GenerationPlan, solving_s: float, folder: Path) -> pd.DataFrame:
    """Return the ms per frame of each stage of a data set, and the time in it.

    The batch has two domains, of which the second is inpainted: it is made with both, and with the first alone.
    """
    both, plain = (stages_ms(one, folder) for one in (batch, replace(batch, recipes=batch.recipes[:1])))
    inpainted = sum(len(one) for one in plan.batches for recipe in one.recipes if recipe.inpainted_from)
    # Of the frames of both, every second one is inpainted.
    share = 2 * inpainted / plan.frames
    ms = {"solve": 1e3 * solving_s / plan.frames}
    ms |= {name: share * both[name] + (1 - share) * plain[name] for name in both}
    table = pd.DataFrame({"stage": list(ms), "ms per frame": ms.values()})
    table["s in all"] = 1e-3 * plan.frames * table["ms per frame"]
    table["share, %"] = 100 * table["ms per frame"] / table["ms per frame"].sum()
    return table


def stages_ms(batch: FrameBatch, folder: Path) -> dict[str, float]:
    """Return the ms per frame of each stage of a batch: shares by the profiler, of the time without it."""
    work = rendering(batch, folder)
    frame_ms = 1e3 * processor_s(work, REPEATS) / (len(batch) * len(batch.recipes))
    profiler = cProfile.Profile(time.process_time)
    profiler.runcall(work)
    stats: Any = pstats.Stats(profiler)
    shares = {}
    for name, functions in STAGES.items():
        codes = [inspect.unwrap(function).__code__ for function in functions]
        places = [(code.co_filename, code.co_firstlineno, code.co_name) for code in codes]
        shares[name] = sum(stats.stats[place][3] for place in places if place in stats.stats) / stats.total_tt
    shares["labels, rest"] = 1 - sum(shares.values())
    return {name: share * frame_ms for name, share in shares.items()}


def scaling(times: pd.DataFrame, frames: int, solves_s: pd.Series) -> tuple[pd.DataFrame, str]:
    """Return wall time by workers as measured, by a model fitted to it, and by the model for a data set, and a note.

    T(n) = start + max(longest solve, solves/n) + frames/n + client: the client's work on a frame none shares.
    """
    alone = times[times["workers"] == 1]
    few, many = alone["frames"].min(), alone["frames"].max()
    per_frame = alone.set_index("frames").sort_index().diff().iloc[-1] / (many - few)
    client_s, frame_s = per_frame["client_s"], per_frame["wall_s"] - per_frame["client_s"]
    start_s = alone.set_index("frames").loc[many, "wall_s"] - (frame_s + client_s) * many
    rows = pd.DataFrame({"workers": TABLED_WORKERS})
    measured = times[times["frames"] == many].set_index("workers")["wall_s"]
    rows[f"{many} frames measured, s"] = rows["workers"].map(measured)
    rows["by the model, s"] = start_s + (frame_s / rows["workers"] + client_s) * many
    solving_s = (solves_s.sum() / rows["workers"]).clip(lower=solves_s.max())
    rows["paper's data set by the model, s"] = (
        start_s + solving_s + (frame_s / rows["workers"] + client_s) * frames
    )
    rows["speed-up"] = rows.iloc[0, -1] / rows.iloc[:, -1]
    note = (
        "T(n) = start + max(longest solve, solves/n) + frames/n + client. Start, frames and client are fitted to "
        f"generations of {few} and {many} frames by one worker, with solves known; two workers test it. Paper's data "
        f"set: start {start_s:.1f}, solves {solves_s.sum():.0f}, the longest {solves_s.max():.0f}, frames "
        f"{frame_s * frames:.0f}, client {client_s * frames:.1f} s."
    )
    return rows, note
