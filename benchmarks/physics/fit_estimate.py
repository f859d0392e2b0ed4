"""Fit `variance_per_cause` of `assets/fitted/estimate.toml`: how much error each cause of `sim/estimate.py` brings.

python -m gelgap.benchmarks.physics.fit_estimate --first 300 --last 360    # an hour; a stopped run goes on

Presses of random scenes are compared with the axisymmetric finite elements of `axisymmetric.py`, at draft and at
standard; drags at draft with those at standard, whose own causes are added. The file has Fz and radius of the presses
among scenes 72 to 249, shear and membrane of scenes 300 to 341, so that two runs print it.
"""

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import nnls

from gelgap.adapt.result_table import ResultTable
from gelgap.benchmarks.common import rms
from gelgap.benchmarks.physics.axisymmetric import Press, solve_press
from gelgap.benchmarks.physics.cases import Case, Floats, Truth, solved_cases
from gelgap.benchmarks.physics.references import NO_SLIP_FRICTION, normal
from gelgap.sim import Elastomer, Pose, Sphere
from gelgap.sim.estimate import CAUSES, causes_of_error

ERRORS = ("Fz", "shear", "radius", "membrane")
KEPT = Path("benchmark-results/estimate-fit")
RADIUS_MM, THICKNESS_MM = (0.5, 6.0), (1.0, 10.0)
SHALLOWEST_MM = 0.01
WIDE_PAD_MM, NARROW_PAD_MM = (100.0, 100.0), (24.0, 20.0)
SURFACE_REACH_RADII = 4.0  # the membrane's error is that within this many contact radii
ELEMENTS_ACROSS = 12
SMALLEST_VARIANCE = 1e-8
COVERED = 0.95  # of the true errors are below twice the estimate


