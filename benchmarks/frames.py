"""Frames at will: poses from a library beside their own solves, a stream's rate, and a sensor in a loop."""

import os
import time
from collections.abc import Sequence
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import processor_s, rms, show, write_json
from gelgap.domains import LibraryPlan, PoseRanges, PressStream, PretrainingRanges, TactileSensor
from gelgap.sim import Elastomer, Pose, PosePath, Sphere, plan_solves

GEL, CONTACTS = "b0", 500
PATH = {
    "seed": 1,
    "point_x_mm": (-3.75, 3.75),
    "point_y_mm": (-2.6, 2.6),
    "depth_mm": (0.1, 1.0),
    "radius_mm": (0, 0.6),
}
FRAMES = (200, 1000)
"""How many are taken from the stream, and steps made: in the quick form, and else."""
SIZE_PX = (320, 240)
AIMS = "aims: at most 8 solves, 2 % and 4 µm rms; 60 frames/s a core at 320×240; a step in 15 ms"


def run(quick: bool, out_dir: Path) -> None:
    """Print what a library of poses saves and costs, the stream's rates, the sensor's latency; write `frames.json`.

    Solves are made anew, in a cache below `out_dir`. The quick form solves fewer poses by themselves, at draft.
    """
    quality, own, workers = ("draft", 6, (0, 1)) if quick else ("standard", 30, (0, 1, 2, 4))
    frames = FRAMES[0] if quick else FRAMES[1]
    cache = out_dir / "frames-cache"
    with patch.dict(os.environ, GELGAP_CACHE=str(cache)):
        for old in cache.glob("*.solution"):
            old.unlink()
        solves, errors = library_and_own_solves(quality, own)
        show(f"{CONTACTS} random contacts on {GEL} at {quality}, seconds of a core", solves, AIMS)
        show("The library on poses that are solved by themselves", errors)
        show("A stream of presses at draft", rates := stream_rates(frames, workers))
        show("A sensor in a loop, 320×240, draft", steps := step_latency(frames))
    tables = {"solves": solves, "errors": errors, "stream": rates, "step": steps}
    write_json(out_dir / "frames.json", tables)


def random_path() -> PosePath:
    return PosePath.random("random500", number=CONTACTS, **PATH)


def library_and_own_solves(quality: str, own: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return solves and time of a path's library and of its poses by themselves, and the library's errors.

    The time of all poses is extrapolated by load steps from the first ones, each seen from its contact point, along its
    drag. Errors are those on these, and on the poses that the library holds out.
    """
    gel, path = Elastomer.preset(GEL), random_path()
    plan = LibraryPlan(gel, Sphere(), PoseRanges.of(path.poses), quality)
    start = time.process_time()
    library = plan.checked({solve.key: solve.run() for solve in plan.solves})
    library_s = time.process_time() - start
    seen = [Pose(depth_mm=p.depth_mm, shear_x_mm=p.radius_mm) for p in path.poses[1 : own + 1]]
    alone = [plan_solves(gel, Sphere(), PosePath("own", (pose,)), quality) for pose in seen]
    sample_s = processor_s(lambda: [solve.run() for one in alone for solve in one.solves])
    whole = plan_solves(gel, Sphere(), path, quality)
    step_s = sample_s / load_steps([solve for one in alone for solve in one.solves])
    solves = [
        ("each pose solved (--exact)", len(whole.solves), steps := load_steps(whole.solves), steps * step_s),
        ("library", library.solves, load_steps(plan.solves), library_s),
    ]
    of_path = [library.errors_of(one, {solve.key: solve.run() for solve in one.solves}) for one in alone]
    found = pd.concat({"held out": library.held_out, "of the path": pd.concat(of_path)})
    of_kind = found[found["converged"].astype(bool)].groupby(level=0)
    errors = pd.DataFrame(
        {
            "number": of_kind.size(),
            "force rms %": 100 * of_kind["force_share"].agg(rms),
            "largest %": 100 * of_kind["force_share"].max(),
            "membrane rms µm": of_kind["membrane_um"].agg(rms),
            "largest µm": of_kind["membrane_um"].max(),
            "picture rms of 255": of_kind["picture_codes"].agg(rms),
        }
    )
    columns = ["way", "solves", "load steps", "s"]
    return pd.DataFrame(solves, columns=columns), errors.rename_axis("poses").reset_index()


def load_steps(solves: Sequence) -> int:
    return sum(solve.problem.load_steps for solve in solves)


def stream_rates(frames: int, workers: tuple[int, ...]) -> pd.DataFrame:
    """Return frames per second by workers, once solved, and the time of the first frame, nothing cached."""
    ranges = PretrainingRanges.default().model_copy(update={"presses": 1})
    stream = PressStream(ranges, size_px=SIZE_PX, stop=frames, batch_size=20)
    first_s, rows = processor_s(lambda: stream.sample(0), clock=time.perf_counter), []
    for number in workers:
        batches = iter(stream.loader(number))
        # The first batches are those during which workers start, import and compile.
        for _ in range(max(number, 1)):
            next(batches)
        started, own_s = time.perf_counter(), time.process_time()
        rest = sum(len(batch.number) for batch in batches)
        wall_s, own_s = time.perf_counter() - started, time.process_time() - own_s
        rows.append(
            {
                "workers": number,
                "frames/s": rest / wall_s,
                "frames/s of a free core": np.nan if number else rest / own_s,
                "first frame s": np.nan if number else first_s,
            }
        )
    return pd.DataFrame(rows)


def step_latency(steps: int) -> pd.DataFrame:
    """Return processor time of a step: median and 95th percentile, as the indenter moves in all three directions."""
    sensor, times = TactileSensor(GEL), []
    for k in range(steps):
        place = 0.4 + 0.2 * np.sin(0.1 * k), (0.1 * np.sin(0.13 * k), 0.1 * np.cos(0.07 * k))
        times.append(1e3 * processor_s(lambda place=place: sensor.step(*place)))
    times = times[5:]
    return pd.DataFrame(
        [{"steps": len(times), "median ms": np.median(times), "95 % ms": np.percentile(times, 95)}]
    )
