"""`gelgap benchmark physics --what estimate`: every pose's own estimate of its error beside the true one.

Scenes whose answer is known without a finer solve come first: slides without friction, touches, partial slip. Then
random scenes, each solved on a fine mesh as well, or, if it is a press far from the pad's edges, by the project's own
axisymmetric solver.
"""

import itertools
import math
import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import rms, show, write_json
from gelgap.benchmarks.fem import theory
from gelgap.benchmarks.physics.cases import Case, Floats, Solver, Truth
from gelgap.benchmarks.physics.references import NO_SLIP_FRICTION, Descent, own_cases, stable_press
from gelgap.sim import Elastomer, MembraneState, Pose, Sphere
from gelgap.sim.estimate import CAUSES, ERRORS, causes_of_error

RANDOM_SCENES, QUICK_SCENES = 300, (0, 12)
# Slides without friction: radius, thickness, depth, furthest travel, mm.
SLIDES = ((1.5, 3.0, 0.6, 3.0), (0.5, 6.0, 0.3, 2.0))
# Touches: radius and thickness, mm; each at every depth.
TOUCHES, TOUCH_DEPTHS_MM = ((1.5, 3.0), (3.0, 6.0), (5.0, 6.0), (5.0, 20.0)), (0.01, 0.02, 0.05, 0.1)
PARTIAL_SLIP_DEPTHS_MM = (0.1, 0.3)
RADIUS_MM, THICKNESS_MM = (0.5, 6.0), (1.0, 10.0)
SHALLOWEST_MM = 0.01
WIDE_PAD_MM = (100.0, 100.0)
SURFACE_REACH_RADII = 4.0  # the membrane's error is that within this many contact radii


def _gel(thickness_mm: float, **given: Any) -> Elastomer:
    fixed = {"young_modulus_mpa": 0.3, "poisson_ratio": 0.49, "friction": 0.0, "pad_size_mm": WIDE_PAD_MM}
    return Elastomer(**fixed | {"thickness_mm": thickness_mm, "strain_energy": "stable-neo-hookean"} | given)


def slide_rows(quality: str, solver: Solver) -> Iterator[dict[str, Any]]:
    """Yield how Fz changes and what Fx is where a sphere slides without friction: neither should be anything."""
    for radius, thickness, depth, furthest in SLIDES:
        poses = tuple(
            Pose(depth_mm=depth, shear_x_mm=share * furthest) for share in (0.0, 0.25, 0.5, 0.75, 1.0)
        )
        name = f"slide, R {radius:g} on {thickness:g}, {depth:g} deep, to {furthest:g}"
        case = Case("known", name, _gel(thickness), poses, quality, Sphere(diameter_mm=2 * radius))
        found = solver.cases([case])[case]
        force = np.array([state.force_n for state in found.states])
        yield _known_row(
            case, found, 100 * np.abs(force[:, 2] / force[0, 2] - 1).max(), "worst change of Fz, %"
        )
        yield _known_row(case, found, 100 * np.abs(force[:, 0] / force[:, 2]).max(), "worst Fx, % of Fz")


def touch_rows(quality: str, solver: Solver) -> Iterator[dict[str, Any]]:
    """Yield the errors of shallow presses without friction, by the axisymmetric solver."""
    cases = []
    for (radius, thickness), depth in itertools.product(TOUCHES, TOUCH_DEPTHS_MM):
        name, poses = f"touch, R {radius:g} on {thickness:g}, {depth:g} deep", (Pose(depth_mm=depth),)
        cases.append(Case("known", name, _gel(thickness), poses, quality, Sphere(diameter_mm=2 * radius)))
    truths = own_cases("touches", [descent_of(case) for case in cases], solver)
    solved = solver.cases(cases)
    for case, truth in zip(cases, truths, strict=True):
        error = 100 * (solved[case].states[0].force_n[2] / truth.truth.force_n[0, 2] - 1)
        yield _known_row(case, solved[case], error, "error of Fz, %")


