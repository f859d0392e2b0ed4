"""What a path's solves cost: the paper's whole path, each saving by itself, and contact on a condensed equation.

The number of solves is exact. The time of a saving is that of a representative solve, by load steps: nobody waits for
the 10,830 solves of the paper's path with nothing shared.
"""

import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import Results, rms, show
from gelgap.benchmarks.physics.cases import Case, Solver
from gelgap.sim import (
    CLASS_DEPTHS_MM,
    CLASS_RADII_MM,
    ContactPath,
    Elastomer,
    MembraneState,
    Pose,
    Sharing,
    Solve,
    SolvePlan,
    Sphere,
    plan_solves,
)
from gelgap.sim.mesh import unordered_mesh
from gelgap.sim.newton import StaticNewton, solve
from gelgap.sim.plan import plan_visit
from gelgap.sim.problem import ContactProblem, quality_named

FORCE_FLOOR_PERCENT = 0.03  # what a log axis shows for less
SERIES = "the paper's path, draft, one saving off: change of force"
OFF = {
    "all on": Sharing(cache=False),
    "modulus off": Sharing(modulus=False, cache=False),
    "path off": Sharing(path=False, cache=False),
    "translation off": Sharing(translation=False, cache=False),
    "translation and reflection off": Sharing(translation=False, reflection=False, cache=False),
    "nothing shared": Sharing(modulus=False, translation=False, reflection=False, path=False, cache=False),
}
GEL = Elastomer(young_modulus_mpa=0.6, poisson_ratio=0.49, friction=0.8)
CORNER = Pose(depth_mm=0.6, point_x_mm=3.75, point_y_mm=2.6)
TRAVEL_MM = 0.3
NEAR_MM = 5.0
PATH_GEL = "b0"
SMALL_PAD_MM = (10.0, 8.0)
STATES = 200
Way = tuple[SolvePlan, int]
"""One way to get a pose: a plan, and the pose's index in it."""


def full_tables(solver: Solver) -> dict[str, pd.DataFrame]:
    """Measure and print the paper's path, and what each saving and shared descents change."""
    return {
        "path": path_table(solver),
        "savings": saving_table(solver),
        "descents": descent_table(solver),
    }


def changed(label: str, ways: Sequence[tuple[Any, Way, Way]], solver: Solver) -> pd.DataFrame:
    """Solve a pose in one way and in the right one, for each name; return its changes and the solve's cost."""
    plans = {plan.solve_key(index): (plan, index) for _, *both in ways for plan, index in both}
    found = solver.solve({key: plan.solves[plan.placements[i].solve] for key, (plan, i) in plans.items()})
    rows = []
    for name, *both in ways:
        keys = [plan.solve_key(index) for plan, index in both]
        solutions = found["solution"][keys]
        state, right = (plan.state(i, own) for (plan, i), own in zip(both, solutions, strict=True))
        rows.append({label: name, **changes(state, right, both[0]), "core s": found["core_s"][keys[0]]})
    return pd.DataFrame(rows)


def changes(state: MembraneState, right: MembraneState, way: Way) -> dict[str, float]:
    """Return how far a state is from the right one: forces, and the membrane within 5 mm of the contact point."""
    plan, index = way
    pose, pad_mm = plan.poses[index], plan.elastomer.pad_size_mm
    x, y = np.meshgrid(right.x_mm, right.y_mm)
    near = np.hypot(x - pose.point_x_mm, y - pose.point_y_mm) <= NEAR_MM
    near &= (np.abs(x) <= pad_mm[0] / 2) & (np.abs(y) <= pad_mm[1] / 2)
    moved_um = 1e3 * np.linalg.norm((state.displacement_mm - right.displacement_mm)[near], axis=-1)
    return {
        "force %": 100 * np.linalg.norm(state.force_n - right.force_n) / np.linalg.norm(right.force_n),
        "surface rms µm": rms(moved_um),
    }


def saving_table(solver: Solver) -> pd.DataFrame:
    """Print the paper's path for two gels that differ in modulus, one saving off, all or none: solves, time, error.

    A representative pose is solved with each saving off, or in its radial path where that shares its solve.
    """
    drag = replace(CORNER, shear_x_mm=TRAVEL_MM)
    radial = [replace(CORNER, shear_x_mm=travel / 10) for travel in range(1, 7)]
    ways = {
        name: (
            plan_visit(GEL, Sphere(), radial if sharing.path else [drag], "draft", sharing),
            radial.index(drag) if sharing.path else 0,
        )
        for name, sharing in OFF.items()
    }
    right = ways["nothing shared"]
    table = changed("saving", [(name, way, right) for name, way in ways.items()], solver)
    path = ContactPath.preset("paper")
    for row, (name, (plan, _)) in enumerate(ways.items()):
        whole = plan_solves(GEL, Sphere(), path, "draft", OFF[name])
        # A modulus that is shared serves both gels from the same solves.
        gels = 1 if OFF[name].modulus else 2
        table.loc[row, "solves"] = gels * len(whole.solves)
        steps = gels * count_load_steps(whole) / count_load_steps(plan)
        table.loc[row, "core s/pose"] = table.loc[row, "core s"] * steps / (2 * len(path.poses))
    table = table.astype({"solves": int})[["saving", "solves", "core s/pose", "force %", "surface rms µm"]]
    table.columns = ["saving", "solves", "core s/pose", "force error %", "surface error µm"]
    title = "Savings, draft: the paper's path for two gels that differ in modulus"
    note = "errors: what the saving changes in a pose at the outermost point, 0.6 mm deep, 0.3 mm sideways"
    show(title, table, note)
    return table


