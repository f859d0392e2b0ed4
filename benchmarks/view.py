"""From a knob of `gelgap view` to the new picture: time by kind of change, and how far off what is shown is.

Times are processor times of one thread at 320×240 and standard quality. The picture's error is its root mean square
difference, in code values, to one rendered anew; where the knob moves the contact, to one of the same pose solved by
itself, at draft like the library.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import processor_s, rms, show, write_json
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


def turns(start: Configuration) -> dict[str, Callable[[int], Configuration]]:
    """Return the kinds of change: the configuration after the k-th turn of a knob."""
    first, *others = start.illumination.leds
    sensors = [Sensor.preset(name) for name in ("paper", "gelsight-mini-like")]
    at = start.pose

    def led(**values: Any) -> Configuration:
        leds = (first.model_copy(update=values), *others)
        return replace(start, illumination=start.illumination.model_copy(update={"leds": leds}))

    def pose(**moves: float) -> Configuration:
        return replace(start, pose=replace(start.pose, **moves))

    def modulus(value_mpa: float) -> Configuration:
        return replace(
            start, elastomer=Elastomer(**{**dict(start.elastomer), "young_modulus_mpa": value_mpa})
        )

    def sensor(chosen: Sensor) -> Configuration:
        return replace(start, sensor=chosen, illumination=chosen.illumination or start.illumination)

    return {
        "LED: drive": lambda k: led(drive=5.5 + 0.1 * k),
        "LED: colour": lambda k: led(spectrum=RgbSpectrum(rgb=(1.0, 0.01 * k, 0.0))),
        "LED: place": lambda k: led(position_mm=(-11.0 + 0.05 * k, 0.0, -3.0)),
        "illumination": lambda k: replace(start, illumination=Illumination.preset(f"i{k % 5}")),
        "markers": lambda k: replace(start, markers=k % 2 == 0),
        "noise": lambda k: replace(start, noise=k % 2 == 1),
        "sensor": lambda k: sensor(sensors[k % 2]),
        "Young's modulus": lambda k: modulus(0.4 + 0.01 * k),
        "contact point": lambda k: pose(
            point_x_mm=at.point_x_mm + 0.02 * k, point_y_mm=at.point_y_mm + 0.01 * k
        ),
        "depth": lambda k: pose(depth_mm=at.depth_mm - 0.005 * k),
        "travel": lambda k: pose(shear_x_mm=at.shear_x_mm - 0.005 * k),
        "direction": lambda k: pose(shear_x_mm=0.3 * np.cos(0.1 * k), shear_y_mm=0.3 * np.sin(0.1 * k)),
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
    begun = time.thread_time()
    solved = solve_pose(gel, start.indenter, BETWEEN, "draft", Sharing(cache=False))
    solve_ms = 1e3 * (time.thread_time() - begun)
    rows = [latency(change, turn, model(), solved, repeats) for change, turn in turns(start).items()]
    anew_ms = np.median([thread_ms(partial(model().show, start)) for _ in range(min(repeats, 10))])
    for change, ms in (
        ("all anew, library solved", anew_ms),
        ("the pose solved at draft", solve_ms + anew_ms),
    ):
        rows.append({"change": change, "median ms": ms, "worst ms": ms, "picture rms": 0.0, "force %": 0.0})
    show(
        f"From a knob to the picture, 320×240, standard, one thread, {repeats} turns of each knob",
        table := pd.DataFrame(rows),
        f"target: {TARGET_MS:g} ms; picture rms in code values of 255, of the contact's knobs against the pose "
        "solved by itself at draft, of the others against a picture rendered anew",
    )
    write_json(out_dir / "view.json", table)


def thread_ms(work: Callable[[], object]) -> float:
    return 1e3 * processor_s(work, clock=time.thread_time)


def latency(
    change: str,
    turn: Callable[[int], Configuration],
    model: LiveModel,
    solved: MembraneState,
    repeats: int,
) -> dict[str, Any]:
    """Return how long a kind of change takes on a model that has shown the start, and how far off what it shows is."""
    model.show(turn(0))
    times = [thread_ms(partial(model.show, turn(k))) for k in range(1, repeats + 1)]
    last, back = model.show(turn(repeats)), model.show(turn(0))
    moves = change in MOVES and turn(0).pose == BETWEEN
    error = picture_rms(back, solved if moves else back.solved.state)
    force_n = back.solved.state.force_n if moves else solved.force_n
    return {
        "change": change,
        "median ms": float(np.median(times)),
        "worst ms": max(times),
        "picture rms": max(error, picture_rms(last, last.solved.state)),
        "force %": 100 * float(np.linalg.norm(force_n - solved.force_n) / np.linalg.norm(solved.force_n)),
    }


def picture_rms(shown: Shown, state: MembraneState) -> float:
    """Return the difference of a picture to one of a state rendered anew."""
    now = shown.configuration
    renderer = MembraneRenderer(now.sensor, now.illumination, SIZE_PX, now.quality)
    rng = np.random.default_rng(0) if now.noise else None
    anew = renderer.picture(state.x_mm, state.y_mm, state.displacement_mm, now.markers, rng)
    return rms(anew.astype(float) - shown.picture)
