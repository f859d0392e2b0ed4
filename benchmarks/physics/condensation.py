"""Contact on a condensed equation beside MuJoCo alone: processor time and what changes."""

import time
from dataclasses import replace

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import Results, show
from gelgap.benchmarks.physics.cases import Case, Solver
from gelgap.sim import Elastomer, Pose, Sphere
from gelgap.sim.mesh import unordered_mesh
from gelgap.sim.newton import StaticNewton, solve
from gelgap.sim.problem import ContactProblem, quality_named

SMALL_PAD_MM = (10.0, 8.0)


def condensation_cases(quick: bool) -> list[Case]:
    """Return a press and drag without edges, and with; on a mount; and under a larger sphere."""
    gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.8)
    poses = (Pose(depth_mm=0.6), Pose(depth_mm=0.6, shear_x_mm=0.3))
    first = Case("condensation", "press and drag", gel, poses, "draft")
    if quick:
        return [first]
    corner = tuple(replace(pose, point_x_mm=3.0, point_y_mm=2.0) for pose in poses)
    shallow = tuple(Pose(depth_mm=0.2, shear_x_mm=travel / 10) for travel in range(4))
    small = gel.model_copy(update={"pad_size_mm": SMALL_PAD_MM})
    scenes = [
        first,
        replace(first, name="shallow, on a mount", elastomer=Elastomer.preset("b0"), poses=shallow),
        replace(first, name="near the corner of a pad", elastomer=small, poses=corner),
        replace(first, name="larger sphere", indenter=Sphere(diameter_mm=8.0)),
    ]
    return [replace(scene, quality=quality) for quality in ("draft", "standard") for scene in scenes]


def condensation_table(solver: Solver, quick: bool) -> pd.DataFrame:
    """Solve each case on the condensed equation and by MuJoCo alone; print what both took and what changed."""
    cases = condensation_cases(quick)
    problems = {f"{case.name}, {case.quality}": case.solve.problem for case in cases}
    table = solver.measure(condensed, problems).rename_axis("scene").reset_index()
    table["ratio"] = table["core s"] / table["alone, core s"]
    note = "0.6 mm deep, in the shallow scene 0.2, then 0.3 mm sideways; times are of solves with models and meshes"
    show("Contact solved on a condensed equation, against MuJoCo alone", table, note)
    return table


def condensed(problem: ContactProblem) -> Results:
    """Solve both ways in this process; changes are those of forces, as a share, and of the membrane's vertices."""
    # First imports and compilations are no part of the times.
    solve(replace(problem, waypoints_mm=((0.0, 0.0, -0.2),), parents=(-1,), quality=quality_named("draft")))
    newtons, records, core_s = [], [], []
    for switch in (True, False):
        start = time.process_time()
        newtons.append(StaticNewton(problem, condensed=switch))
        records.append(newtons[-1].follow_waypoints().records)
        core_s.append(time.process_time() - start)
    iterations = [sum(record.diagnostics.iterations for record in one) for one in records]
    pairs = list(zip(*records, strict=True))
    force = [np.linalg.norm(a.force_n - b.force_n) / np.linalg.norm(b.force_n) for a, b in pairs]
    return {
        "vertices": len(unordered_mesh(problem).vertices_mm),
        "iterations": iterations[0],
        "alone, iterations": iterations[1],
        "left to MuJoCo": newtons[0].left_to_mujoco,
        "core s": core_s[0],
        "alone, core s": core_s[1],
        "force changes by": max(force),
        "membrane, mm": max(np.abs(a.displacement_mm - b.displacement_mm).max() for a, b in pairs),
    }
