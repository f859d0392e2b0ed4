"""What a path's solves cost: the paper's whole path, each saving by itself, and contact on a condensed equation.

The number of solves is exact. The time of a saving is that of a representative solve, by load steps: nobody waits for
the 10,830 solves of the paper's path with nothing shared.
"""

import os
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import Results, Setting, key_of, run_missing, show
from gelgap.benchmarks.physics.cases import Case, SolvedCase, Solver, digest, solve_problem
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
from gelgap.sim.problem import ContactProblem, quality_named
from gelgap.sim.solution import solution_from_bytes

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
# Distances of edges in thicknesses of 3 mm, and the pose whose change is measured: the path's largest.
EDGE_DISTANCES = (2.0, 2.4, 2.75, 3.2)
LARGEST_POSE = Pose(depth_mm=1.0, shear_x_mm=0.6)
NEAR_MM = 5.0
PATH_GEL = "b0"
SMALL_PAD_MM = (10.0, 8.0)
STATES = 200


def saving_cases() -> list[Case]:
    """Return a representative pose with each saving off, or the rest of its radial path where that shares its solve."""
    drag = replace(CORNER, shear_x_mm=TRAVEL_MM)
    path = tuple(replace(CORNER, shear_x_mm=travel / 10) for travel in range(1, 7))
    return [
        Case("savings", name, GEL, path if sharing.path else (drag,), "draft", sharing=sharing)
        for name, sharing in OFF.items()
    ]


def saving_table(solved: Mapping[Case, SolvedCase]) -> pd.DataFrame:
    """Print the paper's path for two gels that differ in modulus, one saving off, all or none: solves, time, error."""
    path, rows = ContactPath.preset("paper"), []
    outcomes = [solved[case] for case in saving_cases()]
    (truth,) = outcomes[-1].states
    for outcome in outcomes:
        case = outcome.case
        plan = plan_solves(GEL, Sphere(), path, "draft", case.sharing)
        gels = 1 if case.sharing.modulus else 2
        nearest = int(np.argmin([abs(pose.radius_mm - TRAVEL_MM) for pose in case.poses]))
        poses = [(pose.shear_x_mm, pose.shear_y_mm, -pose.depth_mm) for pose in case.poses]
        ways = np.diff([(0.0, 0.0, 0.0), (0.0, 0.0, -CORNER.depth_mm), *poses], axis=0)
        step_s = len(poses) * outcome.core_s_per_pose / sum(map(quality_named("draft").load_steps, ways))
        # A modulus that is shared serves both gels from the same solves.
        core_s = gels * step_s * count_load_steps(plan) / (2 * len(path.poses))
        change = changes(outcome.states[nearest], truth, CORNER)
        rows.append((case.name, gels * len(plan.solves), core_s, change["force %"], change["surface rms µm"]))
    columns = ["saving", "solves", "core s/pose", "force error %", "surface error µm"]
    title = "Savings, draft: the paper's path for two gels that differ in modulus"
    note = "errors: what the saving changes in a pose at the outermost point, 0.6 mm deep, 0.3 mm sideways"
    show(title, table := pd.DataFrame(rows, columns=columns), note)
    return table


def points(savings: pd.DataFrame) -> pd.DataFrame:
    """Return the savings as points of the frontier: processor time against error."""
    named = savings.rename(columns={"saving": "name", "core s/pose": "seconds"})
    return named.assign(series=SERIES, error=named["force error %"].clip(lower=FORCE_FLOOR_PERCENT))


def edge_cases() -> list[Case]:
    """Return the largest pose without edges, then with edges ahead and behind or on both sides, by their distance."""
    sizes = {"far": (100.0, 100.0)}
    for distance in EDGE_DISTANCES:
        width = 2 * distance * GEL.thickness_mm
        sizes |= {
            f"ahead and behind {distance:g}": (width, 100.0),
            f"on both sides {distance:g}": (100.0, width),
        }
    gels = {name: GEL.model_copy(update={"pad_size_mm": size}) for name, size in sizes.items()}
    sharing = Sharing(translation=False, cache=False)
    return [Case("edges", name, gel, (LARGEST_POSE,), "draft", sharing=sharing) for name, gel in gels.items()]