def random_case(number: int) -> Case:
    """Return random scene `number`: a press, and for every third a drag that follows."""
    # The order of the draws is part of a scene's identity.
    rng = np.random.default_rng(np.random.SeedSequence([20261, number]))
    radius, thickness = (float(np.exp(rng.uniform(*np.log(bounds)))) for bounds in (RADIUS_MM, THICKNESS_MM))
    deepest = min(0.4 * thickness, 0.8 * radius)
    even_mm = rng.uniform(0.05, 1.0) * deepest
    shallow_mm = float(np.exp(rng.uniform(np.log(SHALLOWEST_MM), np.log(deepest))))
    depth = round((even_mm, shallow_mm)[number // 2 % 2], 4)
    poisson, friction = rng.uniform(0.3, 0.495), rng.choice([0.0, 10.0, *rng.uniform(0.05, 1.5, 4)])
    cut = math.sqrt(depth * (2 * radius - depth))
    travel, angle = rng.uniform(0.0, min(cut, 0.5 * thickness)), rng.uniform(0.0, 2 * math.pi)
    inside = number % 9 != 8
    x_mm, y_mm = (0.0, 0.0) if inside else (round(rng.uniform(-0.5, 0.5) * size, 3) for size in NARROW_PAD_MM)
    gel = Elastomer(
        young_modulus_mpa=0.3,
        poisson_ratio=round(poisson, 4),
        friction=round(float(friction), 4),
        thickness_mm=round(thickness, 3),
        pad_size_mm=WIDE_PAD_MM if inside else NARROW_PAD_MM,
        strain_energy="stable-neo-hookean",
    )
    poses = [Pose(depth, point_x_mm=x_mm, point_y_mm=y_mm)]
    if number % 3 == 2:
        shear_x_mm, shear_y_mm = (round(travel * of(angle), 4) for of in (math.cos, math.sin))
        poses.append(replace(poses[0], shear_x_mm=shear_x_mm, shear_y_mm=shear_y_mm))
    return Case(
        "random", f"scene {number}", gel, tuple(poses), indenter=Sphere(diameter_mm=round(2 * radius, 3))
    )


def has_own_truth(case: Case) -> bool:
    """Return whether the axisymmetric solver can solve a case: one press, far from the pad's edges."""
    return len(case.poses) == 1 and case.elastomer.pad_size_mm == WIDE_PAD_MM


def axisymmetric_truth(case: Case) -> Truth:
    """Return what the axisymmetric solver finds for a press."""
    gel, depth_mm, radius_mm = case.elastomer, case.poses[0].depth_mm, case.indenter.radius_mm
    hertz_mm = math.sqrt(radius_mm * depth_mm)
    press = Press(
        energy="stable",
        poisson_ratio=gel.poisson_ratio,
        friction=gel.friction if gel.friction < NO_SLIP_FRICTION else math.inf,
        indenter_radius_mm=radius_mm,
        thickness_mm=gel.thickness_mm,
        pad_radius_mm=radius_mm + 3.5 * gel.thickness_mm,
        element_mm=min(hertz_mm / ELEMENTS_ACROSS, gel.thickness_mm / 15),
    )
    (state,) = solve_press(press, (depth_mm,))
    profile = np.array([state.r_mm, state.u_r_mm, state.u_z_mm])
    return Truth(
        normal(np.array([state.force_n])),
        "own",
        radius_mm=np.array([state.contact_radius_mm]),
        profiles=(profile,),
    )


def causes(case: Case, solved: Any, index: int) -> Floats:
    """Return the causes of error of one pose of a case."""
    record = case.plan.placements[index].record
    return causes_of_error(solved.solution, record, solved.states[index].contact_radius_mm)


def rows_of(case: Case, solved: Any, truth: Truth | None, finer: Any) -> Iterator[dict[str, Any]]:
    """Yield a row for each pose: true errors, as shares, and the causes of the difference.

    What is right comes from the truth, or without one from the solve on a finer mesh, which has errors, too, and is not
    `known` where it did not converge.
    """
    for index, (pose, state) in enumerate(zip(case.poses, solved.states, strict=True)):
        if truth is not None:
            right, causes_of_right = truth.state(index, state), np.zeros(len(CAUSES))
        else:
            right, causes_of_right = finer.states[index], causes(case, finer, index)
        size_n = max(float(np.linalg.norm(right.force_n)), 1e-9)
        off_n = state.force_n - right.force_n
        x_mm = state.x_mm - pose.point_x_mm - pose.shear_x_mm
        y_mm = state.y_mm - pose.point_y_mm - pose.shear_y_mm
        near = np.hypot(*np.meshgrid(x_mm, y_mm)) < SURFACE_REACH_RADII * right.contact_radius_mm
        apart_mm = np.linalg.norm(state.displacement_mm - right.displacement_mm, axis=-1)[near]
        errors = (
            off_n[2] / size_n,
            float(np.hypot(*off_n[:2])) / size_n,
            state.contact_radius_mm / max(right.contact_radius_mm, 1e-9) - 1,
            rms(apart_mm) / pose.depth_mm if near.any() else 0.0,
        )
        yield {
            "case": case.name,
            "quality": case.quality,
            "usable": right.converged and state.converged,
            **dict(zip(ERRORS, errors, strict=True)),
            **dict(zip(CAUSES, np.hypot(causes(case, solved, index), causes_of_right), strict=True)),
        }


def random_errors(
    numbers: Sequence[int], qualities: Sequence[str], folder: Path, finest: str = "standard"
) -> pd.DataFrame:
    """Return the rows of random scenes, beside the finest quality where there is no axisymmetric solution."""
    cases = [random_case(number) for number in numbers]
    truths = {case: axisymmetric_truth(case) for case in cases if has_own_truth(case)}
    finer = solved_cases((replace(case, quality=finest) for case in cases if case not in truths), folder)
    rows: list[dict[str, Any]] = []
    for quality in qualities:
        solved = solved_cases((replace(case, quality=quality) for case in cases), folder)
        for case in cases:
            at, truth = replace(case, quality=quality), truths.get(case)
            if truth is not None or quality != finest:
                rows += rows_of(at, solved[at], truth, finer.get(replace(case, quality=finest)))
    return pd.DataFrame(rows)


def variance_per_cause(rows: pd.DataFrame, error: str) -> list[float]:
    """Fit an error's variance by its causes' squares, none negative, then widen it to cover 95 % of each quality.

    A square of a Gaussian error spreads as its own variance does, by which each scene is weighed.
    """
    causes_squared = rows[list(CAUSES)].to_numpy() ** 2
    square = rows[error].to_numpy() ** 2
    variance = np.full(len(rows), square.mean())
    for _ in range(20):
        fitted, _ = nnls(causes_squared / variance[:, None], square / variance)
        variance = np.maximum(causes_squared @ fitted, SMALLEST_VARIANCE)
    shares = pd.Series(square / variance, rows.index).groupby(rows["quality"])
    widened = float(shares.quantile(COVERED).max()) / 4
    return [float(f"{value:.3g}") for value in fitted * widened]


def main() -> None:
    """Print the rows of the file, and what they are fitted to."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--first", type=int, default=300)
    parser.add_argument("--last", type=int, default=360)
    parser.add_argument("--quality", nargs="+", default=["draft", "standard"])
    chosen = parser.parse_args()
    rows = random_errors(range(chosen.first, chosen.last), chosen.quality, KEPT)
    rows = rows[rows["usable"]]
    true = 100 * rows.groupby("quality")[list(ERRORS)].agg(rms)
    ResultTable.of("True errors, rms %", true, f"{len(rows)} poses").show()
    for error in ERRORS:
        print(f"    {variance_per_cause(rows, error)},  # {error}")


if __name__ == "__main__":
    main()
