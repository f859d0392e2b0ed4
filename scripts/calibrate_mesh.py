"""How stiff each quality's mesh is beside locking-free presses of the same energy.

python scripts/calibrate_mesh.py    # ten minutes a mesh, an hour for fine: the coefficients of `mesh_moduli`, errors
"""

import argparse
import itertools
import math
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.optimize import curve_fit

from gelgap.benchmarks.common import show
from gelgap.benchmarks.fem.spheres import Press, solve_press
from gelgap.benchmarks.physics.cases import Case, Floats, Solver
from gelgap.benchmarks.physics.references import axisymmetric_press, own_cases
from gelgap.sim import Sharing
from gelgap.sim.problem import LARGEST_POISSON_RATIO

KEPT = Path("benchmark-results/mesh-solves")
CALIBRATION = tuple(
    axisymmetric_press(*scene[:2], poisson_ratio, friction, *scene[2:])
    for poisson_ratio, friction, scene in (
        *itertools.product((0.3, 0.45, 0.49), (0.0, math.inf), [(1.5, 3.0, 0.2, 0.6, 1.0)]),
        *itertools.product((0.3, 0.49), (0.0,), [(1.5, 3.0, 0.01), (1.5, 3.0, 0.1), (5.0, 20.0, 0.03)]),
        *itertools.product((0.3, 0.49), (0.0, math.inf), [(6.0, 4.0, 0.67, 1.33)]),
    )
)
CHECK = (
    axisymmetric_press(1.0, 2.0, 0.47, 0.3, 0.15, 0.4, 0.65),
    axisymmetric_press(2.5, 4.0, 0.485, math.inf, 0.3, 0.8, 1.3),
    axisymmetric_press(3.0, 3.0, 0.46, 0.0, 0.2, 0.6, 1.0),
    axisymmetric_press(1.0, 3.0, 0.495, 0.2, 0.15, 0.4, 0.65),
    axisymmetric_press(5.0, 6.0, 0.48, 0.3, 0.02),
    axisymmetric_press(3.0, 10.0, 0.49, math.inf, 0.1),
    axisymmetric_press(10.0, 4.0, 0.48, 0.2, 0.4),
)


def calibrate(qualities: Sequence[str], meshes: Sequence[str], solver: Solver) -> None:
    """Print the factors by quality and ν that remain, and the check; both are 1 where `mesh_moduli` is right."""
    print(f"FORCE_RISE_PER_POISSON = {force_rise_per_poisson():.2f}")
    for title, descents in (("Calibration", CALIBRATION), ("Check: not used", CHECK)):
        truths = own_cases(title, descents, solver)
        rows = []
        for quality, mesh in itertools.product(qualities, meshes):
            cases = [on_mesh(truth, quality, mesh) for truth in truths]
            solved = solver.cases(cases)
            ratios = [
                np.array([state.force_n[2] for state in solved[case].states]) / case.truth.force_n[:, 2]
                for case in cases
            ]
            for case, ratio in zip(cases, ratios, strict=True):
                error = " ".join(f"{100 * (r - 1):+.2f}" for r in ratio)
                cost = solved[case].solve_s
                rows.append((quality, mesh, case.name, error, ratio.mean(), cost))
            if descents is CALIBRATION:
                coefficients = stiffness(cases, [ratio.mean() for ratio in ratios])
                print(f"    {quality} {mesh}: stiffness=({', '.join(f'{c:.5f}' for c in coefficients)})")
        columns = ["quality", "mesh", "scene", "Fz error by depth, %", "mean ratio", "core s"]
        show(title, pd.DataFrame(rows, columns=columns))


def on_mesh(truth: Case, quality: str, mesh: str) -> Case:
    """Return a press of MuJoCo's own energy, on half a disc or a whole pad."""
    gel = {"strain_energy": "stable-neo-hookean", "pad_size_mm": (100.0, 100.0)}
    sharing = Sharing(translation=mesh == "disc", cache=False)
    elastomer = truth.elastomer.model_copy(update=gel)
    return replace(truth, study=mesh, elastomer=elastomer, quality=quality, sharing=sharing)


def force_rise_per_poisson() -> float:
    """Return by how much the force rises with ν above the meshes' largest, over depths, with and without slip."""
    rises = []
    for friction in (0.0, math.inf):
        softer, nearly = (
            np.array([state.force_n for state in solve_press(press, (0.2, 0.4, 0.6, 0.8, 1.0))])
            for press in (
                Press(poisson_ratio=nu, energy="stable", friction=friction)
                for nu in (LARGEST_POISSON_RATIO, 0.499)
            )
        )
        rises.append((nearly / softer - 1) / (0.499 - LARGEST_POISSON_RATIO))
    return float(np.mean(rises))


def stiffness(cases: Sequence[Case], ratios: Sequence[float]) -> tuple[float, ...]:
    """Fit a, b and c of `mesh_moduli` to the factors: ratios that remain times the stiffness taken out already."""
    problems = [case.solve.problem for case in cases]
    taken_out = np.array([1 + problem.stiffness_excess for problem in problems])
    poisson = np.array([problem.moduli.poisson_ratio for problem in problems])
    width = np.array([problem.contact_width for problem in problems])

    def excess(of: tuple[Floats, Floats], a: float, b: float, c: float) -> Floats:
        return (a + b / (1 - 2 * of[0])) * (1 - c * np.log(of[1]))

    found, _ = curve_fit(excess, (poisson, width), np.array(ratios) * taken_out - 1, p0=(0.01, 5e-4, 0.1))
    return tuple(float(value) for value in found)


def main() -> None:
    """Print the calibration."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quality", nargs="+", default=["draft", "standard"])
    parser.add_argument("--mesh", nargs="+", default=["disc"], choices=["disc", "pad"])
    chosen = parser.parse_args()
    solver = Solver(None, KEPT)
    calibrate(chosen.quality, chosen.mesh, solver)
    shutil.rmtree(KEPT)


if __name__ == "__main__":
    main()
