"""How fast domains are made and read, what sharing saves, and what a picture costs by PNG setting."""

import json
import os
import resource
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gelgap.benchmarks.common.stages import MIB, MemorySampler
from gelgap.benchmarks.common.tables import print_table, write_json
from gelgap.benchmarks.physics.cases import own_cache
from gelgap.domains import (
    DomainFolder,
    DomainRecipe,
    LabelledFrames,
    estimate,
    generate_recipes,
    open_domain,
    plan_generation,
    preset_recipes,
    shown_progress,
)
from gelgap.domains.generate import package_versions

READING_SIZE_PX = 64
BATCH = 32


@dataclass(frozen=True)
class GenerationRun:
    """One generation. `cpu_share` is the workers' CPU time over wall time times workers; `client_s` the client's own.

    `pieces` is 1 unless the benchmark was interrupted and taken up again, which costs another start of the workers.
    """

    what: str
    workers: int
    solves: int
    frames: int
    wall_s: float
    frames_per_s: float
    cpu_share: float
    client_s: float
    peak_mib_a_worker: float
    disk_mb: float
    unconverged: int
    pieces: int


@dataclass(frozen=True)
class Rate:
    """How many frames a second one way of reading gives on one core."""

    way: str
    frames_per_s: float
    aim: float | None


@dataclass(frozen=True)
class PngCost:
    """One PNG setting: kB and ms a frame to encode."""

    setting: str
    kilobytes: float
    encode_ms: float


def run(quick: bool, out_dir: Path) -> None:
    """Measure generation, reading and encoding; print tables and write `throughput.json`.

    The full form makes the paper's four domains at standard quality, gel by gel; the quick one the smoke data set at
    draft quality. Solves start from an empty cache of the benchmark's own. A run that was interrupted is taken up by
    the next one; one that ended is measured anew.
    """
    folder = Path(out_dir) / "throughput"
    preset, quality = ("smoke", "draft") if quick else ("paper", "standard")
    recipes = preset_recipes(preset, quality=quality)
    log = RunLedger(folder / "unfinished.json", [preset, quality, package_versions()])
    if not log.found:
        shutil.rmtree(folder, ignore_errors=True)
    with own_cache(folder / "solves"):
        if not log.found:
            print(f"planned:\n{estimate(recipes)}\n", flush=True)
        runs = [
            _generation(" + ".join(recipe.name for recipe in group), group, folder / "data", None, log)
            for group in _by_gel(recipes)
        ]
        light = [recipe.model_copy(update={"seed": 1}) for recipe in (recipes[:1] if quick else recipes[3:])]
        scaling = []
        for workers in (1, 2):
            what = f"{light[0].name} again, solves known, {workers} worker{'s'[: workers - 1]}"
            scaling.append(_generation(what, light, folder / f"workers-{workers}", workers, log))
        alone = _cost_alone(recipes)
    frames = open_domain(folder / "data" / recipes[0].name)
    rates = _reading_rates(frames)
    costs = _png_costs(frames)
    whole = _together(runs)
    columns = (
        "run",
        "workers",
        "solves",
        "frames",
        "s",
        "frames/s",
        "CPU share",
        "client s",
        "MiB a worker",
        "MB on disk",
        "unconverged",
        "pieces",
    )
    core_h = whole.wall_s * whole.workers * whole.cpu_share / 3600
    print_table(
        f"Generation of {preset} at {quality} quality",
        columns,
        [list(vars(row).values()) for row in (*runs, whole, *scaling)],
        note="aims for the paper's four domains: 1200 s, 1500 MiB a worker, 3500 MB",
    )
    print_table(
        "What sharing saved, hours of one core",
        ("way", "solving", "rendering", "together", "over shared"),
        [
            ["each frame solved and rendered alone", *alone, sum(alone), sum(alone) / core_h],
            ["shared", None, None, core_h, 1.0],
        ],
        note="alone: extrapolated from one solve's time a load step and a few frames of each domain",
    )
    print_table(
        f"Reading at {READING_SIZE_PX} px on one core",
        ("way", "frames/s", "aim"),
        [list(vars(row).values()) for row in rates],
    )
    print_table(
        f"PNG of a {frames.size_px[0]}×{frames.size_px[1]} frame with sensor noise",
        ("setting", "kB", "ms"),
        [list(vars(row).values()) for row in costs],
    )
    write_json(
        Path(out_dir) / "throughput.json",
        {
            "generation": [*runs, whole],
            "scaling": scaling,
            "reading": rates,
            "png": costs,
            "alone_core_h": alone,
            "shared_core_h": core_h,
        },
    )
    log.close()


