"""`gelgap benchmark physics --what estimate`: every pose's own estimate of its error beside the true one.

Scenes whose answer is known without a finer solve come first: slides without friction, touches, drags in several
directions, partial slip. Then random scenes, each solved on a fine mesh as well, or, if it is a press far from the
pad's edges, by the project's own axisymmetric solver.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from gelgap.benchmarks.fem.spheres import Press
from gelgap.benchmarks.physics.cases import Case, Floats, Solver
from gelgap.benchmarks.physics.references import Descent, own_cases
from gelgap.sim import Elastomer, Pose, Sphere
from gelgap.sim.estimate import CAUSES, causes_of_error

RANDOM_SCENES = 300
RADIUS_MM, THICKNESS_MM = (0.5, 6.0), (1.0, 10.0)
SHALLOWEST_MM = 0.01
WIDE_PAD_MM = (100.0, 100.0)
SURFACE_REACH_RADII = 4.0  # the membrane's error is that within so many contact radii


def random_case(number: int) -> Case:
    """Return random scene `number`: a press, and for every other one a drag that follows."""
    rng = np.random.default_rng(np.random.SeedSequence([20261, number]))
    radius, thickness = (float(np.exp(rng.uniform(*np.log(bounds)))) for bounds in (RADIUS_MM, THICKNESS_MM))
    deepest = min(0.4 * thickness, 0.8 * radius)
    share = (
        rng.uniform(0.05, 1.0) * deepest,
        float(np.exp(rng.uniform(np.log(SHALLOWEST_MM), np.log(deepest)))),
    )
    depth = round(share[number // 2 % 2], 4)
    poisson, friction = rng.uniform(0.3, 0.495), rng.choice([0.0, 10.0, *rng.uniform(0.05, 1.5, 4)])
    cut = math.sqrt(depth * (2 * radius - depth))
    travel, angle = rng.uniform(0.0, min(2.0 * cut, 0.5 * thickness)), rng.uniform(0.0, 2 * math.pi)
    inside = number % 8 != 3
    point = (0.0, 0.0) if inside else tuple(round(rng.uniform(-0.5, 0.5) * size, 3) for size in (24.0, 20.0))
    gel = Elastomer(
        young_modulus_mpa=0.3,
        poisson_ratio=round(poisson, 4),
        friction=round(float(friction), 4),
        thickness_mm=round(thickness, 3),
        pad_size_mm=WIDE_PAD_MM if inside else (24.0, 20.0),
        strain_energy="stable-neo-hookean",
    )
    places = {"point_x_mm": point[0], "point_y_mm": point[1], "depth_mm": depth}
    poses = [Pose(**places)]
    if number % 2:
        poses.append(
            Pose(
                **places,
                shear_x_mm=round(travel * math.cos(angle), 4),
                shear_y_mm=round(travel * math.sin(angle), 4),
            )
        )
    return Case(
        "random", f"scene {number}", gel, tuple(poses), indenter=Sphere(diameter_mm=round(2 * radius, 3))
    )


def descent_of(case: Case) -> Descent:
    """Return the axisymmetric press of a case that has no drag."""
    gel, radius = case.elastomer, case.indenter.radius_mm
    depth = case.poses[0].depth_mm
    press = Press(
        energy="stable",
        poisson_ratio=gel.poisson_ratio,
        friction=gel.friction if gel.friction < 10 else math.inf,
        indenter_radius_mm=radius,
        thickness_mm=gel.thickness_mm,
        pad_radius_mm=radius + 3.5 * gel.thickness_mm,
        element_mm=min(math.sqrt(radius * depth) / 12, gel.thickness_mm / 15),
    )
    return press, (depth,)


@dataclass(frozen=True)
class Expected:
    """The true force (3,), contact radius and displacement (ny, nx, 3) of a pose, on the grid of the state compared."""

    force_n: Floats
    radius_mm: float
    displacement_mm: Floats


def expected_states(case: Case, truth: Case, found: Any, states: Sequence[Any]) -> Iterator[Expected]:
    """Yield what the poses of a case should give: from its own truth, or from its solve on a fine mesh."""
    for index, state in enumerate(states):
        if truth.truth is not None:
            surface = truth.truth.displacement_mm(index, state.x_mm, state.y_mm)
            yield Expected(truth.truth.force_n[index], float(truth.truth.radius_mm[index]), surface)
        else:
            fine = found.states[index]
            yield Expected(fine.force_n, fine.contact_radius_mm, fine.displacement_mm)


def rows_of(case: Case, found: Any, expected: Iterator[Expected]) -> Iterator[dict[str, Any]]:
    """Yield a row for each pose: true errors beside estimates, and the causes that those are made of."""
    solution = found.solution
    for index, (state, right) in enumerate(zip(found.states, expected, strict=True)):
        size = float(np.linalg.norm(right.force_n))
        off = state.force_n - right.force_n
        pose = case.poses[index]
        near = (
            np.hypot(
                *np.meshgrid(
                    state.x_mm - pose.point_x_mm - pose.shear_x_mm,
                    state.y_mm - pose.point_y_mm - pose.shear_y_mm,
                )
            )
            < SURFACE_REACH_RADII * right.radius_mm
        )
        apart = np.linalg.norm(state.displacement_mm - right.displacement_mm, axis=-1)[near]
        record = solution.records[case.plan.placements[index].record]
        problem = solution.problem
        yield {
            "case": case.name,
            "quality": case.quality,
            "mesh": "disc" if problem.pad_mm is None and problem.symmetric else "pad",
            "pose": index,
            "converged": state.converged,
            "Fz": off[2] / size,
            "shear": float(np.hypot(*off[:2])) / size,
            "radius": state.contact_radius_mm / max(right.radius_mm, 1e-9) - 1,
            "membrane": float(np.sqrt((apart**2).mean())) / pose.depth_mm if near.any() else 0.0,
            "force N": size,
            "core s": found.solve_s,
            "excess": problem.stiffness_excess,
            **dict(zip(CAUSES, causes_of_error(problem, record, state.contact_radius_mm), strict=True)),
        }


def random_errors(numbers: Sequence[int], qualities: Sequence[str], solver: Solver) -> pd.DataFrame:
    """Return the rows of random scenes at some qualities."""
    cases = [random_case(number) for number in numbers]
    presses = [case for case in cases if len(case.poses) == 1 and case.elastomer.pad_size_mm == WIDE_PAD_MM]
    truths = dict(
        zip(presses, own_cases("random", [descent_of(case) for case in presses], solver), strict=True)
    )
    fine = solver.cases(replace(case, quality="fine") for case in cases if case not in truths)
    rows = []
    for quality in qualities:
        solved = solver.cases(replace(case, quality=quality) for case in cases)
        for case in cases:
            at = replace(case, quality=quality)
            found, finest = solved[at], replace(case, quality="fine")
            rows += rows_of(
                at, found, expected_states(at, truths.get(case, case), fine.get(finest), found.states)
            )
    return pd.DataFrame(rows)
