"""What the solves of the paper's whole path cost: on the default pad, measured, and on a small one, from one solve."""

import multiprocessing
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from gelgap.benchmarks.solve_jobs import own_cache, single_threaded
from gelgap.benchmarks.tables import print_table
from gelgap.sim.elastomer import Elastomer
from gelgap.sim.indentation import Solution
from gelgap.sim.indenter import Sphere
from gelgap.sim.path import ContactPath
from gelgap.sim.sharing import Solve, SolvePlan, plan_solves

GEL = "b0"
SMALL_PAD_MM = (10.0, 8.0)
STATES = 200


@dataclass(frozen=True)
class PathCost:
    """The solves of a path, how many drags branch off their presses, and what they took.

    `wall_s` is of all processes, with their start; it and `again_s`, the same from the cache, are None where the path's
    cost was taken from one of its solves. `states` are those that were solved, `unconverged` those of them flagged.
    """

    pad_size_mm: tuple[float, float]
    quality: str
    solves: int
    drags: int
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
        "drags",
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
                cost.drags,
                cost.core_s,
                cost.wall_s,
                cost.again_s,
                cost.states,
                cost.unconverged,
            ]
            for cost in costs
        ),
        note="again: from the cache, as with another modulus if the mount is rigid; without wall time: from one of "
        f"its solves, by drags; membranes come on top, {rate:.0f} a s on one core",
    )
    return costs


def whole_path(
    gel: Elastomer, path: ContactPath, quality: str, processes: int, cache_folder: Path
) -> PathCost:
    """Solve the path, and take it once more from what `cache_folder` then holds."""
    plan = plan_solves(gel, Sphere(), path, quality)
    with own_cache(cache_folder):
        started = time.perf_counter()
        solutions, core_s = _run(plan.solves, processes)
        wall_s = time.perf_counter() - started
        started = time.perf_counter()
        _run(plan.solves, processes)
        again_s = time.perf_counter() - started
    return PathCost(
        gel.pad_size_mm,
        quality,
        len(plan.solves),
        count_drags(plan.solves),
        core_s,
        wall_s,
        again_s,
        *_states(solutions),
    )


def small_pad(gel: Elastomer, path: ContactPath) -> PathCost:
    """Solve the middle depth at one point of a pad whose edges no contact is far from."""
    gel = gel.model_copy(update={"pad_size_mm": SMALL_PAD_MM})
    solves = plan_solves(gel, Sphere(), path, "standard").solves
    depths = sorted({solve.problem.waypoints_mm[0][2] for solve in solves})
    middle = [solve for solve in solves if solve.problem.waypoints_mm[0][2] == depths[len(depths) // 2]]
    chosen = max(middle, key=lambda solve: solve.problem.parents.count(0))
    solutions, core_s = _run([Solve(chosen.problem, cached=False)], 1)
    drags = count_drags(solves)
    share = count_drags([chosen]) / drags
    return PathCost(
        SMALL_PAD_MM, "standard", len(solves), drags, core_s / share, None, None, *_states(solutions)
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


def _run(solves: Iterable[Solve], processes: int) -> tuple[list[Solution], float]:
    """Return the solutions and the processor s that they took."""
    spawn = multiprocessing.get_context("spawn")
    with single_threaded(), ProcessPoolExecutor(max_workers=processes, mp_context=spawn) as pool:
        outcomes = list(pool.map(_timed, solves))
    return [solution for solution, _ in outcomes], sum(seconds for _, seconds in outcomes)


def _timed(solve: Solve) -> tuple[Solution, float]:
    started = time.process_time()
    return solve.run(), time.process_time() - started


def count_drags(solves: Iterable[Solve]) -> int:
    """Count the drags that branch off presses, and the presses where none does."""
    return sum(max(1, solve.problem.parents.count(0)) for solve in solves)


def _states(solutions: Iterable[Solution]) -> tuple[int, int]:
    """Count the states, and those that did not converge."""
    records = [record for solution in solutions for record in solution.records]
    return len(records), sum(not record.converged for record in records)
