"""Training speed: steps per second beside a plain PyTorch loop, waiting for data, cost of each loss."""

import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.study import Part, Study
from gelgap.benchmarks.common import Results, Setting, read_records, result_table, run_missing

if TYPE_CHECKING:
    from gelgap.adapt import Profile
    from gelgap.domains import ArrayFrames

PLAIN, STAGE_1 = "plain PyTorch, source regression", "stage 1"
STAGE_2 = "stage 2, "
BASE = "supervised"
"""Two regressions: a step through both domains whose loss costs nothing."""
METHODS = (BASE, "no-transfer", "dsan", "dann", "daregram", "coral", "dan", "rsd")
RECORD = "speed.jsonl"
FRAMES, EPOCHS, REPEATS = 256, 3, 3
QUICK = METHODS[:3], 64, 1
"""Methods, frames of noise and turns of all loops in the quick form."""


def measure(study: Study) -> None:
    """Time all loops in turns, anew in each call."""
    from gelgap.adapt import Profile

    methods, count, repeats = QUICK if study.is_quick else (METHODS, FRAMES, REPEATS)
    profile = Profile.preset(study.profile)
    loops = [PLAIN, STAGE_1, *map(STAGE_2.__add__, methods)]
    grid = [{"loop": loop, "turn": turn} for turn in range(repeats) for loop in loops]
    time_one = partial(time_loop, random_frames(profile, count), profile)
    time_one(grid[0])  # warm up
    (study.out / RECORD).unlink(missing_ok=True)
    run_missing(time_one, grid, study.out / RECORD, workers=1)


def time_loop(frames: "ArrayFrames", profile: "Profile", setting: Setting) -> Results:
    """Return the median time of a step, ms, the share of it that waits for data, and the loop's processor time, s."""
    from gelgap.adapt import adapt, train_source
    from gelgap.adapt.trainer import untrained

    loop = setting["loop"]
    profile = profile.replace(
        **{"source_epochs": EPOCHS, "adapt_epochs": EPOCHS, "colour_mixing": 0.0},
        **{"transfer_weight": 1e-6, "transfer_warmup": 0.0, "transfer_ramp": 0.0},
    )
    started = time.process_time()
    if loop == PLAIN:
        history = list(plain_loop(frames, profile))
    elif loop.startswith(STAGE_2):
        method = loop.removeprefix(STAGE_2)
        history = adapt(untrained(frames, profile, 0), frames, frames, method, profile).history
    else:
        history = train_source(frames, profile).history
    processor_s, epochs = time.process_time() - started, pd.DataFrame(history)
    return {
        "step_ms": 1e3 * epochs["wall_s"].median() / (len(frames) // profile.batch_size),
        "wait_share": (epochs["wait_s"] / epochs["wall_s"]).median(),
        "processor_s": processor_s,
    }


def random_frames(profile: "Profile", count: int) -> "ArrayFrames":
    """Return frames of noise at the profile's size: speed does not depend on what they show."""
    from gelgap.domains import ArrayFrames

    rng = np.random.default_rng(0)
    width, height = profile.image_size_px
    return ArrayFrames(
        name="noise",
        images=rng.integers(0, 256, (count, height, width, 3), dtype=np.uint8),
        reference=np.full((height, width, 3), 128, np.uint8),
        force_n=rng.uniform([-0.7, -0.7, -3], [0.7, 0.7, 0], (count, 3)).astype(np.float32),
        contact_class=rng.integers(0, 361, count),
        point_id=rng.integers(0, 30, count),
    )


def plain_loop(frames: "ArrayFrames", profile: "Profile") -> Iterator[dict[str, float]]:
    """Train the same network on the same batches by the shortest PyTorch loop; yield the time of each epoch, s."""
    import torch
    from torch.nn import functional

    from gelgap.adapt import make_network
    from gelgap.adapt.data import network_inputs, normalised_labels
    from gelgap.adapt.network import torch_threads

    network = make_network(profile, 361, 0)
    pictures = network_inputs(frames, profile, "cpu")
    force = torch.from_numpy(normalised_labels(frames))
    optimizer = torch.optim.SGD(network.parameters(), lr=0.01, momentum=0.9, weight_decay=5e-4)
    network.train()
    with torch_threads(profile.threads):
        for _ in range(EPOCHS):
            rows = torch.randperm(len(frames))[: len(frames) // profile.batch_size * profile.batch_size]
            start = time.perf_counter()
            for batch in rows.split(profile.batch_size):
                optimizer.zero_grad(set_to_none=True)
                functional.mse_loss(network(pictures.inputs(batch)), force[batch]).backward()
                optimizer.step()
            yield {"wall_s": time.perf_counter() - start, "wait_s": np.nan}


def tables(folder: Path) -> list[ResultTable]:
    """Return the table of speeds, stage 2 beside a regression on both domains, if they were measured."""
    records = read_records(folder / RECORD)
    if records.empty:
        return []
    found = records.groupby("loop", sort=False)[["step_ms", "wait_share"]].median().astype(float)
    processor_s = records.pivot(index="turn", columns="loop", values="processor_s")
    overhead = (processor_s[STAGE_1] / processor_s[PLAIN] - 1).median()
    over = found["step_ms"] / found.loc[STAGE_2 + BASE, "step_ms"] - 1
    columns = {
        "ms a step": found["step_ms"],
        "steps/s": 1e3 / found["step_ms"],
        "over the plain loop": pd.Series({STAGE_1: 100 * overhead}),
        f"over {BASE}": 100 * over.where(over.index.str.startswith(STAGE_2)),
        "waiting for data": 100 * found["wait_share"],
    }
    table = result_table(
        "Training speed, one thread",
        pd.DataFrame(columns, index=found.index),
        "Medians over epochs of frames of noise; stage 1 over the plain loop in processor time. "
        "No-transfer takes no gradient through the target's pictures.",
        {"": "{:+.1f} %", "ms a step": "{:.1f}", "steps/s": "{:.1f}", "waiting for data": "{:.1f} %"},
    )
    return [table]


PART = Part(measure, tables)
