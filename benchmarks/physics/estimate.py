"""`gelgap benchmark physics --what estimate`: every pose's own estimate of its error beside the true one.

Random scenes are solved on a fine mesh as well, or, if they are a press far from the pad's edges, by the project's own
axisymmetric solver.
"""

import math
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import rms, show, write_json
from gelgap.benchmarks.physics.cases import Case, Floats, Solver, Truth
from gelgap.benchmarks.physics.references import NO_SLIP_FRICTION, Descent, axisymmetric_press, own_cases
from gelgap.sim import Elastomer, Pose, Sphere
from gelgap.sim.estimate import CAUSES, ERRORS, causes_of_error

RANDOM_SCENES, QUICK_SCENES = 300, (0, 12)
RADIUS_MM, THICKNESS_MM = (0.5, 6.0), (1.0, 10.0)
SHALLOWEST_MM = 0.01
WIDE_PAD_MM = (100.0, 100.0)
PLOTTED = {"Fz": "Fz", "radius": "contact radius", "membrane": "membrane, of the depth"}
PLOTTED_PERCENT = np.array([0.01, 12.0])
SURFACE_REACH_RADII = 4.0  # the membrane's error is that within this many contact radii


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
    poses = [Pose(depth, point_x_mm=point[0], point_y_mm=point[1])]
    if number % 3 == 2:
        x_mm, y_mm = (round(travel * of(angle), 4) for of in (math.cos, math.sin))
        poses.append(replace(poses[0], shear_x_mm=x_mm, shear_y_mm=y_mm))
    ball = Sphere(diameter_mm=round(2 * radius, 3))
    return Case("random", f"scene {number}", gel, tuple(poses), indenter=ball)


def descent_of(case: Case) -> Descent:
    """Return the axisymmetric press of a case that has no drag."""
    gel = case.elastomer
    friction = gel.friction if gel.friction < NO_SLIP_FRICTION else math.inf
    scene = case.indenter.radius_mm, gel.thickness_mm, gel.poisson_ratio, friction
    return axisymmetric_press(*scene, case.poses[0].depth_mm)


def causes(case: Case, found: Any, index: int) -> Floats:
    """Return the causes of error of one pose of a case."""
    record = found.solution.records[case.plan.placements[index].record]
    return causes_of_error(found.solution.problem, record, found.states[index].contact_radius_mm)


def rows_of(case: Case, found: Any, truth: Truth | None, finer: Any) -> Iterator[dict[str, Any]]:
    """Yield a row for each pose: true errors beside estimates, and the causes of the difference.

    What is right comes from the case's truth, or without one from its solve on a finer mesh, which has errors, too, and
    is not `known` where it did not converge.
    """
    for index, (pose, state) in enumerate(zip(case.poses, found.states, strict=True)):
        if truth is not None:
            right, own_causes = truth.state(index, state), np.zeros(len(CAUSES))
        else:
            right, own_causes = finer.states[index], causes(case, finer, index)
        size_n, own_size_n = (max(float(np.linalg.norm(s.force_n)), 1e-9) for s in (right, state))
        off_n, estimates = state.force_n - right.force_n, state.diagnostics
        x_mm = state.x_mm - pose.point_x_mm - pose.shear_x_mm
        y_mm = state.y_mm - pose.point_y_mm - pose.shear_y_mm
        near = np.hypot(*np.meshgrid(x_mm, y_mm)) < SURFACE_REACH_RADII * right.contact_radius_mm
        apart_mm = np.linalg.norm(state.displacement_mm - right.displacement_mm, axis=-1)[near]
        true = (
            off_n[2] / size_n,
            float(np.hypot(*off_n[:2])) / size_n,
            state.contact_radius_mm / max(right.contact_radius_mm, 1e-9) - 1,
            rms(apart_mm) / pose.depth_mm if near.any() else 0.0,
        )
        estimated = (
            estimates.fz_error_n / own_size_n,
            estimates.shear_error_n * math.sqrt(2) / own_size_n,
            estimates.contact_radius_error_mm / max(state.contact_radius_mm, 1e-9),
            estimates.membrane_error_mm / pose.depth_mm,
        )
        yield {
            "case": case.name,
            "quality": case.quality,
            "pose": index,
            "known": right.converged,
            "converged": state.converged,
            "coarse": estimates.coarse,
            **dict(zip(ERRORS, true, strict=True)),
            **dict(zip((f"estimated {error}" for error in ERRORS), estimated, strict=True)),
            **dict(zip(CAUSES, np.hypot(causes(case, found, index), own_causes), strict=True)),
        }


def random_errors(
    numbers: Sequence[int], qualities: Sequence[str], solver: Solver, finest: str = "fine"
) -> pd.DataFrame:
    """Return the rows of random scenes at some qualities, beside the finest where there is no axisymmetric solution."""
    cases = [random_case(number) for number in numbers]
    presses = [case for case in cases if len(case.poses) == 1 and case.elastomer.pad_size_mm == WIDE_PAD_MM]
    own = own_cases("random", list(map(descent_of, presses)), solver)
    truth_of = {case: truth.truth for case, truth in zip(presses, own, strict=True)}
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
    for quality, own in rows[rows["known"]].groupby("quality", sort=False):
        unflagged = ~own["coarse"] & own["converged"]
        for error in ERRORS:
            true, estimate = own[error].abs(), own[f"estimated {error}"]
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
    note = "forces as shares of the whole force, the membrane's rms as a share of the depth"
    show("Estimates of random scenes beside their true errors", table := pd.DataFrame(found), note)
    return table


def run(quick: bool, out_dir: Path) -> None:
    """Run the benchmark, print its tables, and write `estimate.json` and `estimates.png` to `out_dir`."""
    solver = Solver(None, out_dir / "estimate-solves")
    qualities = ("draft",) if quick else ("draft", "standard")
    rows = random_errors(QUICK_SCENES if quick else range(RANDOM_SCENES), qualities, solver)
    table = calibration_table(rows)
    write_json(out_dir / "estimate.json", {"random": table})
    plot_estimates(rows, out_dir / "estimates.png")
    shutil.rmtree(solver.folder)
    print(f"results in {out_dir / 'estimate.json'}, plot in {out_dir / 'estimates.png'}")


def plot_estimates(rows: pd.DataFrame, path: Path) -> None:
    """Plot true errors of unflagged poses over their estimates, with lines at two estimates and at a fourth of one."""
    from matplotlib.figure import Figure

    unflagged = rows[rows["known"] & rows["converged"] & ~rows["coarse"]]
    figure, ends = Figure(figsize=(9, 3.1), layout="constrained"), PLOTTED_PERCENT
    for axes, error in zip(figure.subplots(1, len(PLOTTED)), PLOTTED, strict=True):
        for quality, own in unflagged.groupby("quality"):
            true, estimate = 100 * own[error].abs(), 100 * own[f"estimated {error}"]
            axes.loglog(estimate, true.clip(lower=ends[0]), ".", markersize=3, label=quality)
        axes.loglog(ends, 2 * ends, "k-", ends, ends / 4, "k:", linewidth=0.8)
        axes.set(
            xlim=(0.2, 10), ylim=ends, xlabel="estimate, %", ylabel="true error, %", title=PLOTTED[error]
        )
        axes.legend(fontsize=8)
    figure.savefig(path, dpi=100)
