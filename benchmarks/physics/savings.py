"""What each saving of a path's solves is worth: distinct solves, processor time, and the error that it adds.

The number of solves is exact. Their time is that of a representative one, by load steps: nobody waits for the 10,830
solves of the paper's path with nothing shared.
"""

from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from gelgap.benchmarks.common.tables import Point, print_table
from gelgap.benchmarks.physics.cases import Case, SolvedCase, Workers
from gelgap.benchmarks.physics.path import count_load_steps, solve_timed
from gelgap.benchmarks.physics.surface_errors import rms
from gelgap.sim import (
    CLASS_DEPTHS_MM,
    CLASS_RADII_MM,
    ContactPath,
    Elastomer,
    MembraneState,
    Pose,
    Sharing,
    SolvePlan,
    Sphere,
    plan_solves,
)
from gelgap.sim.problem import quality_named

FORCE_FLOOR_PERCENT = 0.03  # what a log axis shows for less
SERIES = "the paper's path, draft, one saving off: change of force"
OFF = {
    "all on": Sharing(),
    "modulus off": Sharing(modulus=False),
    "path off": Sharing(path=False),
    "translation off": Sharing(translation=False),
    "translation and reflection off": Sharing(translation=False, reflection=False),
    "nothing shared": Sharing(modulus=False, translation=False, reflection=False, path=False, cache=False),
}
GEL = Elastomer(young_modulus_mpa=0.6, poisson_ratio=0.49, friction=0.8)
CORNER = Pose(depth_mm=0.6, point_x_mm=3.75, point_y_mm=2.6)
TRAVEL_MM = 0.3
# Distances of edges in thicknesses of 3 mm, and the pose whose change is measured: the path's largest.
EDGE_DISTANCES = (2.0, 2.4, 2.75, 3.2)
LARGEST_POSE = Pose(depth_mm=1.0, shear_x_mm=0.6)
NEAR_MM = 5.0


@dataclass(frozen=True)
class Saving:
    """The paper's path for two gels that differ in modulus, one saving off (or all, or none)."""

    name: str
    solves: int
    core_s_per_pose: float
    force_error_percent: float
    surface_error_um: float


def measure(workers: Workers) -> dict[str, list]:
    """Measure the savings, and what edges and shared descents change; print all."""
    savings = list(_savings(cases(), workers))
    print_table(
        "Savings, draft: the paper's path for two gels that differ in modulus",
        ["saving", "solves", "core s/pose", "force error %", "surface error µm"],
        map(astuple, savings),
        note="errors: what the saving changes in a pose at the outermost point, 0.6 mm deep, 0.3 mm sideways",
    )
    return {"savings": savings, "edges": edge_effects(workers), "descents": descent_effects(workers)}


def cases() -> list[Case]:
    """Return a representative pose with each saving off, or the rest of its radial path where that shares its solve."""
    drag = replace(CORNER, shear_x_mm=TRAVEL_MM)
    path = tuple(replace(CORNER, shear_x_mm=travel / 10) for travel in range(1, 7))
    return [
        Case(name, GEL, path if sharing.path else (drag,), "draft", sharing=replace(sharing, cache=False))
        for name, sharing in OFF.items()
    ]


def _savings(chosen: Sequence[Case], workers: Workers) -> Iterator[Saving]:
    """Yield the savings: solves counted, their time from that of the representative pose."""
    solved = workers.solve(chosen)
    truth = next(s.states[0] for s in solved if s.case.name == "nothing shared")
    path = ContactPath.preset("paper")
    for outcome in solved:
        sharing = outcome.case.sharing
        plan = plan_solves(GEL, Sphere(), path, "draft", sharing)
        gels = 1 if sharing.modulus else 2
        travels = [pose.radius_mm for pose in outcome.case.poses]
        state = outcome.states[int(np.argmin(np.abs(np.array(travels) - TRAVEL_MM)))]
        core_s = gels * _core_s(plan, outcome) / (2 * len(path.poses))
        # A modulus that is shared serves both gels from the same solves.
        yield Saving(outcome.case.name, gels * len(plan.solves), core_s, *_change(state, truth, CORNER))


def _core_s(plan: SolvePlan, sample: SolvedCase) -> float:
    """Return the processor s of a plan from what a load step of a sample took."""
    poses = [(pose.shear_x_mm, pose.shear_y_mm, -pose.depth_mm) for pose in sample.case.poses]
    places = np.array([(0.0, 0.0, 0.0), (0.0, 0.0, -CORNER.depth_mm), *poses])
    load_steps = sum(map(quality_named("draft").load_steps, np.diff(places, axis=0)))
    return count_load_steps(plan.solves) * sample.processor_s / load_steps


