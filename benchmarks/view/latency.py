"""From a knob of `gelgap view` to the new picture: time by kind of change, and how far off what is shown is.

Times are of one thread at 320×240 and standard quality: processor time, and wall time beside it. The picture's error is
its root mean square difference, in code values, to one rendered anew; where the knob moves the contact, to one of the
same pose solved by itself, at draft like the path.
"""

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from gelgap.benchmarks.common.tables import print_table, write_json
from gelgap.render import Illumination, MembraneRenderer, RgbSpectrum, Sensor
from gelgap.sim import Elastomer, Pose, Sharing, SolvedPath, plan_path, solve_pose
from gelgap.view.pictures import SIZE_PX
from gelgap.view.state import Configuration, LiveModel, PathRequest, Shown

REPEATS, QUICK_REPEATS = 50, 5
TARGET_MS = 50.0
GEL = "e04"
# Between the poses of the path in depth and travel, where interpolation is worst.
BETWEEN = Pose(depth_mm=0.5, shear_x_mm=0.3, point_x_mm=0.4, point_y_mm=-0.3)
Turn = Callable[[Configuration, int], Configuration]


@dataclass(frozen=True)
class Latency:
    """How long a kind of change takes, ms, and how far off what is shown then is."""

    change: str
    median_ms: float
    worst_ms: float
    wall_median_ms: float
    picture_rms: float
    force_percent: float


def turns() -> dict[str, Turn]:
    """Return the kinds of change: the configuration after the k-th turn of a knob."""

    def led(values: Callable[[int], dict]) -> Turn:
        def turn(start: Configuration, k: int) -> Configuration:
            first, *others = start.illumination.leds
            leds = (first.model_copy(update=values(k)), *others)
            return replace(start, illumination=start.illumination.model_copy(update={"leds": leds}))

        return turn

    def pose(**steps: float) -> Turn:
        return lambda start, k: replace(
            start,
            pose=replace(
                start.pose, **{name: getattr(start.pose, name) + k * by for name, by in steps.items()}
            ),
        )

    def sensor(start: Configuration, k: int) -> Configuration:
        chosen = Sensor.preset(("paper", "gelsight-mini-like")[k % 2])
        return replace(start, sensor=chosen, illumination=chosen.illumination or start.illumination)

    def modulus(start: Configuration, k: int) -> Configuration:
        values = dict(start.elastomer) | {"young_modulus_mpa": 0.4 + 0.01 * k}
        return replace(start, elastomer=Elastomer(**values))

    return {
        "LED: drive": led(lambda k: {"drive": 5.5 + 0.1 * k}),
        "LED: colour": led(lambda k: {"spectrum": RgbSpectrum(rgb=(1.0, 0.01 * k, 0.0))}),
        "LED: place": led(lambda k: {"position_mm": (-11.0 + 0.05 * k, 0.0, -3.0)}),
        "illumination": lambda start, k: replace(start, illumination=Illumination.preset(f"i{k % 5}")),
        "markers": lambda start, k: replace(start, markers=k % 2 == 0),
        "noise": lambda start, k: replace(start, noise=k % 2 == 1),
        "sensor": sensor,
        "Young's modulus": modulus,
        "contact point": pose(point_x_mm=0.02, point_y_mm=0.01),
        "depth": pose(depth_mm=-0.005),
        "travel": pose(shear_x_mm=-0.005),
        "direction": lambda start, k: replace(
            start,
            pose=replace(start.pose, shear_x_mm=0.3 * np.cos(0.1 * k), shear_y_mm=0.3 * np.sin(0.1 * k)),
        ),
    }


def solved_path(elastomer: Elastomer) -> tuple[PathRequest, SolvedPath]:
    """Return the path of a gel, from the cache if it was solved before."""
    start = _start(elastomer)
    plan = plan_path(elastomer, start.indenter)
    solutions = {solve.key: solve.run() for solve in plan.solves}
    return PathRequest(elastomer, start.indenter), SolvedPath.from_solutions(plan, solutions)


