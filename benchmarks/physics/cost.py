"""Whether what a solve takes is known before it: forecasts beside core seconds, of the scenes drawn in `stability`.

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
from gelgap.benchmarks.physics.stability import CORNERS, drawn_case
from gelgap.sim.cost import BUILD_POWER, expected_work
from gelgap.sim.newton import StaticNewton
from gelgap.sim.problem import ContactProblem
from gelgap.sim.steady import solved_problems

# Solves that are expected to take longer are left out.
LONGEST_S = 30.0
QUANTILES = (0.0, 0.1, 0.5, 0.9, 1.0)


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
        "touchable": work.touchable,
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
        scenes[["touchable", "gflop"]].to_numpy() / per_iteration_s.to_numpy()[:, None]
    )
    (touchable_s, gflop_s), *_ = np.linalg.lstsq(causes, np.ones(len(scenes)), rcond=None)
    return {
        "BUILD_S": float((scenes["build_s"] / scenes["thousands"] ** BUILD_POWER).median()),
        "TOUCHABLE_S": float(touchable_s),
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
    if chosen.number < 1:
        parser.error(f"--number {chosen.number}: must be 1 or more")
    rows = []
    for number in range(CORNERS, CORNERS + chosen.number):
        for problem in solved_problems(drawn_case(number, chosen.quality).solve.problem):
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