def edge_table(solved: Mapping[Case, SolvedCase]) -> pd.DataFrame:
    """Print what edges change, ahead and behind a drag or beside it, by their distance."""
    far, *others = (solved[case] for case in edge_cases())
    rows = []
    for other in others:
        where, thicknesses = other.case.name.rsplit(" ", 1)
        change = changes(other.states[0], far.states[0], LARGEST_POSE, other.case.elastomer.pad_size_mm)
        rows.append({"edges": where, "thicknesses away": float(thicknesses), **change})
    title = (
        "What translation neglects, draft: edges on both sides of a contact, 1 mm deep and 0.6 mm sideways"
    )
    note = "change against the same pose on a pad of 100 × 100 mm; surface: within 5 mm of the contact point"
    show(title, table := pd.DataFrame(rows).drop(columns="force %"), note)
    return table


def descent_table(solver: Solver) -> pd.DataFrame:
    """Print how each depth of the paper's path changes when it shares a solve with others."""
    path = ContactPath("descents", (0.0,), (0.0,), CLASS_DEPTHS_MM, CLASS_RADII_MM, (0.0,))
    sharings = [Sharing(path=shared, cache=False) for shared in (True, False)]
    plans = [plan_solves(GEL, Sphere(), path, "draft", sharing) for sharing in sharings]
    wanted = [index for index, pose in enumerate(path.poses) if pose.radius_mm == TRAVEL_MM]
    keys = {plan.solve_key(index) for plan in plans for index in wanted}
    solves = {one.key: one for plan in plans for one in plan.solves if one.key in keys}
    solved = solver.problems({f"descents, {key[:8]}": one for key, one in solves.items()})
    solutions = dict(zip(solves, solved["solution"], strict=True))
    rows = []
    for index in wanted:
        shared, alone = (plan.state(index, solutions[plan.solve_key(index)]) for plan in plans)
        rows.append({"depth mm": path.poses[index].depth_mm, **changes(shared, alone, path.poses[index])})
    table = pd.DataFrame(rows)[["depth mm", "force %", "surface rms µm"]]
    show("What shared descents change, draft: 0.3 mm sideways at the depths of the paper's path", table)
    return table


def changes(
    state: MembraneState, right: MembraneState, pose: Pose, pad_mm: tuple[float, float] = (np.inf, np.inf)
) -> dict[str, float]:
    """Return how far a state is from the right one: forces, and the membrane within 5 mm of the contact point."""
    x, y = np.meshgrid(right.x_mm, right.y_mm)
    near = np.hypot(x - pose.point_x_mm, y - pose.point_y_mm) <= NEAR_MM
    near &= (np.abs(x) <= pad_mm[0] / 2) & (np.abs(y) <= pad_mm[1] / 2)
    moved_um = 1e3 * np.linalg.norm((state.displacement_mm - right.displacement_mm)[near], axis=-1)
    fx, _, fz = 100 * (state.force_n / np.where(right.force_n, right.force_n, 1.0) - 1)
    return {
        "Fx %": fx,
        "Fz %": fz,
        "force %": 100 * np.linalg.norm(state.force_n - right.force_n) / np.linalg.norm(right.force_n),
        "surface rms µm": np.sqrt((moved_um**2).mean()),
        "worst µm": moved_um.max(),
    }


def path_table(solver: Solver) -> pd.DataFrame:
    """Measure the paper's path on the default pad, and on a small one by one of its solves; print the cost."""
    gel, path = Elastomer.preset(PATH_GEL), ContactPath.preset("paper")
    about = {"study": "the paper's path", "processes": solver.processes, "of": digest(repr(path))}
    settings = [about | {"quality": quality} for quality in ("draft", "standard")]
    # One at a time, since the wall time counts.
    found = run_missing(whole_path, settings, solver.folder / "paths.jsonl", workers=1, tasks_per_worker=1)
    small = small_pad(gel.model_copy(update={"pad_size_mm": SMALL_PAD_MM}), path, solver)
    table = pd.DataFrame([*found.to_dict("records"), small]).drop(columns=list(about))
    title = f"The paper's path, {len(path.poses)} poses, gel {PATH_GEL}, {solver.processes} processes"
    note = (
        "again: from the cache, as with another modulus if the mount is rigid; without wall time: from one of "
        f"its solves, by load steps; membranes come on top, {table['membranes/s'][0]:.0f} per s on one core"
    )
    show(title, table.drop(columns="membranes/s"), note)
    return table


