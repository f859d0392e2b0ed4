"""How fast domains are made and read, and where their time goes, stage by stage."""

import cProfile
import inspect
import os
import pstats
import resource
import shutil
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import processor_s, show, write_json
from gelgap.domains import (
    DomainFolder,
    DomainRecipe,
    LabelledFrames,
    generate_recipes,
    make_recipes,
    open_domain,
    plan_generation,
    preset_recipes,
    shown_progress,
)
from gelgap.domains.formats.pictures import encode_png, without_markers
from gelgap.domains.formats.shards import encode_shard
from gelgap.domains.generation.shard import FrameBatch, render_batch
from gelgap.render import MembraneRenderer, imaging
from gelgap.render.surface import Membrane, shared_surface
from gelgap.sim import ContactPath, SolvePlan, load_solution

READING_SIZE_PX = 64
BATCH = 32
AIMS = "aims for the paper's four domains: 1200 s, 1500 MiB a worker, 3500 MB"
READING_AIMS = "aims: 150 frames/s from Parquet in order, 3000 by a DataLoader"
APART = ("mb0i0", "wmb0i0")
"""The domains whose frames are taken apart: two of the paper's, of one gel, the second with its dots inpainted."""
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
    """Measure generation and reading; print tables and write `throughput.json`.

    The full form makes the paper's four domains at standard quality; the quick one two small domains at draft quality,
    one solve per gel, with one worker.
    """
    folder = out_dir / "throughput"
    preset, quality = ("quick", "draft") if quick else ("paper", "standard")
    recipes, workers = recipes_of(preset, quality), 1 if quick else len(os.sched_getaffinity(0))
    shutil.rmtree(folder, ignore_errors=True)
    with patch.dict(os.environ, GELGAP_CACHE=str(folder / "solves")):
        generated = generation(recipes, folder / "data", workers)
    show(f"Generation of {preset} at {quality} quality, {workers} worker(s)", generated, AIMS)
    frames = open_domain(folder / "data" / recipes[0].name)
    show(f"Reading at {READING_SIZE_PX} px on one core", reading := reading_rates(frames), READING_AIMS)
    write_json(out_dir / "throughput.json", {"generation": generated, "reading": reading})


def recipes_of(preset: str, quality: str) -> tuple[DomainRecipe, ...]:
    """Return a preset's domains; "quick" are two of two gels with one shallow solve each, 100 frames a domain."""
    if preset != "quick":
        return preset_recipes(preset, quality=quality)
    directions = tuple(15.0 * k for k in range(24))
    path = ContactPath("quick", (-2.25, 2.25), (-1.3, 1.3), (0.2,), (0.1,), directions)
    return make_recipes(["mb0i0", "wmb1i1"], path, quality=quality)


def generation(recipes: Sequence[DomainRecipe], folder: Path, workers: int) -> pd.DataFrame:
    """Generate domains from nothing; return what this process and its workers took."""
    start, own_s = time.perf_counter(), time.process_time()
    with shown_progress() as progress:
        generate_recipes(recipes, folder, workers=workers, progress=progress)
    wall_s, own_s = time.perf_counter() - start, time.process_time() - own_s
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    manifests = [DomainFolder(folder / recipe.name).read_manifest() for recipe in recipes]
    frames = sum(manifest["frames"] for manifest in manifests)
    row = {
        "solves": len(plan_generation(recipes).solves),
        "frames": frames,
        "unconverged": sum(manifest["unconverged"] for manifest in manifests),
        "s": wall_s,
        "frames/s": frames / wall_s,
        "CPU share": (ended.ru_utime + ended.ru_stime) / (wall_s * workers),
        "client s": own_s,
        "MiB a worker": ended.ru_maxrss / 1024,
        "MB on disk": sum(entry["bytes"] for one in manifests for entry in one["files"].values()) / 1e6,
    }
    return pd.DataFrame([row])


