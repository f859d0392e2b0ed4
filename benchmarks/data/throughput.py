"""How fast domains are made and read, what sharing saves, and what a picture costs by PNG setting."""

import os
import resource
import shutil
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.benchmarks.common.memory import MIB, MemorySampler
from gelgap.benchmarks.common.records import Ledger
from gelgap.benchmarks.common.tables import write_json
from gelgap.benchmarks.physics.cases import own_cache
from gelgap.domains import (
    DomainFolder,
    DomainRecipe,
    LabelledFrames,
    estimate,
    generate_recipes,
    make_recipes,
    open_domain,
    package_versions,
    plan_generation,
    preset_recipes,
    shown_progress,
)
from gelgap.domains.formats.pictures import encode_png

READING_SIZE_PX = 64
BATCH = 32
AIMS = "aims for the paper's four domains: 1200 s, 1500 MiB a worker, 3500 MB"


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


GENERATION_COLUMNS = (
    *("run", "workers", "solves", "frames", "s", "frames/s", "CPU share", "client s"),
    *("MiB a worker", "MB on disk", "unconverged", "pieces"),
)


@dataclass(frozen=True)
class Piece:
    """What a generation took until it ended or was interrupted."""

    solves: int
    wall_s: float
    worker_s: float
    client_s: float
    peak_bytes: int


@dataclass(frozen=True)
class Rate:
    """Frames per second of one way of reading, on one core."""

    way: str
    frames_per_s: float
    aim: float | None = None


@dataclass(frozen=True)
class PngCost:
    """One PNG setting: kB and ms per frame to encode."""

    setting: str
    kilobytes: float
    encode_ms: float


def run(quick: bool, out_dir: Path) -> None:
    """Measure generation, reading and encoding; print tables and write `throughput.json`.

    The full form makes the paper's four domains at standard quality, gel by gel; the quick one two small domains at
    draft quality, one solve per gel, with one worker. Solves start from an empty cache of the benchmark's
    own. What a stopped benchmark has measured is kept, and its generation goes on, until one has ended; the next one
    measures anew.
    """
    folder = out_dir / "throughput"
    name, quality = ("quick", "draft") if quick else ("paper", "standard")
    recipes = quick_recipes() if quick else preset_recipes(name, quality=quality)
    ledger = Ledger(folder / "unfinished.jsonl", [name, quality, package_versions()])
    if not ledger.found:
        shutil.rmtree(folder, ignore_errors=True)
    with own_cache(folder / "solves"):
        if not ledger.found:
            print(f"planned:\n{estimate(recipes)}\n", flush=True)
        runs = [
            generation(
                " + ".join(r.name for r in group), group, folder / "data", 1 if quick else None, ledger
            )
            for group in by_gel(recipes)
        ]
        again = [recipe.model_copy(update={"seed": 1}) for recipe in recipes[3:]]
        scaling = []
        for workers in () if quick else (1, 2):
            what = f"{again[0].name} again, solves known, {workers} worker{'s'[: workers - 1]}"
            scaling.append(generation(what, again, folder / f"workers-{workers}", workers, ledger))
        whole = together(runs)
        rows = [astuple(row) for row in (*runs, whole, *scaling)]
        ResultTable(f"Generation of {name} at {quality} quality", GENERATION_COLUMNS, rows, AIMS).show()
        alone = ledger.once("alone", tuple[float, float], lambda: core_hours_alone(recipes))
    core_h = whole.wall_s * whole.workers * whole.cpu_share / 3600
    sharing_table(alone, core_h).show()
    frames = open_domain(folder / "data" / recipes[0].name)
    rates = ledger.once("reading", list[Rate], lambda: reading_rates(frames))
    title = f"Reading at {READING_SIZE_PX} px on one core"
    ResultTable(title, ("way", "frames/s", "aim"), [astuple(rate) for rate in rates]).show()
    costs = ledger.once("png", list[PngCost], lambda: png_costs(frames))
    title = f"PNG of a {frames.size_px[0]}×{frames.size_px[1]} frame with sensor noise"
    ResultTable(title, ("setting", "kB", "ms"), [astuple(cost) for cost in costs]).show()
    found = {"generation": [*runs, whole], "scaling": scaling, "reading": rates, "png": costs}
    write_json(out_dir / "throughput.json", found | {"alone_core_h": alone, "shared_core_h": core_h})
    ledger.close()


def quick_recipes() -> tuple[DomainRecipe, ...]:
    """Return two domains of two gels with one shallow solve each, 100 frames a domain."""
    from gelgap.sim import ContactPath

    directions = tuple(15.0 * k for k in range(24))
    path = ContactPath("quick", (-2.25, 2.25), (-1.3, 1.3), (0.2,), (0.1,), directions)
    return make_recipes(["mb0i0", "wmb1i1"], path, quality="draft")


def by_gel(recipes: Sequence[DomainRecipe]) -> list[list[DomainRecipe]]:
    """Return the domains of each gel: they share solves, and where their light is the same, pictures."""
    groups: dict[str, list[DomainRecipe]] = {}
    for recipe in recipes:
        groups.setdefault(recipe.elastomer.model_dump_json(), []).append(recipe)
    return list(groups.values())


