"""From a knob of `gelgap view` to the new picture: time by kind of change, and how far off what is shown is.

Times are of one thread at 320×240 and standard quality: processor time, and wall time beside it. The picture's error is
its root mean square difference, in code values, to one rendered anew; where the knob moves the contact, to one of the
same pose solved by itself, at draft like the library.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import rms, show, write_json
from gelgap.render import Illumination, MembraneRenderer, RgbSpectrum, Sensor
from gelgap.sim import Elastomer, MembraneState, Pose, Sharing, solve_pose
from gelgap.view.pictures import SIZE_PX
from gelgap.view.state import Configuration, LiveModel, Shown

REPEATS, QUICK_REPEATS = 50, 5
TARGET_MS = 50.0
GEL = "e04"
# Between the solved poses in depth and travel.
BETWEEN = Pose(depth_mm=0.5, shear_x_mm=0.3, point_x_mm=0.4, point_y_mm=-0.3)
MOVES = ("contact point", "depth", "travel", "direction")
Turn = Callable[[Configuration, int], Configuration]


def turns() -> dict[str, Turn]:
    """Return the kinds of change: the configuration after the k-th turn of a knob."""

    def led(start: Configuration, **values: Any) -> Configuration:
        first, *others = start.illumination.leds
        leds = (first.model_copy(update=values), *others)
        return replace(start, illumination=start.illumination.model_copy(update={"leds": leds}))

    def pose(start: Configuration, **moves: float) -> Configuration:
        return replace(start, pose=replace(start.pose, **moves))

    def sensor(start: Configuration, k: int) -> Configuration:
        chosen = Sensor.preset(("paper", "gelsight-mini-like")[k % 2])
        return replace(start, sensor=chosen, illumination=chosen.illumination or start.illumination)

    def modulus(start: Configuration, k: int) -> Configuration:
        values = dict(start.elastomer) | {"young_modulus_mpa": 0.4 + 0.01 * k}
        return replace(start, elastomer=Elastomer(**values))

    at = BETWEEN
    return {
        "LED: drive": lambda start, k: led(start, drive=5.5 + 0.1 * k),
        "LED: colour": lambda start, k: led(start, spectrum=RgbSpectrum(rgb=(1.0, 0.01 * k, 0.0))),
        "LED: place": lambda start, k: led(start, position_mm=(-11.0 + 0.05 * k, 0.0, -3.0)),
        "illumination": lambda start, k: replace(start, illumination=Illumination.preset(f"i{k % 5}")),
        "markers": lambda start, k: replace(start, markers=k % 2 == 0),
        "noise": lambda start, k: replace(start, noise=k % 2 == 1),
        "sensor": sensor,
        "Young's modulus": modulus,
        "contact point": lambda start, k: pose(
            start, point_x_mm=at.point_x_mm + 0.02 * k, point_y_mm=at.point_y_mm + 0.01 * k
        ),
        "depth": lambda start, k: pose(start, depth_mm=at.depth_mm - 0.005 * k),
        "travel": lambda start, k: pose(start, shear_x_mm=at.shear_x_mm - 0.005 * k),
        "direction": lambda start, k: pose(
            start, shear_x_mm=0.3 * np.cos(0.1 * k), shear_y_mm=0.3 * np.sin(0.1 * k)
        ),
    }


def run(quick: bool, out_dir: Path) -> None:
    """Print the latencies beside what the same costs without the live model; write JSON to `out_dir`."""
    repeats, gel = QUICK_REPEATS if quick else REPEATS, Elastomer.preset(GEL)
    start = Configuration(gel, Sensor.preset("paper"), Illumination.preset("i0"), BETWEEN)
    plan = start.library.plan
    library = plan.build({solve.key: solve.run() for solve in plan.solved.solves})

    def model() -> LiveModel:
        new = LiveModel()
        new.add_library(start.library, library)
        return new

    # The pose that is solved by itself costs the most, and the error of interpolation is there.
    solve_ms, _, solved = timed(
        lambda: solve_pose(gel, start.indenter, BETWEEN, "draft", Sharing(cache=False))
    )
    rows = [latency(change, turn, model(), start, solved, repeats) for change, turn in turns().items()]
    anew_ms = float(np.median([timed(lambda: model().show(start))[0] for _ in range(min(repeats, 10))]))
    for change, ms in (
        ("all anew, library solved", anew_ms),
        ("the pose solved at draft", solve_ms + anew_ms),
    ):
        costs = {"median ms": ms, "worst ms": ms, "wall median ms": "", "picture rms": 0.0, "force %": 0.0}
        rows.append({"change": change, **costs})
    show(
        f"From a knob to the picture, 320×240, standard, one thread, {repeats} turns of each knob",
        table := pd.DataFrame(rows),
        f"target: {TARGET_MS:g} ms; picture rms in code values of 255, of the contact's knobs against the pose "
        "solved by itself at draft, of the others against a picture rendered anew",
    )
    write_json(out_dir / "view.json", table)


def latency(
    change: str, turn: Turn, model: LiveModel, start: Configuration, solved: MembraneState, repeats: int
) -> dict:
    """Return how long a kind of change takes on a model that has shown the start, and how far off what it shows is."""
    model.show(turn(start, 0))
    processor, wall, shown = zip(
        *(timed(lambda k=k: model.show(turn(start, k))) for k in range(1, repeats + 1)), strict=True
    )
    back = model.show(turn(start, 0))
    moves = change in MOVES and turn(start, 0).pose == start.pose
    error = picture_rms(back, solved if moves else back.solved.state)
    force_n = back.solved.state.force_n if moves else solved.force_n
    return {
        "change": change,
        "median ms": float(np.median(processor)),
        "worst ms": max(processor),
        "wall median ms": float(np.median(wall)),
        "picture rms": max(error, picture_rms(shown[-1], shown[-1].solved.state)),
        "force %": 100 * float(np.linalg.norm(force_n - solved.force_n) / np.linalg.norm(solved.force_n)),
    }


def timed(work: Callable[[], object]) -> tuple[float, float, object]:
    """Return processor ms of this thread, wall ms, and the outcome of some work."""
    processor, wall = time.thread_time(), time.perf_counter()
    outcome = work()
    return 1e3 * (time.thread_time() - processor), 1e3 * (time.perf_counter() - wall), outcome


def picture_rms(shown: Shown, state: MembraneState) -> float:
    """Return the difference of a picture to one of a state rendered anew."""
    now = shown.configuration
    renderer = MembraneRenderer(now.sensor, now.illumination, SIZE_PX, now.quality)
    rng = np.random.default_rng(0) if now.noise else None
    anew = renderer.picture(state.x_mm, state.y_mm, state.displacement_mm, now.markers, rng)
    return rms(anew.astype(float) - shown.picture)
