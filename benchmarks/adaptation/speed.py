"""Training speed: steps a second against a plain PyTorch loop, waiting for data, cost of each loss."""

import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from gelgap.adapt import ResultTable
from gelgap.benchmarks.common.tables import write_json

BASE = "supervised"
"""Two regressions: a step through both domains whose loss costs nothing."""
METHODS = (BASE, "no-transfer", "dsan", "dann", "daregram", "coral", "dan", "rsd")
RESULTS = "speed.json"


@dataclass(frozen=True)
class Speed:
    """Median time of a step, the share of it spent on making batches, and the processor time over a plain loop's."""

    name: str
    step_ms: float
    wait_share: float | None = None
    overhead: float | None = None


def random_frames(n: int, profile):
    """Return n frames of noise at the profile's size: speed does not depend on what they show."""
    from gelgap.domains import ArrayFrames

    rng = np.random.default_rng(0)
    width, height = profile.image_size_px
    return ArrayFrames(
        name="noise",
        images=rng.integers(0, 256, (n, height, width, 3), dtype=np.uint8),
        reference=np.full((height, width, 3), 128, np.uint8),
        force_n=rng.uniform([-0.7, -0.7, -3], [0.7, 0.7, 0], (n, 3)).astype(np.float32),
        contact_class=rng.integers(0, 361, n),
        point_id=rng.integers(0, 30, n),
    )


def plain_loop_ms(frames, profile, epochs: int) -> float:
    """Return the step time in ms of the shortest PyTorch loop that trains the same network on the same batches."""
    import torch
    from torch.nn import functional

    from gelgap.adapt import make_network
    from gelgap.adapt.batches import network_inputs, normalised_force
    from gelgap.adapt.machine import torch_threads

    network = make_network(profile, 361, 0)
    pictures = network_inputs(frames, profile, "cpu")
    force = torch.from_numpy(normalised_force(frames))
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


def measure(profile, n: int = 256, epochs: int = 3) -> list[Speed]:
    """Return speeds of a plain loop, of stage 1 and of stage 2 with each method; epochs repeat the measurement."""
    from gelgap.adapt import adapt, train_source

    frames = random_frames(n, profile)
    short = profile.replace(source_epochs=epochs, adapt_epochs=epochs, transfer_warmup=0.0, transfer_ramp=0.0)
    plain = short.replace(colour_mixing=0.0)

    def speed(name: str, history, over: float | None = None) -> Speed:
        steps = n // profile.batch_size
        times = [record["wall_s"] / steps for record in history]
        waits = [record["wait_s"] / record["wall_s"] for record in history]
        return Speed(name, 1e3 * float(np.median(times)), float(np.median(waits)), over)

    speeds = [Speed("plain PyTorch, source regression", plain_loop_ms(frames, profile, epochs))]
    speeds.append(speed("stage 1", train_source(frames, plain).history, overhead(plain)))
    model = train_source(frames, short)
    if profile.colour_mixing:
        speeds.append(speed("stage 1, mixed colours", model.history))
    for method in METHODS:
        adapted = adapt(model, frames, frames, method, short.replace(transfer_weight=1e-6))
        speeds.append(speed(f"stage 2, {method}", adapted.history[epochs:]))
    return speeds


def overhead(profile, repeats: int = 3) -> float:
    """Return the median of stage 1's processor time over the plain loop's, minus 1; taken in turns after a warm-up."""
    from gelgap.adapt import train_source

    frames = random_frames(256, profile)
    short = profile.replace(source_epochs=2)
    plain_loop_ms(frames, profile, 1)
    ratios = []
    for _ in range(repeats):
        start = time.process_time()
        plain_loop_ms(frames, profile, 2)
        plain = time.process_time() - start
        start = time.process_time()
        train_source(frames, short)
        ratios.append((time.process_time() - start) / plain - 1)
    return float(np.median(ratios))


def speed_table(speeds: Sequence[Speed]) -> ResultTable:
    """Steps a second of every loop; stage 2 against a regression on both domains."""
    base = next(s.step_ms for s in speeds if s.name == f"stage 2, {BASE}")
    rows = [
        [
            s.name,
            f"{s.step_ms:.1f}",
            f"{1e3 / s.step_ms:.1f}",
            "–" if s.overhead is None else f"{100 * s.overhead:+.1f} %",
            f"{100 * (s.step_ms / base - 1):+.1f} %" if s.name.startswith("stage 2") else "–",
            "–" if s.wait_share is None else f"{100 * s.wait_share:.1f} %",
        ]
        for s in speeds
    ]
    return ResultTable(
        "Training speed, one thread",
        ["loop", "ms a step", "steps/s", "over the plain loop", f"over {BASE}", "waiting for data"],
        rows,
        "Medians over epochs of 256 frames of noise; stage 1 over the plain loop in processor time. "
        "No-transfer takes no gradient through the target's pictures.",
    )


def load_speeds(path: Path) -> list[Speed]:
    """Read what `run` wrote."""
    return [Speed(**content) for content in json.loads(path.read_text(encoding="utf-8"))]


def run(out: Path) -> None:
    """Measure the profile that `out` is named after, write `speed.json`, print the table."""
    from gelgap.adapt import Profile

    speeds = measure(Profile.preset(out.name))
    write_json(out / RESULTS, [asdict(speed) for speed in speeds])
    speed_table(speeds).show()
