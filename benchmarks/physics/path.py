"""What the solves of the paper's whole path cost: on the default pad, measured, and on a small one, from one solve."""

import multiprocessing
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from gelgap.benchmarks.common.tables import print_table
from gelgap.benchmarks.physics.solve_jobs import own_cache, single_threaded
from gelgap.sim import ContactPath, Elastomer, Solution, Solve, SolvePlan, Sphere, plan_solves
from gelgap.sim.problem import ContactProblem

GEL = "b0"
SMALL_PAD_MM = (10.0, 8.0)
STATES = 200


@dataclass(frozen=True)
class PathCost:
    """The solves of a path, their load steps, and what they took.

    `wall_s` is of all processes, with their start; it and `again_s`, the same from the cache, are None where the path's
    cost was taken from one of its solves. `states` are those that were solved, `unconverged` those of them flagged.
    """

    pad_size_mm: tuple[float, float]
    quality: str
    solves: int
    load_steps: int
    core_s: float
    wall_s: float | None
    again_s: float | None
    states: int
    unconverged: int


def measure(quick: bool, processes: int, cache_folder: Path) -> list[PathCost]:
    """Measure the path, print it and how fast its membranes follow; in the quick form at `draft` alone."""
    gel, path = Elastomer.preset(GEL), ContactPath.preset("paper")
    costs = [
        whole_path(gel, path, quality, processes, cache_folder)
        for quality in (("draft",) if quick else ("draft", "standard"))
    ]
    if not quick:
        costs.append(small_pad(gel, path))
    rate = membrane_rate(plan_solves(gel, Sphere(), path, "draft"), cache_folder)
    columns = [
        "pad, mm",
        "quality",
        "solves",
        "load steps",
        "core s",
        "wall s",
        "again, wall s",
        "states",
        "unconverged",
    ]
    print_table(
        f"The paper's path, {len(path.poses)} poses, gel {GEL}, {processes} processes",
        columns,
        (
            [
                "{:g} × {:g}".format(*cost.pad_size_mm),
                cost.quality,
                cost.solves,
                cost.load_steps,
                cost.core_s,
                cost.wall_s,
                cost.again_s,
                cost.states,
                cost.unconverged,
            ]
            for cost in costs
        ),
        note="again: from the cache, as with another modulus if the mount is rigid; without wall time: from one of "
        f"its solves, by load steps; membranes come on top, {rate:.0f} a s on one core",
    )
    return costs


def whole_path(
    gel: Elastomer, path: ContactPath, quality: str, processes: int, cache_folder: Path
) -> PathCost:
    """Solve the path, and take it once more from what `cache_folder` then holds."""
    plan = plan_solves(gel, Sphere(), path, quality)
    with own_cache(cache_folder):
        started = time.perf_counter()
        solutions, core_s = run_solves(plan.solves, processes)
        wall_s = time.perf_counter() - started
        started = time.perf_counter()
        run_solves(plan.solves, processes)
        again_s = time.perf_counter() - started
    return PathCost(
        gel.pad_size_mm,
        quality,
        len(plan.solves),
        count_load_steps(plan.solves),
        core_s,
        wall_s,
        again_s,
        *_states(solutions),
    )


def small_pad(gel: Elastomer, path: ContactPath) -> PathCost:
    """Solve what a descent to the path's middle depth ends with, on a pad whose edges no contact is far from."""
    gel = gel.model_copy(update={"pad_size_mm": SMALL_PAD_MM})
    solves = plan_solves(gel, Sphere(), path, "standard").solves
    problems = [solve.problem for solve in solves]
    shallower = min(problem.depth_mm for problem in problems)
    chosen = _deepest_drags(
        max((problem for problem in problems if problem.depth_mm == shallower), key=lambda p: p.load_steps)
    )
    solutions, core_s = run_solves([Solve(chosen, cached=False)], 1)
    load_steps = count_load_steps(solves)
    return PathCost(
        SMALL_PAD_MM,
        "standard",
        len(solves),
        load_steps,
        core_s * load_steps / chosen.load_steps,
        None,
        None,
        *_states(solutions),
    )


def _deepest_drags(problem: ContactProblem) -> ContactProblem:
    """Return the problem with nothing but its deepest press, and the drags that branch off it."""
    press = problem.waypoints_mm.index((0.0, 0.0, -problem.depth_mm))
    return replace(
        problem,
        waypoints_mm=problem.waypoints_mm[press:],
        parents=(-1, *(parent - press for parent in problem.parents[press + 1 :])),
    )


def membrane_rate(plan: SolvePlan, cache_folder: Path) -> float:
    """Return how many membranes of a solved path one core makes a second."""
    with own_cache(cache_folder):
        solutions = {solve.key: solve.run() for solve in plan.solves}
    sample = range(1, len(plan.poses), max(1, len(plan.poses) // STATES))
    started = time.process_time()
    for index in sample:
        plan.state(index, solutions[plan.solve_key(index)])
    return len(sample) / (time.process_time() - started)


def run_solves(solves: Iterable[Solve], processes: int) -> tuple[list[Solution], float]:
    """Return the solutions and the processor s that they took."""
    spawn = multiprocessing.get_context("spawn")
    with single_threaded(), ProcessPoolExecutor(max_workers=processes, mp_context=spawn) as pool:
        outcomes = list(pool.map(_timed, solves))
    return [solution for solution, _ in outcomes], sum(seconds for _, seconds in outcomes)


def _timed(solve: Solve) -> tuple[Solution, float]:
    started = time.process_time()
    return solve.run(), time.process_time() - started


def count_load_steps(solves: Iterable[Solve]) -> int:
    return sum(solve.problem.load_steps for solve in solves)


def _states(solutions: Iterable[Solution]) -> tuple[int, int]:
    """Count the states, and those that did not converge."""
    records = [record for solution in solutions for record in solution.records]
    return len(records), sum(not record.converged for record in records)