def partial_slip_rows(quality: str, solver: Solver) -> Iterator[dict[str, Any]]:
    """Yield stiffness and sticking share of a drag with friction beside Cattaneo and Mindlin's, R 3 mm on 10 mm.

    Theory is that of a half-space, with the measured normal force and contact radius: G = E / (2 (1 + ν)), the first
    stiffness 8 a G / (2 − ν), and (c/a)³ = 1 − Q / μP for the radius c within which vertices stick. They carry
    the share 1 − (1 − c²/a²)^1.5 of the load. A half-space's sphere would travel further by what the backing holds
    back: (3 ln 2 / 8π) Q / (G h), to first order in a / h, for an incompressible gel.
    """
    for depth in PARTIAL_SLIP_DEPTHS_MM:
        gel = _gel(10.0, friction=0.3, poisson_ratio=0.495)
        shear_mpa = gel.young_modulus_mpa / (2 * (1 + gel.poisson_ratio))
        # By Hertz a press is μ d (2 − ν) / (2 (1 − ν)) short of slipping as a whole.
        full_mm = gel.friction * depth * (2 - gel.poisson_ratio) / (2 * (1 - gel.poisson_ratio))
        poses = tuple(
            Pose(depth_mm=depth, shear_x_mm=round(share * full_mm, 6)) for share in (0.0, 0.05, 0.4, 0.7)
        )
        name = f"partial slip, R 3 on 10, {depth:g} deep"
        case = Case("known", name, gel, poses, quality, Sphere(diameter_mm=6.0))
        found = solver.cases([case])[case]
        still, begun, *slipping = found.states
        radius, limit = still.contact_radius_mm, -gel.friction * still.force_n[2]
        contact = (limit, radius, shear_mpa, gel.poisson_ratio)
        expected_n = []
        for pose, state in zip(poses[1:], found.states[1:], strict=True):
            held_back_mm = 3 * math.log(2) / (8 * math.pi) * state.force_n[0] / (shear_mpa * gel.thickness_mm)
            expected_n.append(float(theory.partial_slip_force_n(*contact, pose.shear_x_mm + held_back_mm)))
        yield _known_row(case, found, 100 * (begun.force_n[0] / expected_n[0] - 1), "first stiffness, %")
        for pose, state, force_n in zip(poses[2:], slipping, expected_n[1:], strict=True):
            share = 1 - force_n / limit
            stick = 1 - (1 - share ** (2 / 3)) ** 1.5
            yield _known_row(
                case,
                found,
                state.diagnostics.sticking_fraction - stick,
                f"sticking share at {pose.shear_x_mm:g} mm",
            )


def _known_row(case: Case, found: Any, error: float, quantity: str) -> dict[str, Any]:
    flagged = sum(not state.converged or state.diagnostics.coarse for state in found.states)
    return {
        "scene": case.name,
        "quality": case.quality,
        "quantity": quantity,
        "error": error,
        "flagged": f"{flagged}/{len(found.states)}",
        "core s": found.solve_s,
    }


def random_case(number: int) -> Case:
    """Return random scene `number`: a press, and for every third a drag that follows."""
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
    travel, angle = rng.uniform(0.0, min(cut, 0.5 * thickness)), rng.uniform(0.0, 2 * math.pi)
    inside = number % 9 != 8
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
    if number % 3 == 2:
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
    gel = case.elastomer
    friction = gel.friction if gel.friction < NO_SLIP_FRICTION else math.inf
    scene = case.indenter.radius_mm, gel.thickness_mm, gel.poisson_ratio, friction
    return stable_press(*scene, case.poses[0].depth_mm)


def causes(case: Case, found: Any, index: int) -> Floats:
    """Return the causes of error of one pose of a case."""
    record = found.solution.records[case.plan.placements[index].record]
    return causes_of_error(found.solution.problem, record, found.states[index].contact_radius_mm)


def rows_of(case: Case, found: Any, truth: Truth | None, finer: Any) -> Iterator[dict[str, Any]]:
    """Yield a row for each pose: true errors beside estimates, and the causes of the difference.

    What is right comes from the case's truth, or without one from its solve on a finer mesh, which has errors, too.
    """
    for index, (pose, state) in enumerate(zip(case.poses, found.states, strict=True)):
        if truth is not None:
            force_n, radius_mm = truth.force_n[index], float(truth.radius_mm[index])
            surface_mm, own_causes = (
                truth.displacement_mm(index, state.x_mm, state.y_mm),
                np.zeros(len(CAUSES)),
            )
        else:
            right, own_causes = finer.states[index], causes(case, finer, index)
            force_n, radius_mm, surface_mm = right.force_n, right.contact_radius_mm, right.displacement_mm
        size, off = max(float(np.linalg.norm(force_n)), 1e-9), state.force_n - force_n
        x_mm, y_mm = (
            state.x_mm - pose.point_x_mm - pose.shear_x_mm,
            state.y_mm - pose.point_y_mm - pose.shear_y_mm,
        )
        near = np.hypot(*np.meshgrid(x_mm, y_mm)) < SURFACE_REACH_RADII * radius_mm
        apart = np.linalg.norm(state.displacement_mm - surface_mm, axis=-1)[near]
        together = np.sqrt(causes(case, found, index) ** 2 + own_causes**2)
        yield {
            "case": case.name,
            "quality": case.quality,
            "pose": index,
            "converged": state.converged,
            "coarse": state.diagnostics.coarse,
            "Fz": off[2] / size,
            "shear": float(np.hypot(*off[:2])) / size,
            "radius": state.contact_radius_mm / max(radius_mm, 1e-9) - 1,
            "membrane": rms(apart) / pose.depth_mm if near.any() else 0.0,
            **_estimates(state, pose),
            **dict(zip(CAUSES, together, strict=True)),
        }


