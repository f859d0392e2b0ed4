"""What solving the contact on a condensed equation is worth: time, and what it changes, against MuJoCo alone."""

import time
from collections.abc import Iterable
from dataclasses import astuple, dataclass, replace

import numpy as np

from gelgap.benchmarks.common.tables import print_table
from gelgap.benchmarks.physics.cases import Case, Workers
from gelgap.sim import Elastomer, Pose, PosePath, Sharing, Solution, Sphere, plan_solves
from gelgap.sim.mesh import unordered_mesh
from gelgap.sim.newton import StaticNewton, solve
from gelgap.sim.problem import ContactProblem, quality_named

GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.8)
POSES = (Pose(depth_mm=0.6), Pose(depth_mm=0.6, shear_x_mm=0.3))
CORNER = tuple(replace(pose, point_x_mm=3.0, point_y_mm=2.0) for pose in POSES)
ON_A_MOUNT = Elastomer.preset("b0")
SHALLOW = tuple(Pose(depth_mm=0.2, shear_x_mm=travel / 10) for travel in range(4))
SMALL_PAD = GEL.model_copy(update={"pad_size_mm": (10.0, 8.0)})
NOTHING_KEPT = Sharing(cache=False)
COLUMNS = (
    *("scene", "quality", "vertices", "iterations", "left to MuJoCo", "core s", "alone, core s"),
    *("force changes by", "membrane, mm", "ratio"),
)


@dataclass(frozen=True)
class Condensed:
    """One problem, solved on the condensed equation and by MuJoCo alone, in one process after the other.

    `left_to_mujoco` of the `iterations` were not solved by the condensed equation. The changes are those of the states'
    forces, as a share, and of where the membrane's vertices are.
    """

    name: str
    quality: str
    vertices: int
    iterations: int
    left_to_mujoco: int
    core_s: float
    alone_core_s: float
    force_change: float
    membrane_change_mm: float

    @property
    def ratio(self) -> float:
        return self.core_s / self.alone_core_s


def cases(quick: bool) -> list[Case]:
    """Return a press and drag without edges, and with; on a mount; and under a larger sphere."""
    scenes = [Case("press and drag", GEL, POSES, "draft", sharing=NOTHING_KEPT)]
    if quick:
        return scenes
    scenes += [
        replace(scenes[0], name="shallow, on a mount", elastomer=ON_A_MOUNT, poses=SHALLOW),
        replace(scenes[0], name="near the corner of a pad", elastomer=SMALL_PAD, poses=CORNER),
        replace(scenes[0], name="larger sphere", indenter=Sphere(diameter_mm=8.0)),
    ]
    return [replace(scene, quality=quality) for quality in ("draft", "standard") for scene in scenes]


def measure(chosen: Iterable[Case], workers: Workers) -> list[Condensed]:
    """Solve each case both ways, and print what it took and what changed."""
    found = workers.map(compare, chosen)
    print_table(
        "Contact solved on a condensed equation, against MuJoCo alone",
        COLUMNS,
        ((*astuple(one), one.ratio) for one in found),
        note="0.6 mm deep, in the shallow scene 0.2, then 0.3 mm sideways; times are of solves, models and meshes "
        "included; both take the same iterations",
    )
    return found


def compare(case: Case) -> Condensed:
    """Solve a case both ways in this process."""
    plan = plan_solves(
        case.elastomer, case.indenter, PosePath("visit", case.poses), case.quality, case.sharing
    )
    problem = plan.solves[0].problem
    # First imports and compilations are no part of the times.
    solve(replace(problem, waypoints_mm=((0.0, 0.0, -0.2),), parents=(-1,), quality=quality_named("draft")))
    (fast, left, fast_s), (slow, _, slow_s) = (_timed(problem, condensed=switch) for switch in (True, False))
    iterations = [sum(record.diagnostics.iterations for record in one.records) for one in (fast, slow)]
    if iterations[0] != iterations[1]:
        raise RuntimeError(
            f"{case.name}: the condensed solve took {iterations[0]} iterations, MuJoCo {iterations[1]}"
        )
    return Condensed(
        name=case.name,
        quality=case.quality,
        vertices=len(unordered_mesh(problem).vertices_mm),
        iterations=iterations[0],
        left_to_mujoco=left,
        core_s=fast_s,
        alone_core_s=slow_s,
        force_change=max(
            float(np.linalg.norm(a.force_n - b.force_n) / np.linalg.norm(b.force_n))
            for a, b in zip(fast.records, slow.records, strict=True)
        ),
        membrane_change_mm=max(
            float(np.abs(a.displacement_mm - b.displacement_mm).max())
            for a, b in zip(fast.records, slow.records, strict=True)
        ),
    )


def _timed(problem: ContactProblem, *, condensed: bool) -> tuple[Solution, int, float]:
    """Return a solution, its iterations left to MuJoCo, and its processor s."""
    start = time.process_time()
    newton = StaticNewton(problem, condensed=condensed)
    solution = newton.follow_waypoints()
    return solution, newton.left_to_mujoco, time.process_time() - start