def _by_gel(recipes: Sequence[DomainRecipe]) -> list[list[DomainRecipe]]:
    """Return the domains of each gel: they share solves, and where their light is the same, pictures."""
    groups: dict[str, list[DomainRecipe]] = {}
    for recipe in recipes:
        groups.setdefault(recipe.elastomer.model_dump_json(), []).append(recipe)
    return list(groups.values())


@dataclass
class _Taken:
    """What the pieces of one run have taken so far."""

    wall_s: float = 0.0
    worker_s: float = 0.0
    client_s: float = 0.0
    peak_bytes: int = 0
    solves: int = 0
    pieces: int = 0


class RunLedger:
    """What each run of the benchmark has taken, on disk, so that an interrupted benchmark can go on."""

    def __init__(self, path: Path, plan: Sequence[Any]):
        self._path, self._plan = path, json.loads(json.dumps(plan))
        self._taken: dict[str, dict[str, Any]] = {}
        try:
            stored = json.loads(path.read_text(encoding="utf-8"))
            self.found = stored["plan"] == self._plan
            self._taken = stored["taken"] if self.found else {}
        except (OSError, ValueError, KeyError):
            self.found = False

    def taken(self, what: str) -> _Taken:
        return _Taken(**self._taken.get(what, {}))

    def note(self, what: str, taken: _Taken) -> None:
        self._taken[what] = vars(taken)
        write_json(self._path, {"plan": self._plan, "taken": self._taken})

    def close(self) -> None:
        self._path.unlink(missing_ok=True)


def _generation(
    what: str, recipes: Sequence[DomainRecipe], out_dir: Path, workers: int | None, log: RunLedger
) -> GenerationRun:
    taken = log.taken(what)
    manifests = [DomainFolder(out_dir / recipe.name) for recipe in recipes]
    done = all(folder.exists() and folder.read_manifest()["complete"] for folder in manifests)
    if not (taken.pieces and done):
        taken.solves = max(taken.solves, len(plan_generation(recipes).solves))
        taken.pieces += 1
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        own_s, start = time.process_time(), time.perf_counter()
        sampler = MemorySampler()
        try:
            with sampler, shown_progress() as progress:
                generate_recipes(recipes, out_dir, workers=workers, progress=progress)
        finally:
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            taken.wall_s += time.perf_counter() - start
            taken.client_s += time.process_time() - own_s - sampler.own_s
            taken.worker_s += after.ru_utime + after.ru_stime - children.ru_utime - children.ru_stime
            taken.peak_bytes = max(taken.peak_bytes, sampler.peak_child_bytes)
            log.note(what, taken)
    count = workers or len(os.sched_getaffinity(0))
    manifest = [folder.read_manifest() for folder in manifests]
    frames = sum(one["frames"] for one in manifest)
    return GenerationRun(
        what=what,
        workers=count,
        solves=taken.solves,
        frames=frames,
        wall_s=taken.wall_s,
        frames_per_s=frames / taken.wall_s,
        cpu_share=taken.worker_s / (taken.wall_s * count),
        client_s=taken.client_s,
        peak_mib_a_worker=taken.peak_bytes / MIB,
        disk_mb=sum(entry["bytes"] for one in manifest for entry in one["files"].values()) / 1e6,
        unconverged=sum(one["unconverged"] for one in manifest),
        pieces=taken.pieces,
    )