def whole_path(setting: Setting) -> Results:
    """Solve the paper's path from nothing, and take it once more from the cache that then holds it."""
    gel = Elastomer.preset(PATH_GEL)
    plan = plan_solves(gel, Sphere(), ContactPath.preset("paper"), setting["quality"])
    by_key = {key_of({"key": one.key}): one for one in plan.solves}
    runs = []
    with tempfile.TemporaryDirectory() as name, patch.dict(os.environ, GELGAP_CACHE=name):
        for number in range(2):
            start, file = time.perf_counter(), Path(name) / f"run-{number}.jsonl"
            problems = [{"key": one.key} for one in plan.solves]
            work = partial(solve_problem, by_key)
            found = run_missing(work, problems, file, workers=setting["processes"], tasks_per_worker=1)
            runs.append((found, time.perf_counter() - start))
    (found, wall_s), (_, again_s) = runs
    solutions = {
        key: solution_from_bytes(data.tobytes())
        for key, data in zip(found["key"], found["solution"], strict=True)
    }
    records = [record for solution in solutions.values() for record in solution.records]
    sample = range(1, len(plan.poses), max(1, len(plan.poses) // STATES))
    start = time.process_time()
    for index in sample:
        plan.state(index, solutions[plan.solve_key(index)])
    return {
        "pad, mm": "{:g} × {:g}".format(*gel.pad_size_mm),
        "solves": len(plan.solves),
        "load steps": count_load_steps(plan),
        "core s": found["solve_s"].sum(),
        "wall s": wall_s,
        "again, wall s": again_s,
        "states": len(records),
        "unconverged": sum(not record.converged for record in records),
        "membranes/s": len(sample) / (time.process_time() - start),
    }


def small_pad(gel: Elastomer, path: ContactPath, solver: Solver) -> Results:
    """Solve the press to the path's middle depth and its drags, on a pad whose edges are near every contact."""
    plan = plan_solves(gel, Sphere(), path, "standard")
    problems = [one.problem for one in plan.solves]
    shallowest = min(problem.depth_mm for problem in problems)
    longest = max((p for p in problems if p.depth_mm == shallowest), key=lambda problem: problem.load_steps)
    chosen = _deepest_drags(longest)
    solved = solver.problems({"the paper's path, small pad": Solve(chosen, cached=False)}).iloc[0]
    records = solved["solution"].records
    return {
        "pad, mm": "{:g} × {:g}".format(*gel.pad_size_mm),
        "quality": "standard",
        "solves": len(problems),
        "load steps": count_load_steps(plan),
        "core s": solved["solve_s"] * count_load_steps(plan) / chosen.load_steps,
        "states": len(records),
        "unconverged": sum(not record.converged for record in records),
    }


def _deepest_drags(problem: ContactProblem) -> ContactProblem:
    """Return the problem with nothing but its deepest press, and the drags that branch off it."""
    press = problem.waypoints_mm.index((0.0, 0.0, -problem.depth_mm))
    parents = (-1, *(parent - press for parent in problem.parents[press + 1 :]))
    return replace(problem, waypoints_mm=problem.waypoints_mm[press:], parents=parents)


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
    problems = [case.plan.solves[0].problem for case in cases]
    settings = [
        {"scene": case.name, "quality": case.quality, "of": digest(problem.key)}
        for case, problem in zip(cases, problems, strict=True)
    ]
    by_key = {key_of(setting): problem for setting, problem in zip(settings, problems, strict=True)}
    file = solver.folder / "condensation.jsonl"
    found = run_missing(
        partial(condensed, by_key), settings, file, workers=solver.processes, tasks_per_worker=1
    )
    table = found.drop(columns="of").reset_index(drop=True)
    table["ratio"] = table["core s"] / table["alone, core s"]
    note = (
        "0.6 mm deep, in the shallow scene 0.2, then 0.3 mm sideways; times are of solves, models and meshes "
        "included; both take the same iterations"
    )
    show("Contact solved on a condensed equation, against MuJoCo alone", table, note)
    return table


def condensed(problems: Mapping[str, ContactProblem], setting: Setting) -> Results:
    """Solve both ways in this process; changes are those of forces, as a share, and of the membrane's vertices."""
    problem = problems[key_of(setting)]
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
        raise RuntimeError(
            f"{setting['scene']}: {iterations[0]} iterations condensed, {iterations[1]} by MuJoCo"
        )
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
