"""Fit the stiffness of each quality's mesh, and the force's rise with ν, of `assets/fitted/meshes.toml`.

python -m gelgap.benchmarks.physics.fit_meshes    # ten minutes a mesh, an hour for fine: coefficients, and errors

A press of MuJoCo's own energy on the mesh is compared with the axisymmetric finite elements of `axisymmetric.py`, which
do not lock. What is printed beside the scenes is 1 where the file is right.
"""

import argparse
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.optimize import curve_fit

from gelgap.adapt.result_table import ResultTable
from gelgap.benchmarks.physics.axisymmetric import Press, solve_press
from gelgap.benchmarks.physics.cases import Case, Floats
from gelgap.benchmarks.physics.references import NO_SLIP_FRICTION
from gelgap.sim import Elastomer, Pose, Sharing, Sphere
from gelgap.sim.problem import LARGEST_POISSON_RATIO

ELEMENTS_ACROSS = 12
WIDE_PAD_MM = (100.0, 100.0)
NEARLY_INCOMPRESSIBLE = 0.499


@dataclass(frozen=True)
class Descent:
    """A sphere's press to rising depths."""

    radius_mm: float
    thickness_mm: float
    poisson_ratio: float
    friction: float
    depths_mm: tuple[float, ...]

    def __str__(self) -> str:
        return f"R{self.radius_mm:g} h{self.thickness_mm:g} ν{self.poisson_ratio:g} μ{self.friction:g}"

    def true_force_n(self) -> Floats:
        """Return the force (depths,) by the axisymmetric solver, on a pad whose rim does not matter."""
        hertz_mm = math.sqrt(self.radius_mm * max(self.depths_mm))
        press = Press(
            energy="stable",
            poisson_ratio=self.poisson_ratio,
            friction=self.friction,
            indenter_radius_mm=self.radius_mm,
            thickness_mm=self.thickness_mm,
            pad_radius_mm=self.radius_mm + 3.5 * self.thickness_mm,
            element_mm=min(hertz_mm / ELEMENTS_ACROSS, self.thickness_mm / 15),
        )
        return np.array([state.force_n for state in solve_press(press, self.depths_mm)])

    def case(self, quality: str, mesh: str) -> Case:
        """Return the same press of MuJoCo's own energy, on half a disc or a whole pad."""
        gel = Elastomer(
            young_modulus_mpa=0.3,
            poisson_ratio=self.poisson_ratio,
            thickness_mm=self.thickness_mm,
            friction=min(self.friction, NO_SLIP_FRICTION),
            strain_energy="stable-neo-hookean",
            pad_size_mm=WIDE_PAD_MM,
        )
        sharing = Sharing(translation=mesh == "disc", cache=False)
        ball = Sphere(diameter_mm=2 * self.radius_mm)
        return Case(mesh, str(self), gel, tuple(map(Pose, self.depths_mm)), quality, ball, sharing)


FITTED = tuple(
    Descent(radius_mm, thickness_mm, poisson_ratio, friction, depths_mm)
    for poisson_ratios, frictions, scenes in (
        ((0.3, 0.45, 0.49), (0.0, math.inf), [(1.5, 3.0, (0.2, 0.6, 1.0))]),
        ((0.3, 0.49), (0.0,), [(1.5, 3.0, (0.01,)), (1.5, 3.0, (0.1,)), (5.0, 20.0, (0.03,))]),
        ((0.3, 0.49), (0.0, math.inf), [(6.0, 4.0, (0.67, 1.33))]),
    )
    for poisson_ratio, friction, (radius_mm, thickness_mm, depths_mm) in itertools.product(
        poisson_ratios, frictions, scenes
    )
)
CHECKS = (  # presses that the fit did not use
    Descent(1.0, 2.0, 0.47, 0.3, (0.15, 0.4, 0.65)),
    Descent(2.5, 4.0, 0.485, math.inf, (0.3, 0.8, 1.3)),
    Descent(3.0, 3.0, 0.46, 0.0, (0.2, 0.6, 1.0)),
    Descent(1.0, 3.0, 0.495, 0.2, (0.15, 0.4, 0.65)),
    Descent(5.0, 6.0, 0.48, 0.3, (0.02,)),
    Descent(3.0, 10.0, 0.49, math.inf, (0.1,)),
    Descent(10.0, 4.0, 0.48, 0.2, (0.4,)),
)


def force_ratios(descents: Sequence[Descent], quality: str, mesh: str) -> tuple[pd.DataFrame, list[Case]]:
    """Return a row for each press, with the mean ratio of its forces to the true ones, and its case."""
    rows, cases = [], []
    for descent in descents:
        case = descent.case(quality, mesh)
        states = case.states(case.solve.run())
        ratio = np.array([state.force_n[2] for state in states]) / descent.true_force_n()
        error = " ".join(f"{100 * (r - 1):+.2f}" for r in ratio)
        rows.append((quality, mesh, str(descent), error, float(ratio.mean())))
        cases.append(case)
    columns = ["quality", "mesh", "scene", "Fz error by depth, %", "mean ratio"]
    return pd.DataFrame(rows, columns=columns), cases


def stiffness(cases: Sequence[Case], ratios: Sequence[float]) -> tuple[float, float, float]:
    """Fit a, b and c of `MeshSize.stiffness_excess`: ratios that remain times the stiffness taken out already."""
    problems = [case.solve.problem for case in cases]
    taken_out = np.array([1 + problem.stiffness_excess for problem in problems])
    poisson = np.array([problem.moduli.poisson_ratio for problem in problems])
    width = np.array([problem.contact_width for problem in problems])

    def excess(of: tuple[Floats, Floats], a: float, b: float, c: float) -> Floats:
        return (a + b / (1 - 2 * of[0])) * (1 - c * np.log(of[1]))

    (a, b, c), _ = curve_fit(excess, (poisson, width), np.array(ratios) * taken_out - 1, p0=(0.01, 5e-4, 0.1))
    return float(a), float(b), float(c)


def force_rise_per_poisson(frictions: Sequence[float] = (0.0, math.inf)) -> float:
    """Return by how much the force rises with ν above the meshes' largest, over depths."""
    rises = []
    for friction in frictions:
        softer, nearly = (
            np.array([state.force_n for state in solve_press(press, (0.2, 0.4, 0.6, 0.8, 1.0))])
            for press in (
                Press(poisson_ratio=nu, energy="stable", friction=friction)
                for nu in (LARGEST_POISSON_RATIO, NEARLY_INCOMPRESSIBLE)
            )
        )
        rises.append((nearly / softer - 1) / (NEARLY_INCOMPRESSIBLE - LARGEST_POISSON_RATIO))
    return float(np.mean(rises))


def main() -> None:
    """Print the fit and the check."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quality", nargs="+", default=["draft", "standard"])
    parser.add_argument("--mesh", nargs="+", default=["disc"], choices=["disc", "pad"])
    chosen = parser.parse_args()
    print(f"force_rise_per_poisson = {force_rise_per_poisson():.2f}")
    for quality, mesh in itertools.product(chosen.quality, chosen.mesh):
        fitted, cases = force_ratios(FITTED, quality, mesh)
        a, b, c = stiffness(cases, fitted["mean ratio"])
        print(f"[{quality}] {mesh}: stiffness = [{a:.4f}, {b:.5f}, {c:.3f}]")
        ResultTable.of("Fitted", fitted).show()
        ResultTable.of("Check: what the fit did not use", force_ratios(CHECKS, quality, mesh)[0]).show()


if __name__ == "__main__":
    main()
