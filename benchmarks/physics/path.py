"""What the solves of the paper's whole path cost: on the default pad, measured, and on a small one, from one solve."""

import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gelgap.benchmarks.common.tables import print_table
from gelgap.benchmarks.physics.cases import Workers, own_cache
from gelgap.sim import ContactPath, Elastomer, Solution, Solve, SolvePlan, Sphere, plan_solves
from gelgap.sim.problem import ContactProblem

GEL = "b0"
SMALL_PAD_MM = (10.0, 8.0)
STATES = 200


@dataclass(frozen=True)
class PathScene:
    """A path over a gel at one quality, and in how many processes it is solved."""

    gel: Elastomer
    path: ContactPath
    quality: str
    processes: int

    @property
    def plan(self) -> SolvePlan:
        return plan_solves(self.gel, Sphere(), self.path, self.quality)


@dataclass(frozen=True)
class PathCost:
    """The solves of a path, their load steps, and what they took.

    `wall_s` is of all processes, with their start; it, `again_s` (the same from the cache) and `membranes_per_s` are
    None where the path's cost was taken from one of its solves. `states` are those that were solved, `unconverged`
    those of them flagged.
    """

    pad_size_mm: tuple[float, float]
    quality: str
    solves: int
    load_steps: int
    core_s: float
    states: int
    unconverged: int
    wall_s: float | None = None
    again_s: float | None = None
    membranes_per_s: float | None = None


@dataclass(frozen=True)
class TimedSolution:
    """A solution and the processor s that it took."""

    solution: Solution
    core_s: float


def measure(workers: Workers) -> list[PathCost]:
    """Measure the path, and print its cost and the rate of its membranes."""
    gel, path = Elastomer.preset(GEL), ContactPath.preset("paper")
    scenes = [PathScene(gel, path, quality, workers.processes) for quality in ("draft", "standard")]
    # One at a time, since the wall time counts.
    costs = replace(workers, processes=1).map(whole_path, scenes)
    small = PathScene(gel.model_copy(update={"pad_size_mm": SMALL_PAD_MM}), path, "standard", 1)
    costs.append(small_pad(small, workers))
    print_table(
        f"The paper's path, {len(path.poses)} poses, gel {GEL}, {workers.processes} processes",
        ["pad, mm", "quality", "solves", "load steps", "core s", "wall s", "again, wall s", "states", "unconverged"],
        (
            ["{:g} × {:g}".format(*c.pad_size_mm), c.quality, c.solves, c.load_steps, c.core_s, c.wall_s, c.again_s,
             c.states, c.unconverged]
            for c in costs
        ),
        note="again: from the cache, as with another modulus if the mount is rigid; without wall time: from one of "
        f"its solves, by load steps; membranes come on top, {costs[0].membranes_per_s:.0f} per s on one core",
    )  # fmt: skip
    return costs


def whole_path(scene: PathScene) -> PathCost:
    """Solve the path, and take it once more from the cache that then holds it."""
    plan = scene.plan
    with tempfile.TemporaryDirectory() as name, own_cache(Path(name)):
        solved, wall_s = _timed_map(plan.solves, Workers(scene.processes, Path(name) / "first"))
        _, again_s = _timed_map(plan.solves, Workers(scene.processes, Path(name) / "again"))
    solutions = {solve.key: timed.solution for solve, timed in zip(plan.solves, solved, strict=True)}
    return PathCost(
        scene.gel.pad_size_mm,
        scene.quality,
        len(plan.solves),
        count_load_steps(plan.solves),
        sum(timed.core_s for timed in solved),
        *_states(solutions.values()),
        wall_s,
        again_s,
        membrane_rate(plan, solutions),
    )


def small_pad(scene: PathScene, workers: Workers) -> PathCost:
    """Solve the press to the path's middle depth and its drags, on a pad whose edges are near every contact."""
    solves = scene.plan.solves
    problems = [solve.problem for solve in solves]
    shallowest = min(problem.depth_mm for problem in problems)
    longest = max((p for p in problems if p.depth_mm == shallowest), key=lambda problem: problem.load_steps)
    chosen = _deepest_drags(longest)
    (timed,) = workers.map(solve_timed, [Solve(chosen, cached=False)])
    load_steps = count_load_steps(solves)
    core_s = timed.core_s * load_steps / chosen.load_steps
    return PathCost(
        scene.gel.pad_size_mm, scene.quality, len(solves), load_steps, core_s, *_states([timed.solution])
    )


def _deepest_drags(problem: ContactProblem) -> ContactProblem:
    """Return the problem with nothing but its deepest press, and the drags that branch off it."""
    press = problem.waypoints_mm.index((0.0, 0.0, -problem.depth_mm))
    return replace(
        problem,
        waypoints_mm=problem.waypoints_mm[press:],
        parents=(-1, *(parent - press for parent in problem.parents[press + 1 :])),
    )


def membrane_rate(plan: SolvePlan, solutions: dict[str, Solution]) -> float:
    """Return how many membranes of a solved path one core makes per second."""
    sample = range(1, len(plan.poses), max(1, len(plan.poses) // STATES))
    started = time.process_time()
    for index in sample:
        plan.state(index, solutions[plan.solve_key(index)])
    return len(sample) / (time.process_time() - started)


def solve_timed(solve: Solve) -> TimedSolution:
    """Solve a problem, or take it from the cache."""
    started = time.process_time()
    return TimedSolution(solve.run(), time.process_time() - started)


def count_load_steps(solves: Iterable[Solve]) -> int:
    return sum(solve.problem.load_steps for solve in solves)


def _timed_map(solves: Sequence[Solve], workers: Workers) -> tuple[list[TimedSolution], float]:
    started = time.perf_counter()
    return workers.map(solve_timed, solves), time.perf_counter() - started


def _states(solutions: Iterable[Solution]) -> tuple[int, int]:
    """Count the states, and those that did not converge."""
    records = [record for solution in solutions for record in solution.records]
    return len(records), sum(not record.converged for record in records)
