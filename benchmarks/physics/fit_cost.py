"""Fit `assets/fitted/cost.toml`: what a solve takes, from what its mesh and its load steps count.

python -m gelgap.benchmarks.physics.fit_cost    # ten minutes of a core; seconds are those of this machine

Each problem is built and solved once, on one thread, compiled code loaded. Its build, an iteration's time and its
iterations are fitted apart, as shares, since cheap solves are to be forecast as well as dear ones.
"""

import argparse
import time
from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.optimize import nnls
from threadpoolctl import threadpool_limits

from gelgap.adapt.result_table import ResultTable
from gelgap.assets import asset_path
from gelgap.assets.toml_file import read_toml
from gelgap.sim import Box, Elastomer, Pose, Sharing, Sphere
from gelgap.sim.cost import expected_core_s, expected_work
from gelgap.sim.mesh import elimination_groups, mesh_for
from gelgap.sim.newton import StaticNewton
from gelgap.sim.plan import plan_visit
from gelgap.sim.problem import ContactProblem

GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=0.5)
BODIES = (Sphere(), Sphere(diameter_mm=8.0), Box(size_mm=(3.0, 2.0), edge_radius_mm=0.4))
POSES = (
    (Pose(depth_mm=0.2),),
    (Pose(depth_mm=0.7),),
    (Pose(depth_mm=0.3), Pose(depth_mm=0.3, shear_x_mm=0.15)),
    (Pose(depth_mm=0.5), Pose(depth_mm=0.5, shear_x_mm=0.3)),
    (Pose(depth_mm=0.3, point_x_mm=9.0),),
)
QUALITIES = ("draft", "standard")


def problems(qualities: Sequence[str] = QUALITIES, most: int | None = None) -> list[ContactProblem]:
    """Return contact problems of several sizes, at most `most` of each quality."""
    found: list[ContactProblem] = []
    for quality in qualities:
        plans = [
            plan_visit(GEL, body, poses, quality, Sharing(cache=False)) for body in BODIES for poses in POSES
        ]
        found += [plan.solves[0].problem for plan in plans][:most]
    return found


def measure(problem: ContactProblem) -> dict[str, float]:
    """Build and solve a problem; return its counts, and the core seconds and iterations that it took."""
    mesh_for.cache_clear()
    elimination_groups.cache_clear()
    started = time.process_time()
    newton = StaticNewton(problem)
    elimination_groups(problem)
    built = time.process_time()
    solution = newton.follow_waypoints()
    solved = time.process_time()
    work = expected_work(problem)
    presses = problem.parents.count(-1) * 2.0
    drags = cells = 0.0
    for start, end in problem.segments:
        change = end - start
        sideways_mm = float(np.hypot(*change[:2]))
        steps = problem.steps(change)
        if sideways_mm > 0:
            drags += steps
            cells += sideways_mm / problem.cell_mm
        else:
            presses += steps * max(1.0, abs(change[2]) / steps / problem.indenter.feature_size_mm)
    iterations = sum(record.diagnostics.iterations for record in solution.records)
    return {
        "thousands": work.thousands,
        "touchable": work.touchable,
        "gflop": work.gflop,
        "presses": presses,
        "drags": drags,
        "cells": cells,
        "build_s": built - started,
        "iteration_s": (solved - built) / iterations,
        "iterations": iterations,
        "core_s": solved - started,
        "forecast_s": expected_core_s(problem),
    }


def fit(rows: pd.DataFrame) -> dict[str, float]:
    """Return the numbers of the file by name; none is negative."""
    power, logarithm = np.polyfit(np.log(rows["thousands"]), np.log(rows["build_s"]), 1)
    parts = np.stack([rows["touchable"], rows["touchable"] ** 3, rows["gflop"]], axis=1)
    touchable_s, dense_s, gflop_s = _nonnegative(parts, rows["iteration_s"])
    steps = rows[["presses", "drags", "cells"]].to_numpy()
    press, drag, cell = _nonnegative(steps, rows["iterations"])
    return {
        "build_s": float(np.exp(logarithm)),
        "build_power": float(power),
        "touchable_s": touchable_s,
        "dense_s": dense_s,
        "gflop_s": gflop_s,
        "press_iterations": press,
        "drag_iterations": drag,
        "cell_iterations": cell,
    }


def _nonnegative(parts: np.ndarray, total: pd.Series) -> list[float]:
    """Return the shares (k,), none negative, with which parts (n, k) make up a total (n,), by relative error."""
    shares, _ = nnls(parts / total.to_numpy()[:, None], np.ones(len(total)))
    return shares.tolist()


def main() -> None:
    """Print what was measured, and the fit beside the file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quality", nargs="+", default=list(QUALITIES))
    parser.add_argument("--most", type=int, help="problems of each quality; default: all")
    chosen = parser.parse_args()
    todo = problems(chosen.quality, chosen.most)
    with threadpool_limits(limits=1, user_api="blas"):
        measure(todo[0])
        rows = pd.DataFrame([measure(problem) for problem in todo])
    ResultTable.of("Measured", rows).show()
    file = read_toml(asset_path("fitted", "cost.toml"))
    numbers = pd.DataFrame({"file": file, "fitted here": fit(rows)}).rename_axis("number")
    ResultTable.of("assets/fitted/cost.toml", numbers).show()
    ratio = (rows["forecast_s"] / rows["core_s"]).quantile([0.0, 0.5, 1.0])
    quantiles = ratio.rename("ratio").to_frame().rename_axis("quantile")
    ResultTable.of("Forecast over core seconds", quantiles).show()


if __name__ == "__main__":
    main()