def _together(runs: Sequence[GenerationRun]) -> GenerationRun:
    wall_s, frames = sum(run.wall_s for run in runs), sum(run.frames for run in runs)
    return GenerationRun(
        what="together, one after another",
        workers=runs[0].workers,
        solves=sum(run.solves for run in runs),
        frames=frames,
        wall_s=wall_s,
        frames_per_s=frames / wall_s,
        cpu_share=sum(run.cpu_share * run.wall_s for run in runs) / wall_s,
        client_s=sum(run.client_s for run in runs),
        peak_mib_a_worker=max(run.peak_mib_a_worker for run in runs),
        disk_mb=sum(run.disk_mb for run in runs),
        unconverged=sum(run.unconverged for run in runs),
        pieces=sum(run.pieces for run in runs),
    )


def _cost_alone(recipes: Sequence[DomainRecipe]) -> tuple[float, float]:
    """Return the core hours of solving and of rendering each frame on its own, extrapolated from samples.

    A solve is sampled on the shallowest problem, uncached; a frame alone takes the load steps of its own contact.
    """
    from gelgap.sim.indentation import solve

    problems = [solve.problem for solve in plan_generation(recipes).solves.values()]
    problem = min(problems, key=lambda problem: problem.depth_mm)
    start = time.process_time()
    solve(problem)
    step_s = (time.process_time() - start) / problem.load_steps
    ways = (
        [(0.0, 0.0, -pose.depth_mm), (pose.radius_mm, 0.0, 0.0)]
        for recipe in recipes
        for pose in recipe.path.poses
    )
    steps = sum(problem.quality.load_steps(np.array(way)) for both in ways for way in both if any(way))
    return step_s * steps / 3600, sum(estimate([recipe]).frame_core_s for recipe in recipes) / 3600


def _reading_rates(frames: LabelledFrames) -> list[Rate]:
    import cv2
    import torch

    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    count = min(len(frames), 300)
    order = np.random.default_rng(0).permutation(len(frames))[:count]
    rates = [
        Rate(
            "Parquet, in order, full size",
            _rate(lambda: [frames.picture(i) for i in range(count)], count),
            150,
        ),
        Rate(
            "Parquet, random order, full size",
            _rate(lambda: [frames.picture(int(i)) for i in order], count),
            None,
        ),
    ]
    start = time.process_time()
    frames.images(READING_SIZE_PX)
    rates.append(Rate("building the cache", len(frames) / (time.process_time() - start), None))
    for pairing in ("channels", "stack", "difference"):
        pairs = frames.torch(READING_SIZE_PX, pairing)
        loader = pairs.loader(BATCH)

        def epoch(loader=loader) -> None:
            for inputs, _, _ in loader:
                assert inputs.dtype == torch.float32

        repeats = max(1, 3000 // len(pairs))
        rate = _rate(
            lambda epoch=epoch, repeats=repeats: [epoch() for _ in range(repeats)], repeats * len(pairs)
        )
        rates.append(Rate(f"DataLoader from the cache, {pairing}, batches of {BATCH}", rate, 3000))
    return rates


def _rate(work: Callable[[], object], count: int) -> float:
    """Return the median rate of three runs, by CPU time: what one free core gives, however busy the machine is."""
    seconds = []
    for _ in range(3):
        start = time.process_time()
        work()
        seconds.append(time.process_time() - start)
    return count / float(np.median(seconds))


def _png_costs(frames: LabelledFrames) -> list[PngCost]:
    import cv2

    pictures = [
        np.ascontiguousarray(frames.picture(i)[..., ::-1]) for i in range(0, len(frames), len(frames) // 10)
    ]
    settings = {f"level {level}": [cv2.IMWRITE_PNG_COMPRESSION, level] for level in (0, 1, 3, 6, 9)}
    settings |= {
        f"level 1, {name}": [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, strategy]
        for name, strategy in {
            "run-length": cv2.IMWRITE_PNG_STRATEGY_RLE,
            "Huffman only (used)": cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY,
        }.items()
    }
    costs = []
    for name, setting in settings.items():
        sizes, times = [], []
        for picture in pictures:
            start = time.process_time()
            _, data = cv2.imencode(".png", picture, setting)
            times.append(time.process_time() - start)
            sizes.append(len(data))
        costs.append(PngCost(name, float(np.mean(sizes)) / 1e3, float(np.median(times)) * 1e3))
    return costs
