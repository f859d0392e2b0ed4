"""Whether what a solve takes is known before it: random scenes' forecasts beside their core seconds.

`python -m gelgap.benchmarks.physics.cost --quality draft --number 60` solves scenes and prints the ratios, and the
numbers of `sim/cost.py` as these scenes have them.
"""

import argparse
import time

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from gelgap.benchmarks.common import show
from gelgap.sim import Elastomer, Indenter, Pose, load_indenter
from gelgap.sim.cost import BUILD_POWER, expected_work
from gelgap.sim.newton import StaticNewton
from gelgap.sim.plan import plan_visit
from gelgap.sim.problem import ContactProblem

# Scenes that are expected to take longer are left out.
LONGEST_S = 30.0
QUANTILES = (0.0, 0.1, 0.5, 0.9, 1.0)


def drawn_problem(number: int, quality: str) -> ContactProblem:
    """Return the problem of a scene by its number: a body, a gel, a press, and for most a drag.

    Raises
    ------
    ValueError
        If the body cannot be pressed that deep, or is too sharp for the quality.
    """
    rng = np.random.default_rng(np.random.SeedSequence([48, number]))

    def size(low: float, high: float) -> float:
        return round(float(np.exp(rng.uniform(np.log(low), np.log(high)))), 3)

    shapes = {
        "sphere": lambda: {"diameter_mm": size(1, 8)},
        "cylinder": lambda: {"diameter_mm": size(2, 6), "edge_radius_mm": size(0.2, 0.5)},
        "cone": lambda: {"half_angle_deg": size(40, 70), "tip_radius_mm": size(0.3, 0.8)},
        "edge": lambda: {"diameter_mm": size(1, 4), "length_mm": size(3, 8)},
        "box": lambda: {"size_mm": (size(2, 6), size(2, 6)), "edge_radius_mm": size(0.2, 0.5)},
        "ellipsoid": lambda: {"diameters_mm": (size(2, 6), size(2, 6), size(2, 6))},
    }
    shape = str(rng.choice(list(shapes)))
    body: Indenter = load_indenter(shape, **shapes[shape]())
    thickness_mm = size(1.5, 6)
    gel = Elastomer(
        young_modulus_mpa=0.3,
        poisson_ratio=round(float(rng.uniform(0.4, 0.495)), 4),
        friction=round(float(rng.uniform(0, 1.2)), 3),
        thickness_mm=thickness_mm,
    )
    depth_mm = round(size(0.03, 0.45) * min(thickness_mm, body.deepest_mm), 4)
    travel_mm, angle = rng.uniform(-0.6, 1.0), rng.choice([0.0, 0.5, 1.0]) * np.pi / 3
    shear_mm = max(travel_mm, 0.0) * np.array([np.cos(angle), np.sin(angle)])
    place_x_mm, place_y_mm = rng.choice([0.0, 8.0], 2)
    pose = Pose(depth_mm, *shear_mm.round(4).tolist(), point_x_mm=place_x_mm, point_y_mm=place_y_mm)
    return plan_visit(gel, body, (pose,), quality).solves[0].problem


def measure(problem: ContactProblem) -> dict[str, float]:
    """Solve a problem; return what it took and of what that consisted."""
    work = expected_work(problem)
    with threadpool_limits(limits=1, user_api="blas"):
        start = time.process_time()
        newton = StaticNewton(problem)
        built = time.process_time()
        records = newton.follow_waypoints().records
        ended = time.process_time()
    return {
        "thousands": work.thousands,
        "gflop": work.gflop,
        "expected_iterations": work.iterations,
        "iterations": sum(record.diagnostics.iterations for record in records),
        "expected_s": work.core_s,
        "build_s": built - start,
        "core_s": ended - start,
    }


def refitted(scenes: pd.DataFrame) -> dict[str, float]:
    """Return the numbers of `sim/cost.py` that fit these scenes, each as a share of what it is multiplied with."""
    per_iteration_s = (scenes["core_s"] - scenes["build_s"]) / scenes["iterations"]
    causes: NDArray[np.float64] = (
        scenes[["thousands", "gflop"]].to_numpy() / per_iteration_s.to_numpy()[:, None]
    )
    (vertices_s, gflop_s), *_ = np.linalg.lstsq(causes, np.ones(len(scenes)), rcond=None)
    return {
        "BUILD_S": float((scenes["build_s"] / scenes["thousands"] ** BUILD_POWER).median()),
        "VERTICES_S": float(vertices_s),
        "GFLOP_S": float(gflop_s),
        "iterations, real over expected": float(
            (scenes["iterations"] / scenes["expected_iterations"]).median()
        ),
    }


def main() -> None:
    """Solve scenes and print how their forecasts do."""
    parser = argparse.ArgumentParser(description="Compare what solves take with what was expected.")
    parser.add_argument("--quality", default="draft")
    parser.add_argument("--number", type=int, default=60, help="scenes that are drawn")
    chosen = parser.parse_args()
    rows = []
    for number in range(chosen.number):
        try:
            problem = drawn_problem(number, chosen.quality)
        except ValueError:
            continue
        if expected_work(problem).core_s <= LONGEST_S:
            rows.append({"scene": number, **measure(problem)})
            print(rows[-1], flush=True)
    scenes = pd.DataFrame(rows)
    ratio = scenes["expected_s"] / scenes["core_s"]
    show(
        "Expected over real core seconds",
        ratio.quantile(QUANTILES).rename("ratio").to_frame(),
        "aim: 0.67 to 1.5",
    )
    show("Numbers of sim/cost.py", pd.Series(refitted(scenes), name="fitted").to_frame(), "")


if __name__ == "__main__":
    main()
