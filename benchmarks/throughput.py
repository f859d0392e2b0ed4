"""How fast domains are made and read, and what sharing saves."""

import os
import resource
import shutil
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import Results, Setting, processor_s, run_missing, show, write_json
from gelgap.benchmarks.stages import rendering
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
from gelgap.sim import ContactPath, Solve

READING_SIZE_PX = 64
BATCH = 32
SAMPLE_FRAMES = 20
AIMS = "aims for the paper's four domains: 1200 s, 1500 MiB a worker, 3500 MB"
READING_AIMS = "aims: 150 frames/s from Parquet in order, 3000 by a DataLoader"
ALONE = "alone: extrapolated from one solve's time per load step and a few frames of each domain"


def run(quick: bool, out_dir: Path) -> None:
    """Measure generation and reading; print tables and write `throughput.json`.

    The full form makes the paper's four domains at standard quality, gel by gel; the quick one two small domains at
    draft quality, one solve per gel, with one worker. A benchmark that was stopped goes on with the next generation.
    """
    folder = out_dir / "throughput"
    preset, quality = ("quick", "draft") if quick else ("paper", "standard")
    recipes = recipes_of(preset, quality)
    by_gel: dict[str, list[str]] = {}
    for recipe in recipes:
        by_gel.setdefault(recipe.elastomer.model_dump_json(), []).append(recipe.name)
    about = {"preset": preset, "quality": quality}
    workers = 1 if quick else len(os.sched_getaffinity(0))
    settings = [about | {"domains": names, "workers": workers} for names in by_gel.values()]
    file = folder / "generation.jsonl"
    if not file.exists():
        shutil.rmtree(folder, ignore_errors=True)
    # One after the other, each in a process of its own, whose children are the workers.
    runs = run_missing(partial(generation, folder), settings, file, workers=1, tasks_per_worker=1)
    runs = runs.set_index(runs["domains"].map(" + ".join)).drop(columns=["domains", *about])
    whole = together(runs)
    show(f"Generation of {preset} at {quality} quality", pd.concat([runs, whole]), AIMS)
    shared_h = (whole["s"] * whole["workers"] * whole["CPU share"]).item() / 3600
    with patch.dict(os.environ, GELGAP_CACHE=str(folder / "solves")):
        alone = core_hours_alone(recipes)
    columns = ["solving", "rendering", "together", "over shared"]
    rows = [[*alone, sum(alone), sum(alone) / shared_h], [None, None, shared_h, 1.0]]
    ways = pd.Index(["each frame solved and rendered alone", "shared"], name="way")
    sharing = pd.DataFrame(rows, ways, columns)
    show("What sharing saved, hours of one core", sharing, ALONE)
    frames = open_domain(folder / "data" / recipes[0].name)
    show(f"Reading at {READING_SIZE_PX} px on one core", reading := reading_rates(frames), READING_AIMS)
    tables = {"generation": runs.reset_index(), "sharing": sharing, "reading": reading}
    write_json(out_dir / "throughput.json", tables)
    file.unlink()


def recipes_of(preset: str, quality: str) -> tuple[DomainRecipe, ...]:
    """Return a preset's domains; "quick" are two of two gels with one shallow solve each, 100 frames a domain."""
    if preset != "quick":
        return preset_recipes(preset, quality=quality)
    directions = tuple(15.0 * k for k in range(24))
    path = ContactPath("quick", (-2.25, 2.25), (-1.3, 1.3), (0.2,), (0.1,), directions)
    return make_recipes(["mb0i0", "wmb1i1"], path, quality=quality)


def generation(folder: Path, setting: Setting) -> Results:
    """Generate domains that share a gel, from nothing; this process and its workers are measured whole."""
    recipes = [r for r in recipes_of(setting["preset"], setting["quality"]) if r.name in setting["domains"]]
    with patch.dict(os.environ, GELGAP_CACHE=str(folder / "solves")):
        solves = plan_generation(recipes).solves
        # What a benchmark that was stopped has left.
        for key in solves:
            (folder / "solves" / f"{key}.solution").unlink(missing_ok=True)
        start, own_s = time.perf_counter(), time.process_time()
        with shown_progress() as progress:
            generate_recipes(
                recipes, folder / "data", workers=setting["workers"], progress=progress, overwrite=True
            )
        wall_s, own_s = time.perf_counter() - start, time.process_time() - own_s
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    manifests = [DomainFolder(folder / "data" / recipe.name).read_manifest() for recipe in recipes]
    frames = sum(manifest["frames"] for manifest in manifests)
    return {
        "solves": len(solves),
        "frames": frames,
        "s": wall_s,
        "frames/s": frames / wall_s,
        "CPU share": (ended.ru_utime + ended.ru_stime) / (wall_s * setting["workers"]),
        "client s": own_s,
        "MiB a worker": ended.ru_maxrss / 1024,
        "MB on disk": sum(entry["bytes"] for one in manifests for entry in one["files"].values()) / 1e6,
        "unconverged": sum(manifest["unconverged"] for manifest in manifests),
    }


def together(runs: pd.DataFrame) -> pd.DataFrame:
    """Return what several generations took one after another."""
    total = runs.agg({name: "max" if name in ("workers", "MiB a worker") else "sum" for name in runs})
    total["frames/s"] = total["frames"] / total["s"]
    total["CPU share"] = (runs["CPU share"] * runs["s"]).sum() / total["s"]
    index = pd.Index(["together, one after another"], name=runs.index.name)
    return pd.DataFrame([total], index).astype(runs.dtypes)


def core_hours_alone(recipes: Sequence[DomainRecipe]) -> tuple[float, float]:
    """Return the core hours of solving and of rendering each frame on its own, extrapolated from samples.

    A solve is sampled on the shallowest problem, uncached; a frame alone takes the load steps of its own contact.
    """
    problems = [solve.problem for solve in plan_generation(recipes).solves.values()]
    problem = min(problems, key=lambda problem: problem.depth_mm)
    step_s = processor_s(Solve(problem, cached=False).run) / problem.load_steps
    solving_s = rendering_s = 0.0
    for recipe in recipes:
        for pose in recipe.path.poses:
            ways = np.array([(0.0, 0.0, -pose.depth_mm), (pose.radius_mm, 0.0, 0.0)])
            solving_s += step_s * sum(problem.quality.load_steps(way) for way in ways if way.any())
        batch = plan_generation([recipe]).batches[0]
        sample = replace(batch, contacts=batch.contacts.part(0, SAMPLE_FRAMES))
        rendering_s += len(recipe.path.poses) * processor_s(rendering(sample), 3) / len(sample)
    return solving_s / 3600, rendering_s / 3600


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
