"""How fast domains are made and read; `python -m gelgap.benchmarks.throughput --table FILE` prints the tables again."""

import os
import resource
import shutil
import time
from collections import deque
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pandas as pd

from gelgap.adapt.result_table import ResultTable
from gelgap.benchmarks.common import print_tables, processor_s, read_records, write_records
from gelgap.data import LabelledFrames, open_domain
from gelgap.data.formats.domain_folder import DomainFolder
from gelgap.domains import DomainRecipe, generate_recipes, make_recipes, preset_recipes
from gelgap.domains.generation.plan import plan_generation
from gelgap.sim import ContactPath

READING_SIZE_PX = 64
BATCH = 32
AIMS = "aims for the paper's four domains: 1200 s, 1500 MiB a worker, 3500 MB"
READING_AIMS = "aims: 150 frames/s from Parquet in order, 3000 by a DataLoader"


def run(quick: bool, out_dir: Path) -> None:
    """Measure generation and reading; print tables and write `throughput.jsonl`.

    The full form makes the paper's four domains at standard quality; the quick one two small domains at draft quality,
    one solve per gel, with one worker.
    """
    folder = out_dir / "throughput"
    preset, quality = ("quick", "draft") if quick else ("paper", "standard")
    recipes, workers = recipes_of(preset, quality), 1 if quick else len(os.sched_getaffinity(0))
    shutil.rmtree(folder, ignore_errors=True)
    with patch.dict(os.environ, GELGAP_CACHE=str(folder / "solves")):
        generated = generation(recipes, folder / "data", workers)
    generated = generated.assign(of="generation", preset=preset, quality=quality, workers=workers)
    reading = reading_rates(open_domain(folder / "data" / recipes[0].name)).assign(of="reading")
    file = out_dir / "throughput.jsonl"
    write_records(file, pd.concat([generated, reading]), ("of", "preset", "quality", "workers", "way"))
    for table in tables(read_records(file)):
        table.show()


def tables(records: pd.DataFrame) -> list[ResultTable]:
    """Return what making and reading domains took."""
    found = []
    for name, note in (("generation", AIMS), ("reading", READING_AIMS)):
        own = (
            records[records["of"] == name].drop(columns="of").dropna(axis=1, how="all").reset_index(drop=True)
        )
        title = "Making domains" if name == "generation" else f"Reading at {READING_SIZE_PX} px on one core"
        found.append(ResultTable.of(title, own, note))
    return found


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
    generate_recipes(recipes, folder, workers=workers)
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


if __name__ == "__main__":
    print_tables(__doc__, tables)
