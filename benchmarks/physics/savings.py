"""What each saving of a path's solves is worth: distinct solves, processor time, and the error that it adds.

The number of solves is exact. Their time is that of a representative one, by load steps: nobody waits for the 10,830
solves of the paper's path with nothing shared.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gelgap.benchmarks.common.tables import Point, print_table
from gelgap.benchmarks.physics.path import count_load_steps, run_solves
from gelgap.benchmarks.physics.solve_jobs import Job, Outcome, solve_jobs
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
from gelgap.sim.quality import quality_named

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
# How far an edge may be, in thicknesses of 3 mm, and the pose whose change is measured: the path's largest.
EDGE_DISTANCES = (2.0, 2.4, 2.75, 3.2)
LARGEST_POSE = Pose(depth_mm=1.0, shear_x_mm=0.6)
REACH_MM = 5.0


@dataclass(frozen=True)
class Saving:
    """The paper's path for two gels that differ in modulus, one saving off (or all, or none)."""

    name: str
    solves: int
    core_s_per_pose: float
    force_error_percent: float | None
    surface_error_um: float | None


@dataclass(frozen=True)
class EdgeEffect:
    """What edges at a distance change in the largest pose: components of force in %, the membrane within 5 mm in µm."""

    where: str
    thicknesses: float
    fx_percent: float
    fz_percent: float
    surface_rms_um: float
    surface_worst_um: float


@dataclass(frozen=True)
class DescentEffect:
    """What a descent shared with deeper poses, whose mesh it then has, changes in a pose: force and membrane."""

    depth_mm: float
    force_percent: float
    surface_rms_um: float


@dataclass(frozen=True)
class Savings:
    """All savings at `draft`, what translation neglects, and what shared descents change."""

    savings: tuple[Saving, ...]
    edges: tuple[EdgeEffect, ...]
    descents: tuple[DescentEffect, ...]


def measure(quick: bool, processes: int) -> Savings:
    """Measure the savings and what edges change, and print both."""
    savings = tuple(_savings(quick, processes))
    print_table(
        "Savings, draft: the paper's path for two gels that differ in modulus",
        ["saving", "solves", "core s a pose", "force error %", "surface error µm"],
        ([s.name, s.solves, s.core_s_per_pose, s.force_error_percent, s.surface_error_um] for s in savings),
        note="errors: what the saving changes in a pose at the outermost point, 0.6 mm deep, 0.3 mm sideways",
    )
    edges = () if quick else tuple(edge_effects(processes))
    if edges:
        print_table(
            "What translation neglects, draft: edges on both sides of a contact, 1 mm deep and 0.6 mm sideways",
            ["edges", "thicknesses away", "Fx %", "Fz %", "surface rms µm", "worst µm"],
            (
                [
                    e.where,
                    e.thicknesses,
                    e.fx_percent,
                    e.fz_percent,
                    e.surface_rms_um,
                    e.surface_worst_um,
                ]
                for e in edges
            ),
            note="change against the same pose on a pad of 100 × 100 mm; surface: within 5 mm of the contact point",
        )
    descents = () if quick else tuple(descent_effects(processes))
    if descents:
        print_table(
            "What shared descents change, draft: 0.3 mm sideways at the depths of the paper's path",
            ["depth mm", "force %", "surface rms µm"],
            ([d.depth_mm, d.force_percent, d.surface_rms_um] for d in descents),
        )
    return Savings(savings, edges, descents)


def descent_effects(processes: int) -> Iterator[DescentEffect]:
    """Yield what each depth of the paper's path changes by being solved with others, and not for itself."""
    path = ContactPath("descents", (0.0,), (0.0,), CLASS_DEPTHS_MM, CLASS_RADII_MM, (0.0,))
    together, alone = (
        plan_solves(GEL, Sphere(), path, "draft", Sharing(path=shared, cache=False))
        for shared in (True, False)
    )
    wanted = [index for index, pose in enumerate(path.poses) if pose.radius_mm == TRAVEL_MM]
    keys = [together.solve_key(index) for index in wanted] + [alone.solve_key(index) for index in wanted]
    solves = {solve.key: solve for solve in (*together.solves, *alone.solves) if solve.key in keys}
    solutions = dict(zip(solves, run_solves(solves.values(), processes)[0], strict=True))
    for index in wanted:
        shared, right = (plan.state(index, solutions[plan.solve_key(index)]) for plan in (together, alone))
        yield DescentEffect(path.poses[index].depth_mm, *_change(shared, right, Pose(depth_mm=0.0)))


