"""Training speed: steps per second beside a plain PyTorch loop, waiting for data, cost of each loss."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.study import Part, Study, read_results, write_results
from gelgap.benchmarks.common import result_table

if TYPE_CHECKING:
    from gelgap.adapt import Profile
    from gelgap.domains import ArrayFrames

BASE = "supervised"
"""Two regressions: a step through both domains whose loss costs nothing."""
METHODS = (BASE, "no-transfer", "dsan", "dann", "daregram", "coral", "dan", "rsd")
RESULTS = "speed.json"
FRAMES, EPOCHS, REPEATS = 256, 3, 3
QUICK = METHODS[:3], 64, 1
"""Frames of noise, epochs whose median is taken, turns of the comparison with the plain loop; the quick form."""


def measure(study: Study) -> None:
    """Measure a plain loop, stage 1 (compared in turns, repeated) and stage 2 with each method; write `speed.json`."""
    from gelgap.adapt import Profile, adapt, train_source

    methods, count, repeats = QUICK if study.is_quick else (METHODS, FRAMES, REPEATS)
    profile = Profile.preset(study.profile)
    frames, overheads = random_frames(profile, count), []
    short = profile.replace(source_epochs=EPOCHS, adapt_epochs=EPOCHS, transfer_warmup=0.0, transfer_ramp=0.0)
    plain_loop_ms(frames, profile, 1)  # warm up
    for _ in range(repeats):
        start = time.process_time()
        loop_ms = plain_loop_ms(frames, profile, EPOCHS)
        between = time.process_time()
        trained = train_source(frames, short.replace(colour_mixing=0.0))
        overheads.append((time.process_time() - between) / (between - start) - 1)
    histories, model = {"stage 1": trained.history}, train_source(frames, short)
    if profile.colour_mixing:
        histories["stage 1, mixed colours"] = model.history
    for method in methods:
        adapted = adapt(model, frames, frames, method, short.replace(transfer_weight=1e-6))
        histories[f"stage 2, {method}"] = adapted.history[EPOCHS:]
    rows = [{"name": "plain PyTorch, source regression", "step_ms": loop_ms}]
    for name, history in histories.items():
        epochs = pd.DataFrame(history)
        step_ms = 1e3 * epochs["wall_s"].median() / (count // profile.batch_size)
        waiting = (epochs["wait_s"] / epochs["wall_s"]).median()
        overhead = {"overhead": np.median(overheads)} if name == "stage 1" else {}
        rows.append({"name": name, "step_ms": step_ms, "wait_share": waiting} | overhead)
    write_results(study.out / RESULTS, rows)


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


def plain_loop_ms(frames: "ArrayFrames", profile: "Profile", epochs: int) -> float:
    """Return the step time in ms of the shortest PyTorch loop that trains the same network on the same batches."""
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
    times = []
    with torch_threads(profile.threads):
        for _ in range(epochs):
            rows = torch.randperm(len(frames))[: len(frames) // profile.batch_size * profile.batch_size]
            batches = rows.split(profile.batch_size)
            start = time.perf_counter()
            for batch in batches:
                optimizer.zero_grad(set_to_none=True)
                functional.mse_loss(network(pictures.inputs(batch)), force[batch]).backward()
                optimizer.step()
            times.append((time.perf_counter() - start) / len(batches))
    return 1e3 * float(np.median(times))


def tables(folder: Path) -> list[ResultTable]:
    """Return the table of speeds, stage 2 beside a regression on both domains, if they were measured."""
    path = folder / RESULTS
    if not path.is_file():
        return []
    found = pd.DataFrame(read_results(path, list[dict[str, str | float | None]])).set_index("name")
    found = found.reindex(columns=["step_ms", "overhead", "wait_share"])
    over = found["step_ms"] / found.loc[f"stage 2, {BASE}", "step_ms"] - 1
    columns = {
        "ms a step": found["step_ms"],
        "steps/s": 1e3 / found["step_ms"],
        "over the plain loop": 100 * found["overhead"],
        f"over {BASE}": 100 * over.where(over.index.str.startswith("stage 2")),
        "waiting for data": 100 * found["wait_share"],
    }
    table = result_table(
        "Training speed, one thread",
        pd.DataFrame(columns).rename_axis("loop"),
        "Medians over epochs of frames of noise; stage 1 over the plain loop in processor time. "
        "No-transfer takes no gradient through the target's pictures.",
        {"": "{:+.1f} %", "ms a step": "{:.1f}", "steps/s": "{:.1f}", "waiting for data": "{:.1f} %"},
    )
    return [table]


PART = Part(measure, tables)