def latencies(request: PathRequest, path: SolvedPath, repeats: int) -> list[Latency]:
    """Measure every kind of change, each on a model of its own that has shown the start before."""
    start, found = _start(request.elastomer), []
    # The pose that is solved by itself costs the most, and the error of interpolation is there.
    solved = solve_pose(start.elastomer, start.indenter, start.pose, "draft")
    for change, turn in turns().items():
        model = LiveModel()
        model.add_path(request, path)
        model.show(turn(start, 0))
        processor, wall = [], []
        for k in range(1, repeats + 1):
            configuration = turn(start, k)
            began, began_wall = time.thread_time(), time.perf_counter()
            shown = model.show(configuration)
            processor.append(1e3 * (time.thread_time() - began))
            wall.append(1e3 * (time.perf_counter() - began_wall))
        back = turn(start, 0)
        moves = back.pose == start.pose and change in ("contact point", "depth", "travel", "direction")
        error = _picture_rms(model.show(back), solved if moves else None)
        force = np.linalg.norm(model.show(back).solved.state.force_n - solved.force_n) if moves else 0.0
        found.append(
            Latency(
                change,
                statistics.median(processor),
                max(processor),
                statistics.median(wall),
                max(error, _picture_rms(shown, None)),
                100 * float(force / np.linalg.norm(solved.force_n)),
            )
        )
    return found


def anew_ms(request: PathRequest, path: SolvedPath, repeats: int) -> float:
    """Return the median processor time of a picture when nothing is kept but the path."""
    times = []
    for _ in range(repeats):
        model = LiveModel()
        model.add_path(request, path)
        began = time.thread_time()
        model.show(_start(request.elastomer))
        times.append(1e3 * (time.thread_time() - began))
    return statistics.median(times)


def solve_ms(elastomer: Elastomer) -> float:
    """Return the processor time of solving the pose at draft, which a picture would need without the path."""
    start = _start(elastomer)
    began = time.thread_time()
    solve_pose(elastomer, start.indenter, start.pose, "draft", Sharing(cache=False))
    return 1e3 * (time.thread_time() - began)


def _start(elastomer: Elastomer) -> Configuration:
    return Configuration(elastomer, Sensor.preset("paper"), Illumination.preset("i0"), BETWEEN)


def _picture_rms(shown: Shown, state: object | None) -> float:
    """Return the difference of a picture to one rendered anew, of the state that is shown or of another."""
    configuration, state = shown.configuration, state or shown.solved.state
    renderer = MembraneRenderer(
        configuration.sensor, configuration.illumination, SIZE_PX, configuration.quality
    )
    rng = np.random.default_rng(0) if configuration.noise else None
    anew = renderer.picture(state.x_mm, state.y_mm, state.displacement_mm, configuration.markers, rng)
    return float(np.sqrt(np.mean((anew.astype(float) - shown.picture) ** 2)))


def run(quick: bool, out_dir: Path) -> None:
    """Print the latencies beside what the same costs without the live model; write JSON to `out_dir`."""
    repeats = QUICK_REPEATS if quick else REPEATS
    request, path = solved_path(Elastomer.preset(GEL))
    found = latencies(request, path, repeats)
    without = {"all anew, path solved": anew_ms(request, path, min(repeats, 10))}
    without["the pose solved at draft"] = solve_ms(request.elastomer) + without["all anew, path solved"]
    print_table(
        f"From a knob to the picture, 320×240, standard, one thread, {repeats} turns of each knob",
        ["change", "median ms", "worst ms", "wall median ms", "picture rms", "force %"],
        [list(asdict(latency).values()) for latency in found]
        + [[what, ms, ms, "", 0.0, 0.0] for what, ms in without.items()],
        note=f"target: {TARGET_MS:g} ms; picture rms in code values of 255, of the contact's knobs against the pose "
        "solved by itself at draft, of the others against a picture rendered anew",
    )
    write_json(out_dir / "view.json", {"latencies": found, "without": without})