def edge_effects(processes: int) -> Iterator[EdgeEffect]:
    """Yield what edges change, ahead and behind a drag or beside it, by their distance."""
    sizes = {("far", math.inf): (100.0, 100.0)}
    for thicknesses in EDGE_DISTANCES:
        width = 2 * thicknesses * GEL.thickness_mm
        sizes["ahead and behind", thicknesses] = (width, 100.0)
        sizes["on both sides", thicknesses] = (100.0, width)
    alone = Sharing(translation=False, cache=False)
    jobs = [
        Job(where, GEL.model_copy(update={"pad_size_mm": size}), (LARGEST_POSE,), "draft", sharing=alone)
        for (where, _), size in sizes.items()
    ]
    far, *others = (outcome.states[0] for outcome in solve_jobs(jobs, processes))
    x, y = np.meshgrid(far.x_mm, far.y_mm)
    for ((where, thicknesses), (width, height)), state in zip(list(sizes.items())[1:], others, strict=True):
        near = (np.hypot(x, y) <= REACH_MM) & (np.abs(x) <= width / 2) & (np.abs(y) <= height / 2)
        change = 1e3 * np.linalg.norm((state.displacement_mm - far.displacement_mm)[near], axis=-1)
        fx, _, fz = 100 * (state.force_n / np.where(far.force_n, far.force_n, 1.0) - 1)
        rms = float(np.sqrt((change**2).mean()))
        yield EdgeEffect(where, thicknesses, float(fx), float(fz), rms, float(change.max()))


def points(savings: Savings) -> list[Point]:
    """Return the savings as points of the frontier: what is left on costs time, what is shared costs error."""
    return [
        Point(
            SERIES,
            s.name,
            s.core_s_per_pose,
            max(s.force_error_percent, FORCE_FLOOR_PERCENT),
        )
        for s in savings.savings
        if s.force_error_percent is not None
    ]


def _savings(quick: bool, processes: int):
    """Yield the savings at draft: solves counted, a representative pose solved with and without each."""
    pose = replace(CORNER, shear_x_mm=TRAVEL_MM)
    names = ["all on", "modulus off"] if quick else [*OFF]
    jobs = [
        Job(name, GEL, _poses(pose, OFF[name]), "draft", sharing=replace(OFF[name], cache=False))
        for name in names
    ]
    outcomes: dict[str, Outcome] = {outcome.job.name: outcome for outcome in solve_jobs(jobs, processes)}
    truth = None if quick else outcomes["nothing shared"]
    path = ContactPath.preset("paper")
    for name in names:
        plan = plan_solves(GEL, Sphere(), path, "draft", OFF[name])
        gels = 2 if not OFF[name].modulus else 1
        outcome = outcomes[name]
        force_percent, surface_um = _difference(outcome, truth) if truth else (None, None)
        yield Saving(
            name=name,
            solves=gels * len(plan.solves),
            core_s_per_pose=gels * _core_s(plan, outcome) / (2 * len(path.poses)),
            force_error_percent=force_percent,
            surface_error_um=surface_um,
        )


def _core_s(plan: SolvePlan, sample: Outcome) -> float:
    """Return the processor s of a plan from what a load step of a sample took."""
    places = np.array([(0.0, 0.0, 0.0), (0.0, 0.0, -CORNER.depth_mm), *map(_place, sample.job.poses)])
    load_steps = sum(map(quality_named("draft").load_steps, np.diff(places, axis=0)))
    return count_load_steps(plan.solves) * sample.processor_s / load_steps


def _place(pose: Pose) -> tuple[float, float, float]:
    return pose.shear_x_mm, pose.shear_y_mm, -pose.depth_mm


def _poses(pose: Pose, sharing: Sharing) -> tuple[Pose, ...]:
    """The pose alone, or with the rest of its radial path where that is solved together."""
    if not sharing.path:
        return (pose,)
    travels = [travel / 10 for travel in range(1, 7)]
    angle = math.radians(pose.angle_deg)
    return tuple(
        replace(pose, shear_x_mm=t * math.cos(angle), shear_y_mm=round(t * math.sin(angle), 12))
        for t in travels
    )


def _difference(outcome: Outcome, truth: Outcome) -> tuple[float, float]:
    """Return how far the pose is from that with nothing shared: force in %, surface rms in µm within 5 mm."""
    state = min(
        zip(outcome.job.poses, outcome.states, strict=True),
        key=lambda pair: abs(pair[0].radius_mm - TRAVEL_MM),
    )[1]
    return _change(state, truth.states[0], CORNER)


def _change(state: MembraneState, right: MembraneState, point: Pose) -> tuple[float, float]:
    """Return how far a state is from the right one: force in %, surface rms in µm within 5 mm of the contact point."""
    force = 100 * np.linalg.norm(state.force_n - right.force_n) / np.linalg.norm(right.force_n)
    x, y = np.meshgrid(right.x_mm - point.point_x_mm, right.y_mm - point.point_y_mm)
    error = (state.displacement_mm - right.displacement_mm)[np.hypot(x, y) <= REACH_MM]
    return float(force), float(1e3 * np.sqrt((error**2).sum(-1).mean()))