def reading_rates(frames: LabelledFrames) -> pd.DataFrame:
    """Return the rates of reading pictures from Parquet, of building the cache and of loading batches from it."""
    import cv2
    import torch

    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    mixed, rates = np.random.default_rng(0).permutation(len(frames))[:300].tolist(), []
    for order, indices in (("in order", range(len(mixed))), ("random order", mixed)):
        taken_s = processor_s(lambda indices=indices: [frames.picture(i) for i in indices], 3)
        rates.append((f"Parquet, {order}, full size", len(mixed) / taken_s))
    rates.append(("building the cache", len(frames) / processor_s(lambda: frames.images(READING_SIZE_PX))))
    for pairing in ("channels", "stack", "difference"):
        loader, epochs = frames.torch(READING_SIZE_PX, pairing).loader(BATCH), max(1, 3000 // len(frames))
        work = partial(lambda batches, n: [deque(batches, maxlen=0) for _ in range(n)], loader, epochs)
        way = f"DataLoader from the cache, {pairing}, batches of {BATCH}"
        rates.append((way, epochs * len(frames) / processor_s(work, 3)))
    return pd.DataFrame(rates, columns=["way", "frames/s"])


def stages(quick: bool, out_dir: Path) -> None:
    """Solve what the paper's data set needs and take frames apart; print the time of each stage, write `stages.json`.

    The quick form is at draft quality, the full one at standard quality.
    """
    quality, folder = "draft" if quick else "standard", out_dir / "stages"
    shutil.rmtree(folder, ignore_errors=True)
    paper, apart = (
        plan_generation(preset_recipes("paper", quality=quality)),
        plan_generation(apart_recipes(quality)),
    )
    with patch.dict(os.environ, GELGAP_CACHE=str(folder / "solves")):
        solving_s = sum(processor_s(solve.run) for solve in paper.solves.values())
        for solve in apart.solves.values():
            solve.run()
        batch = apart.batches[0]
        both, plain = (stages_ms(one, folder) for one in (batch, replace(batch, recipes=batch.recipes[:1])))
    # Of the frames of both, every second one is inpainted.
    share = (
        2 * sum(len(one) for one in paper.batches for own in one.recipes if own.inpainted_from) / paper.frames
    )
    ms = {"solve": 1e3 * solving_s / paper.frames}
    ms |= {name: share * both[name] + (1 - share) * plain[name] for name in both}
    costs = pd.DataFrame({"ms per frame": ms}).rename_axis("stage")
    costs["s in all"] = 1e-3 * paper.frames * costs["ms per frame"]
    costs["share, %"] = 100 * costs["ms per frame"] / costs["ms per frame"].sum()
    show(
        f"Where the processor time of the paper's data set goes, {quality} quality",
        costs,
        f"{paper.frames} frames of 320×240 px, {costs['s in all'].sum():.0f} s. Frames: {' and '.join(APART)}, "
        "shares by the profiler, of the time without it.",
    )
    write_json(out_dir / "stages.json", {"stages": costs.reset_index()})


def apart_recipes(quality: str) -> tuple[DomainRecipe, ...]:
    """Return the domains that are taken apart, on a path of one depth and travel, which one solve serves."""
    x_mm, y_mm = np.linspace(-3.5, 3.5, 8), np.linspace(-2.1, 2.1, 2)
    directions = tuple(24.0 * k for k in range(15))
    path = ContactPath("apart", tuple(x_mm.tolist()), tuple(y_mm.tolist()), (0.2,), (0.1,), directions)
    return make_recipes(APART, path, quality=quality)


def stages_ms(batch: FrameBatch, folder: Path) -> dict[str, float]:
    """Return the ms per frame of each stage of a batch: shares by the profiler, of the time without it."""
    solutions = {key: load_solution(key) for key in batch.solve_keys}

    def work() -> None:
        for shard in render_batch(batch, solutions):
            (folder / shard.domain).mkdir(parents=True, exist_ok=True)
            DomainFolder(folder / shard.domain).write_file(shard.file, shard.data)

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
