"""What each piece of a load step's solve is worth: `python -m gelgap.benchmarks.physics.policy`, some minutes.

Solves contact problems with all of `gelgap.sim.newton.Policy`, and without each of its pieces: linearisation (every
tangent is new), acceleration (increments are added as they are), step control (no short steps, no halves). The
baseline of every row is the same run's whole policy. The error is that of a recorded force beside the same mesh's
solution with new tangents alone, short load steps and a hundredth of the tolerance, over the whole force.
"""

import argparse
import math
import time
from collections.abc import Sequence
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from gelgap.adapt.result_table import ResultTable
from gelgap.sim import Box, Elastomer, Pose, Sharing, Sphere
from gelgap.sim.contact import ContactNewton
from gelgap.sim.newton import POLICY, Policy, StaticNewton
from gelgap.sim.plan import plan_visit
from gelgap.sim.problem import ContactProblem
from gelgap.sim.shapes import AnyIndenter
from gelgap.sim.solution import Solution

NEW_TANGENTS = {"kept_tangent_ratio": 0.0, "most_patience": 0}
NO_LEAPS = {"drifted": 10**9}
NO_ACCELERATION = {"remembered": 2, **NO_LEAPS}
NO_STEP_CONTROL = {"first_contact_shares": (), "most_halvings": 0, "runaway_load_share": math.inf}
POLICIES = {
    "all": POLICY,
    "no linearisation": replace(POLICY, **NEW_TANGENTS),
    "no acceleration": replace(POLICY, **NO_ACCELERATION),
    "no leaps": replace(POLICY, **NO_LEAPS),
    "no step control": replace(POLICY, **NO_STEP_CONTROL),
}
EXACT = replace(POLICY, **NEW_TANGENTS, iterations_per_step=400)
# The reference's load steps and tolerance, as shares of the quality's.
SHORTER, NEARER = 0.5, 0.01
GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=0.5)
PRESS = (Pose(depth_mm=0.8),)
DRAG = (Pose(depth_mm=0.5, shear_x_mm=0.15), Pose(depth_mm=0.5, shear_x_mm=0.3))
SCENES: dict[str, tuple[AnyIndenter, tuple[Pose, ...], float]] = {
    "ball, press": (Sphere(), PRESS, 0.5),
    "ball, drag near full slip": (Sphere(), DRAG, 0.5),
    "ball, drag without slip": (Sphere(), DRAG, 10.0),
    "box, press": (Box(size_mm=(3.0, 2.0), edge_radius_mm=0.4), (Pose(depth_mm=0.4),), 0.5),
}


def problem_of(scene: str, quality: str) -> ContactProblem:
    """Return the contact problem of a scene."""
    body, poses, friction = SCENES[scene]
    gel = GEL.model_copy(update={"friction": friction})
    (solve,) = plan_visit(gel, body, poses, quality, Sharing(cache=False)).solves
    return solve.problem


def solved(problem: ContactProblem, policy: Policy) -> tuple[Solution, float, int]:
    """Return a problem's solution by a policy, with core seconds and factorisations."""
    counted = patch.object(ContactNewton, "factorise", autospec=True, side_effect=ContactNewton.factorise)
    with threadpool_limits(limits=1, user_api="blas"), counted as factorise:
        started = time.process_time()
        solution = StaticNewton(problem, policy).follow_waypoints()
        return solution, time.process_time() - started, factorise.call_count


def measure(scenes: Sequence[str], quality: str) -> pd.DataFrame:
    """Return run time and error by scene and policy."""
    rows = []
    for scene in scenes:
        problem = problem_of(scene, quality)
        usual = problem.quality
        exact = replace(
            usual,
            press_step_mm=SHORTER * usual.press_step_mm,
            travel_step_mm=SHORTER * usual.travel_step_mm,
            press_tolerance=NEARER * usual.press_tolerance,
            travel_tolerance=NEARER * usual.travel_tolerance,
        )
        reference, *_ = solved(replace(problem, quality=exact), EXACT)
        truth_n = np.array([record.force_n for record in reference.records])
        for name, policy in POLICIES.items():
            solution, core_s, factorisations = solved(problem, policy)
            force_n = np.array([record.force_n for record in solution.records])
            off = np.linalg.norm(force_n - truth_n, axis=1) / np.linalg.norm(truth_n, axis=1)
            records = solution.records
            rows.append(
                {
                    "scene": scene,
                    "policy": name,
                    "core s": core_s,
                    "iterations": sum(record.diagnostics.iterations for record in records),
                    "new tangents": factorisations,
                    "converged": f"{sum(record.converged for record in records)} of {len(records)}",
                    "force error, %": 100 * off.max(),
                }
            )
    table = pd.DataFrame(rows)
    whole = table[table["policy"] == "all"].set_index("scene")["core s"]
    table.insert(3, "over all", table["core s"] / table["scene"].map(whole))
    return table


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quality", default="draft")
    parser.add_argument("--scenes", nargs="+", choices=list(SCENES), default=list(SCENES))
    chosen = parser.parse_args()
    # Compiled code is loaded before anything is measured.
    solved(problem_of("ball, press", "draft"), POLICY)
    measured = measure(chosen.scenes, chosen.quality)
    ResultTable.of(f"Pieces of a load step's solve, at {chosen.quality}", measured).show()


if __name__ == "__main__":
    main()