def points(savings: pd.DataFrame) -> pd.DataFrame:
    """Return the savings as points of the frontier: processor time against error."""
    named = savings.rename(columns={"saving": "name", "core s/pose": "seconds"})
    return named.assign(series=SERIES, error=named["force error %"].clip(lower=FORCE_FLOOR_PERCENT))


def descent_table(solver: Solver) -> pd.DataFrame:
    """Print how each depth of the paper's path changes when it shares a solve with others."""
    path = ContactPath("descents", (0.0,), (0.0,), CLASS_DEPTHS_MM, CLASS_RADII_MM, (0.0,))
    shared, alone = (
        plan_solves(GEL, Sphere(), path, "draft", Sharing(path=shared, cache=False))
        for shared in (True, False)
    )
    ways = [
        (pose.depth_mm, (shared, index), (alone, index))
        for index, pose in enumerate(path.poses)
        if pose.radius_mm == TRAVEL_MM
    ]
    table = changed("depth mm", ways, solver)[["depth mm", "force %", "surface rms µm"]]
    show("What shared descents change, draft: 0.3 mm sideways at the depths of the paper's path", table)
    return table


def path_table(solver: Solver) -> pd.DataFrame:
    """Measure the paper's path on the default pad, and on a small one by one of its solves; print the cost."""
    gel, path = Elastomer.preset(PATH_GEL), ContactPath.preset("paper")
    rows = [
        whole_path(plan_solves(gel, Sphere(), path, quality), solver) for quality in ("draft", "standard")
    ]
    small = plan_solves(gel.model_copy(update={"pad_size_mm": SMALL_PAD_MM}), Sphere(), path, "standard")
    table = pd.DataFrame([*rows, small_pad(small, solver)])
    title = f"The paper's path, {len(path.poses)} poses, gel {PATH_GEL}, {solver.processes} processes"
    note = (
        "again: from the cache, as with another modulus if the mount is rigid; without wall time: from one of "
        f"its solves, by load steps; membranes come on top, {table['membranes/s'][0]:.0f} per s on one core"
    )
    show(title, table.drop(columns="membranes/s"), note)
    return table


def whole_path(plan: SolvePlan, solver: Solver) -> Results:
    """Solve a path from nothing, and take it once more from the cache that then holds it."""
    solves, walls_s, runs = {one.key: one for one in plan.solves}, [], []
    with tempfile.TemporaryDirectory() as name, patch.dict(os.environ, GELGAP_CACHE=name):
        for number in range(2):
            start = time.perf_counter()
            runs.append(replace(solver, folder=Path(name) / f"run-{number}").solve(solves))
            walls_s.append(time.perf_counter() - start)
    solutions = runs[0]["solution"]
    sample = range(1, len(plan.poses), max(1, len(plan.poses) // STATES))
    start = time.process_time()
    for index in sample:
        plan.state(index, solutions[plan.solve_key(index)])
    rate = len(sample) / (time.process_time() - start)
    walls = {"wall s": walls_s[0], "again, wall s": walls_s[1], "membranes/s": rate}
    return path_row(plan, solutions, runs[0]["solve_s"].sum()) | walls


def small_pad(plan: SolvePlan, solver: Solver) -> Results:
    """Solve the press to a path's middle depth and its drags, on a pad whose edges are near every contact."""
    problems = [one.problem for one in plan.solves]
    shallowest = min(problem.depth_mm for problem in problems)
    longest = max((p for p in problems if p.depth_mm == shallowest), key=lambda problem: problem.load_steps)
    # Nothing but its deepest press, and the drags that branch off it.
    press = longest.waypoints_mm.index((0.0, 0.0, -longest.depth_mm))
    parents = (-1, *(parent - press for parent in longest.parents[press + 1 :]))
    chosen = replace(longest, waypoints_mm=longest.waypoints_mm[press:], parents=parents)
    found = solver.solve({"small pad": Solve(chosen, cached=False)})
    core_s = found["solve_s"].sum() * count_load_steps(plan) / chosen.load_steps
    return path_row(plan, found["solution"], core_s)


def path_row(plan: SolvePlan, solutions: pd.Series, core_s: float) -> Results:
    """Return what a path took, and of how many states."""
    records = [record for solution in solutions for record in solution.records]
    return {
        "pad, mm": "{:g} × {:g}".format(*plan.elastomer.pad_size_mm),
        "quality": plan.solves[0].problem.quality.name,
        "solves": len(plan.solves),
        "load steps": count_load_steps(plan),
        "core s": core_s,
        "states": len(records),
        "unconverged": sum(not record.converged for record in records),
    }


def count_load_steps(plan: SolvePlan) -> int:
    return sum(one.problem.load_steps for one in plan.solves)


def condensation_cases(quick: bool) -> list[Case]:
    """Return a press and drag without edges, and with; on a mount; and under a larger sphere."""
    gel = GEL.model_copy(update={"young_modulus_mpa": 0.3})
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
    note = (
        "0.6 mm deep, in the shallow scene 0.2, then 0.3 mm sideways; times are of solves, models and meshes "
        "included; both take the same iterations"
    )
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
    if iterations[0] != iterations[1]:
        raise RuntimeError(f"{iterations[0]} iterations condensed, {iterations[1]} by MuJoCo: {problem}")
    pairs = list(zip(*records, strict=True))
    force = [np.linalg.norm(a.force_n - b.force_n) / np.linalg.norm(b.force_n) for a, b in pairs]
    return {
        "vertices": len(unordered_mesh(problem).vertices_mm),
        "iterations": iterations[0],
        "left to MuJoCo": newtons[0].left_to_mujoco,
        "core s": core_s[0],
        "alone, core s": core_s[1],
        "force changes by": max(force),
        "membrane, mm": max(np.abs(a.displacement_mm - b.displacement_mm).max() for a, b in pairs),
    }