def edge_cases() -> list[Case]:
    """Return the largest pose without edges, then with edges ahead and behind or on both sides, by their distance."""
    sizes = {"far": (100.0, 100.0)}
    for thicknesses in EDGE_DISTANCES:
        width = 2 * thicknesses * GEL.thickness_mm
        sizes |= {
            f"ahead and behind {thicknesses:g}": (width, 100.0),
            f"on both sides {thicknesses:g}": (100.0, width),
        }
    sharing = Sharing(translation=False, cache=False)
    return [
        Case(name, GEL.model_copy(update={"pad_size_mm": size}), (LARGEST_POSE,), "draft", sharing=sharing)
        for name, size in sizes.items()
    ]


def edge_effects(workers: Workers) -> list[list[object]]:
    """Print what edges change, ahead and behind a drag or beside it, by their distance."""
    rows: list[list[object]] = []
    far, *others = workers.solve(edge_cases())
    far_state = far.states[0]
    x, y = np.meshgrid(far_state.x_mm, far_state.y_mm)
    for other in others:
        (state,), (width, height) = other.states, other.case.elastomer.pad_size_mm
        near = (np.hypot(x, y) <= NEAR_MM) & (np.abs(x) <= width / 2) & (np.abs(y) <= height / 2)
        change = 1e3 * np.linalg.norm((state.displacement_mm - far_state.displacement_mm)[near], axis=-1)
        fx, _, fz = 100 * (state.force_n / np.where(far_state.force_n, far_state.force_n, 1.0) - 1)
        where, thicknesses = other.case.name.rsplit(" ", 1)
        rows.append([where, float(thicknesses), fx, fz, rms(change), change.max()])
    print_table(
        "What translation neglects, draft: edges on both sides of a contact, 1 mm deep and 0.6 mm sideways",
        ["edges", "thicknesses away", "Fx %", "Fz %", "surface rms µm", "worst µm"],
        rows,
        note="change against the same pose on a pad of 100 × 100 mm; surface: within 5 mm of the contact point",
    )
    return rows


def descent_effects(workers: Workers) -> list[list[object]]:
    """Print how each depth of the paper's path changes when it shares a solve with others."""
    rows: list[list[object]] = []
    path = ContactPath("descents", (0.0,), (0.0,), CLASS_DEPTHS_MM, CLASS_RADII_MM, (0.0,))
    plans = [
        plan_solves(GEL, Sphere(), path, "draft", Sharing(path=shared, cache=False))
        for shared in (True, False)
    ]
    wanted = [index for index, pose in enumerate(path.poses) if pose.radius_mm == TRAVEL_MM]
    keys = {plan.solve_key(index) for plan in plans for index in wanted}
    solves = [solve for plan in plans for solve in plan.solves if solve.key in keys]
    solutions = {timed.solution.problem.key: timed.solution for timed in workers.map(solve_timed, solves)}
    for index in wanted:
        shared, alone = (plan.state(index, solutions[plan.solve_key(index)]) for plan in plans)
        rows.append([path.poses[index].depth_mm, *_change(shared, alone, Pose(depth_mm=0.0))])
    print_table(
        "What shared descents change, draft: 0.3 mm sideways at the depths of the paper's path",
        ["depth mm", "force %", "surface rms µm"],
        rows,
    )
    return rows


def points(savings: Sequence[Saving]) -> list[Point]:
    """Return the savings as points of the frontier: processor time against error."""
    return [
        Point(SERIES, s.name, s.core_s_per_pose, max(s.force_error_percent, FORCE_FLOOR_PERCENT))
        for s in savings
    ]


def _change(state: MembraneState, right: MembraneState, point: Pose) -> tuple[float, float]:
    """Return how far a state is from the right one: force in %, surface rms in µm within 5 mm of the contact point."""
    force = 100 * np.linalg.norm(state.force_n - right.force_n) / np.linalg.norm(right.force_n)
    x, y = np.meshgrid(right.x_mm - point.point_x_mm, right.y_mm - point.point_y_mm)
    error = (state.displacement_mm - right.displacement_mm)[np.hypot(x, y) <= NEAR_MM]
    return float(force), 1e3 * rms(np.linalg.norm(error, axis=-1))