def generation(
    what: str, recipes: Sequence[DomainRecipe], out_dir: Path, workers: int | None, ledger: Ledger
) -> GenerationRun:
    """Generate what is missing of some domains and return what all pieces of the generation took together."""
    folders = [DomainFolder(out_dir / recipe.name) for recipe in recipes]
    done = all(folder.exists() and folder.read_manifest()["complete"] for folder in folders)
    if not (done and ledger.values(what, Piece)):
        _generate_piece(what, recipes, out_dir, workers, ledger)
    pieces = ledger.values(what, Piece)
    count = workers or len(os.sched_getaffinity(0))
    manifests = [folder.read_manifest() for folder in folders]
    frames = sum(manifest["frames"] for manifest in manifests)
    wall_s = sum(piece.wall_s for piece in pieces)
    return GenerationRun(
        what=what,
        workers=count,
        solves=max(piece.solves for piece in pieces),
        frames=frames,
        wall_s=wall_s,
        frames_per_s=frames / wall_s,
        cpu_share=sum(piece.worker_s for piece in pieces) / (wall_s * count),
        client_s=sum(piece.client_s for piece in pieces),
        peak_mib_a_worker=max(piece.peak_bytes for piece in pieces) / MIB,
        disk_mb=sum(entry["bytes"] for manifest in manifests for entry in manifest["files"].values()) / 1e6,
        unconverged=sum(manifest["unconverged"] for manifest in manifests),
        pieces=len(pieces),
    )


def _generate_piece(
    what: str, recipes: Sequence[DomainRecipe], out_dir: Path, workers: int | None, ledger: Ledger
) -> None:
    """Generate until all is there or the benchmark is interrupted, and note what it took in either case."""
    solves = len(plan_generation(recipes).solves)
    before, own_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.process_time()
    start, sampler = time.perf_counter(), MemorySampler()
    try:
        with sampler, shown_progress() as progress:
            generate_recipes(recipes, out_dir, workers=workers, progress=progress)
    finally:
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        piece = Piece(
            solves=solves,
            wall_s=time.perf_counter() - start,
            worker_s=after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
            client_s=time.process_time() - own_s - sampler.own_s,
            peak_bytes=sampler.peak_child_bytes,
        )
        ledger.note(what, piece)


def together(runs: Sequence[GenerationRun]) -> GenerationRun:
    """Return what several generations took one after another."""
    total = {
        name: sum(getattr(run, name) for run in runs)
        for name in ("solves", "frames", "wall_s", "client_s", "disk_mb", "unconverged", "pieces")
    }
    return GenerationRun(
        what="together, one after another",
        workers=runs[0].workers,
        frames_per_s=total["frames"] / total["wall_s"],
        cpu_share=sum(run.cpu_share * run.wall_s for run in runs) / total["wall_s"],
        peak_mib_a_worker=max(run.peak_mib_a_worker for run in runs),
        **total,
    )


def core_hours_alone(recipes: Sequence[DomainRecipe]) -> tuple[float, float]:
    """Return the core hours of solving and of rendering each frame on its own, extrapolated from samples.

    A solve is sampled on the shallowest problem, uncached; a frame alone takes the load steps of its own contact.
    """
    from gelgap.sim.newton import solve

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


def sharing_table(alone_h: tuple[float, float], shared_h: float) -> ResultTable:
    """Return the core hours of solving and rendering every frame alone, beside those with shared solves."""
    total_h = sum(alone_h)
    return ResultTable(
        "What sharing saved, hours of one core",
        ("way", "solving", "rendering", "together", "over shared"),
        [
            ["each frame solved and rendered alone", *alone_h, total_h, total_h / shared_h],
            ["shared", None, None, shared_h, 1.0],
        ],
        "alone: extrapolated from one solve's time per load step and a few frames of each domain",
    )


def reading_rates(frames: LabelledFrames) -> list[Rate]:
    """Return the rates of reading pictures from Parquet, of building the cache and of loading batches from it."""
    import cv2
    import torch

    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    count = min(len(frames), 300)
    order = np.random.default_rng(0).permutation(len(frames))[:count].tolist()
    in_order = _rate(lambda: [frames.picture(i) for i in range(count)], count)
    at_random = _rate(lambda: [frames.picture(i) for i in order], count)
    rates = [
        Rate("Parquet, in order, full size", in_order, 150),
        Rate("Parquet, random order, full size", at_random),
    ]
    start = time.process_time()
    frames.images(READING_SIZE_PX)
    rates.append(Rate("building the cache", len(frames) / (time.process_time() - start)))
    for pairing in ("channels", "stack", "difference"):
        loader = frames.torch(READING_SIZE_PX, pairing).loader(BATCH)
        epochs = max(1, 3000 // len(frames))
        rate = _rate(
            lambda n=epochs, batches=loader: [deque(batches, maxlen=0) for _ in range(n)],
            epochs * len(frames),
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


def png_costs(frames: LabelledFrames) -> list[PngCost]:
    """Return mean size and median time of encoding some of the frames, by PNG setting."""
    import cv2

    some = range(0, len(frames), len(frames) // 10)
    pictures = [frames.picture(i) for i in some]
    level, strategy = cv2.IMWRITE_PNG_COMPRESSION, cv2.IMWRITE_PNG_STRATEGY
    settings = {f"OpenCV, level {value}": [level, value] for value in (0, 1, 3, 6, 9)} | {
        "OpenCV, run-length": [level, 1, strategy, cv2.IMWRITE_PNG_STRATEGY_RLE],
        "OpenCV, Huffman only": [level, 1, strategy, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY],
    }
    coders: dict[str, Callable[[np.ndarray], bytes]] = {
        name: lambda picture, own=own: cv2.imencode(".png", picture[..., ::-1], own)[1].tobytes()
        for name, own in settings.items()
    } | {"Huffman only, average filter (used)": encode_png}
    costs = []
    for name, encode in coders.items():
        sizes, times = [], []
        for picture in pictures:
            start = time.process_time()
            data = encode(picture)
            times.append(time.process_time() - start)
            sizes.append(len(data))
        costs.append(PngCost(name, float(np.mean(sizes)) / 1e3, float(np.median(times)) * 1e3))
    return costs