def _estimates(state: MembraneState, pose: Pose) -> dict[str, float]:
    found, size = state.diagnostics, max(float(np.linalg.norm(state.force_n)), 1e-9)
    shares = (
        found.fz_error_n / size,
        found.shear_error_n * math.sqrt(2) / size,
        found.contact_radius_error_mm / max(state.contact_radius_mm, 1e-9),
        found.membrane_error_mm / pose.depth_mm,
    )
    return {f"estimated {error}": share for error, share in zip(ERRORS, shares, strict=True)}


def random_errors(
    numbers: Sequence[int], qualities: Sequence[str], solver: Solver, finest: str = "fine"
) -> pd.DataFrame:
    """Return the rows of random scenes at some qualities, beside the finest where there is no axisymmetric solution."""
    cases = [random_case(number) for number in numbers]
    presses = [case for case in cases if len(case.poses) == 1 and case.elastomer.pad_size_mm == WIDE_PAD_MM]
    truths = own_cases("random", [descent_of(case) for case in presses], solver)
    truth_of = {case: truth.truth for case, truth in zip(presses, truths, strict=True)}
    finer = solver.cases(replace(case, quality=finest) for case in cases if case not in truth_of)
    rows = []
    for quality in qualities:
        solved = solver.cases(replace(case, quality=quality) for case in cases)
        for case in cases:
            at, truth = replace(case, quality=quality), truth_of.get(case)
            if truth is not None or quality != finest:
                rows += rows_of(at, solved[at], truth, finer.get(replace(case, quality=finest)))
    return pd.DataFrame(rows)


def calibration_table(rows: pd.DataFrame) -> pd.DataFrame:
    """Print how often true errors are below twice their estimate, and estimates below four times the true error."""
    found = []
    for quality, own in rows.groupby("quality", sort=False):
        for error in ERRORS:
            true, estimate = own[error].abs(), own[f"estimated {error}"]
            unflagged = ~own["coarse"] & own["converged"]
            found.append(
                {
                    "quality": quality,
                    "error of": error,
                    "poses": len(own),
                    "rms %": 100 * rms(true),
                    "median estimate %": 100 * estimate.median(),
                    "true < 2 estimates, %": 100 * (true < 2 * estimate).mean(),
                    "estimate < 4 true, %": 100 * (estimate < 4 * true).mean(),
                    "flagged": int((~unflagged).sum()),
                    "worst unflagged %": 100 * true[unflagged].max(),
                }
            )
    table = pd.DataFrame(found)
    show(
        "Estimates of random scenes beside their true errors",
        table,
        "forces as shares of the whole force, the membrane's rms as a share of the depth",
    )
    return table


def run(quick: bool, out_dir: Path) -> None:
    """Run the benchmark, print its tables, and write `estimate.json` to `out_dir`."""
    solver = Solver(os.cpu_count() or 1, out_dir / "estimate-solves")
    qualities = ("draft",) if quick else ("draft", "standard")
    studies = (touch_rows,) if quick else (slide_rows, touch_rows, partial_slip_rows)
    known = pd.DataFrame(row for study in studies for quality in qualities for row in study(quality, solver))
    show("Scenes whose answer is known", known)
    rows = random_errors(QUICK_SCENES if quick else range(RANDOM_SCENES), qualities, solver)
    table = calibration_table(rows)
    write_json(out_dir / "estimate.json", {"known": known, "random": table})
    shutil.rmtree(solver.folder)
    print(f"results in {out_dir / 'estimate.json'}")
