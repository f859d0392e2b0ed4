"""Training speed: steps per second beside a plain PyTorch loop, waiting for data, cost of each loss."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.benchmarks.adaptation.jobs import Bench
from gelgap.benchmarks.adaptation.parts import Part
from gelgap.benchmarks.adaptation.tables import by_column
from gelgap.benchmarks.common.records import read_results, write_results

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


@dataclass(frozen=True)
class Speed:
    """Median time of a step, the share of it spent on making batches, and the processor time over a plain loop's."""

    name: str
    step_ms: float
    wait_share: float | None = None
    overhead: float | None = None


def measure(bench: Bench) -> None:
    """Measure the bench's profile and write `speed.json`."""
    from gelgap.adapt import Profile

    methods, frames, repeats = QUICK if bench.is_quick else (METHODS, FRAMES, REPEATS)
    profile = Profile.preset(bench.profile)
    write_results(
        bench.out / RESULTS, measure_profile(profile, random_frames(profile, frames), methods, repeats)
    )


def measure_profile(
    profile: "Profile", frames: "ArrayFrames", methods: Sequence[str], repeats: int
) -> list[Speed]:
    """Return the speeds of a plain loop, of stage 1 (compared in turns, repeated) and of stage 2 with each method."""
    from gelgap.adapt import adapt, train_source

    short = profile.replace(source_epochs=EPOCHS, adapt_epochs=EPOCHS, transfer_warmup=0.0, transfer_ramp=0.0)
    plain, steps = short.replace(colour_mixing=0.0), len(frames) // profile.batch_size
    speeds = [Speed("plain PyTorch, source regression", plain_loop_ms(frames, profile, EPOCHS))]
    speeds.append(
        _speed("stage 1", steps, train_source(frames, plain).history, overhead(frames, plain, repeats))
    )
    model = train_source(frames, short)
    if profile.colour_mixing:
        speeds.append(_speed("stage 1, mixed colours", steps, model.history))
    for method in methods:
        adapted = adapt(model, frames, frames, method, short.replace(transfer_weight=1e-6))
        speeds.append(_speed(f"stage 2, {method}", steps, adapted.history[EPOCHS:]))
    return speeds


def _speed(name: str, steps: int, history: Sequence[dict], over: float | None = None) -> Speed:
    step_s = [epoch["wall_s"] / steps for epoch in history]
    waits = [epoch["wait_s"] / epoch["wall_s"] for epoch in history]
    return Speed(name, 1e3 * float(np.median(step_s)), float(np.median(waits)), over)


def random_frames(profile: "Profile", count: int = FRAMES) -> "ArrayFrames":
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
            order = torch.randperm(len(frames))
            start, steps = time.perf_counter(), len(frames) // profile.batch_size
            for i in range(steps):
                rows = order[i * profile.batch_size : (i + 1) * profile.batch_size]
                optimizer.zero_grad(set_to_none=True)
                functional.mse_loss(network(pictures.inputs(rows)), force[rows]).backward()
                optimizer.step()
            times.append((time.perf_counter() - start) / steps)
    return 1e3 * float(np.median(times))


def overhead(frames: "ArrayFrames", profile: "Profile", repeats: int = REPEATS) -> float:
    """Return the median of stage 1's processor time over the plain loop's, minus 1; taken in turns after a warm-up."""
    from gelgap.adapt import train_source

    short = profile.replace(source_epochs=2)
    plain_loop_ms(frames, profile, 1)
    ratios = []
    for _ in range(repeats):
        start = time.process_time()
        plain_loop_ms(frames, profile, 2)
        between = time.process_time()
        train_source(frames, short)
        ratios.append((time.process_time() - between) / (between - start) - 1)
    return float(np.median(ratios))


def tables(folder: Path) -> list[ResultTable]:
    """Return the table of speeds, if they were measured."""
    path = folder / RESULTS
    return [speed_table(read_results(path, list[Speed]))] if path.is_file() else []


def speed_table(speeds: Sequence[Speed]) -> ResultTable:
    """Steps per second of every loop; stage 2 beside a regression on both domains."""
    base = next(speed.step_ms for speed in speeds if speed.name == f"stage 2, {BASE}")

    def percent(share: float | None, form: str) -> str:
        return "–" if share is None else f"{100 * share:{form}} %"

    over_base = [s.step_ms / base - 1 if s.name.startswith("stage 2") else None for s in speeds]
    return by_column(
        "Training speed, one thread",
        "loop",
        [s.name for s in speeds],
        {
            "ms a step": [f"{s.step_ms:.1f}" for s in speeds],
            "steps/s": [f"{1e3 / s.step_ms:.1f}" for s in speeds],
            "over the plain loop": [percent(s.overhead, "+.1f") for s in speeds],
            f"over {BASE}": [percent(over, "+.1f") for over in over_base],
            "waiting for data": [percent(s.wait_share, ".1f") for s in speeds],
        },
        "Medians over epochs of frames of noise; stage 1 over the plain loop in processor time. "
        "No-transfer takes no gradient through the target's pictures.",
    )


PART = Part(measure, tables)
run = PART.run
