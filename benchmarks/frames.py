"""Frames at will: poses from a library beside their own solves, a stream's rate, and a sensor in a loop."""

import os
import resource
import time
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import processor_s, rms, show, write_json
from gelgap.domains import LibraryPlan, PoseLibrary, PoseRanges, PressStream, PretrainingRanges, TactileSensor
from gelgap.sim import Elastomer, Pose, PosePath, SolvePlan, Sphere, load_path, plan_solves, solve_poses

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
SIZES_PX = ((160, 120), (320, 240))
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
        library, before_after = library_and_own_solves(quality, own)
        show(f"{CONTACTS} random contacts on {GEL} at {quality}, seconds of a core", before_after, AIMS)
        show("The library on poses of that path, each solved by itself", errors := path_errors(library, own))
        show("A stream of presses at draft", rates := stream_rates(frames, workers))
        show("A sensor in a loop, 320×240, draft", steps := step_latency(frames))
        show("Its force on loops, beside solved trajectories, % of the largest force", loops := loop_errors())
    tables = {"solves": before_after, "errors": errors, "stream": rates, "step": steps, "loops": loops}
    write_json(out_dir / "frames.json", tables)


def random_path() -> PosePath:
    return PosePath.random("random500", number=CONTACTS, **PATH)


def seen_along_x(number: int) -> list[Pose]:
    """Return the first contacts of the path from their contact points, each along its drag."""
    return [Pose(depth_mm=p.depth_mm, shear_x_mm=p.radius_mm) for p in random_path().poses[1 : number + 1]]


def own_plan(gel: Elastomer, pose: Pose, quality: str) -> SolvePlan:
    return plan_solves(gel, Sphere(), PosePath("own", (pose,)), quality)


def library_and_own_solves(quality: str, own: int) -> tuple[PoseLibrary, pd.DataFrame]:
    """Return the library of the path, and solves and time of it beside those of the poses by themselves.

    The time of the latter is extrapolated by load steps from the poses that are solved.
    """
    gel, path = Elastomer.preset(GEL), random_path()
    plan = LibraryPlan(gel, Sphere(), PoseRanges.of(path.poses), quality)
    made: list[PoseLibrary] = []

    def build() -> None:
        made.append(plan.checked({solve.key: solve.run() for solve in plan.solves}))

    library_s = processor_s(build)
    alone = [solve for pose in seen_along_x(own) for solve in own_plan(gel, pose, quality).solves]
    sample_s = processor_s(lambda: [solve.run() for solve in alone])
    step_s = sample_s / sum(solve.problem.load_steps for solve in alone)
    whole = plan_solves(gel, Sphere(), path, quality)
    steps = sum(solve.problem.load_steps for solve in whole.solves)
    rows = [
        ("each pose solved (--exact)", len(whole.solves), steps, steps * step_s),
        ("library", made[0].solves, sum(s.problem.load_steps for s in plan.solves), library_s),
    ]
    return made[0], pd.DataFrame(rows, columns=["way", "solves", "load steps", "s"])


def path_errors(library: PoseLibrary, own: int) -> pd.DataFrame:
    """Return the library's errors on its held-out poses, and on the first poses of the path."""
    gel, quality = library.plan.elastomer, library.plan.quality
    plans = [own_plan(gel, pose, quality) for pose in seen_along_x(own)]
    rows = [library.errors_of(plan, {solve.key: solve.run() for solve in plan.solves}) for plan in plans]
    table = pd.concat(rows, ignore_index=True)
    found = {"held out": library.held_out, "of the path": table}
    return pd.DataFrame(
        [
            {
                "poses": name,
                "number": len(of),
                "force rms %": 100 * rms(of["force_share"]),
                "largest %": 100 * of["force_share"].max(),
                "membrane rms µm": rms(of["membrane_um"]),
                "largest µm": of["membrane_um"].max(),
                "picture rms of 255": rms(of["picture_codes"]),
            }
            for name, of in ((name, of[of["converged"]]) for name, of in found.items())
        ]
    )


def stream_rates(frames: int, workers: tuple[int, ...]) -> pd.DataFrame:
    """Return frames per second by size and workers, once solved, and the time of the first, nothing cached."""
    ranges = PretrainingRanges.default().model_copy(update={"presses": 1})
    rows = []
    for size_px in SIZES_PX:
        stream = PressStream(ranges, size_px=size_px, stop=frames, batch_size=20)
        started = time.perf_counter()
        stream.sample(0)
        first_s = time.perf_counter() - started
        for number in workers:
            batches = iter(stream.loader(number))
            # The first batches are those during which workers start, import and compile.
            for _ in range(max(number, 1)):
                next(batches)
            started, own_s = time.perf_counter(), time.process_time()
            rest = sum(len(batch.number) for batch in batches)
            wall_s, own_s = time.perf_counter() - started, time.process_time() - own_s
            row = {"size": "{}×{}".format(*size_px), "workers": number, "frames/s": rest / wall_s}
            row["frames/s of a free core"] = rest / own_s if number == 0 else np.nan
            row["first frame s"] = first_s if number == workers[0] else np.nan
            row["peak MiB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            rows.append(row)
    return pd.DataFrame(rows)


def step_latency(steps: int) -> pd.DataFrame:
    """Return processor time of a step: median and 95th percentile, as the indenter moves in all three directions."""
    sensor, times = TactileSensor(GEL), []
    for k in range(steps):
        place = 0.4 + 0.2 * np.sin(0.1 * k), (0.1 * np.sin(0.13 * k), 0.1 * np.cos(0.07 * k))
        started = time.process_time()
        sensor.step(*place)
        times.append(1e3 * (time.process_time() - started))
    times = times[5:]
    return pd.DataFrame(
        [{"steps": len(times), "median ms": np.median(times), "95 % ms": np.percentile(times, 95)}]
    )


def loop_errors() -> pd.DataFrame:
    """Return how far the sensor's force is off along trajectories that are solved as such: friction's whole memory."""
    gel, rows = Elastomer.preset(GEL), []
    sensor = TactileSensor(gel)
    loops: dict[int, list[Pose]] = {}
    for pose in load_path("loops").poses:
        if pose.trajectory is not None:
            loops.setdefault(pose.trajectory, []).append(pose)
    there_and_back = [(0.0, 0.5), (0.2, 0.5), (0.4, 0.5), (0.2, 0.5), (0.0, 0.5), (-0.2, 0.5)]
    loops[len(loops)] = [Pose(depth_mm=depth, shear_x_mm=x) for x, depth in there_and_back]
    for number, poses in loops.items():
        sensor.reset()
        solved = solve_poses(gel, Sphere(), poses, "draft")
        largest = max(np.linalg.norm(state.force_n) for state in solved)
        for step, (pose, state) in enumerate(zip(poses, solved, strict=True)):
            point = pose.point_x_mm, pose.point_y_mm
            reading = sensor.step(pose.depth_mm, (pose.shear_x_mm, pose.shear_y_mm), point)
            off = 100 * (reading.force_n - state.force_n) / largest
            rows.append((number, step, np.hypot(*off[:2]), abs(off[2]), " ".join(reading.flags)))
    return pd.DataFrame(rows, columns=["loop", "step", "shear %", "Fz %", "flags"])
