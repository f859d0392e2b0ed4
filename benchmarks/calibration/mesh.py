"""How much too stiff each quality's mesh is: MuJoCo's presses against locking-free ones of the same energy.

`python -m gelgap.benchmarks.calibration.mesh` prints the coefficients that the meshes of `sim/quality.py` hold, and the
errors of the force with the present ones, on the calibration's scenes and on others. It takes some ten minutes on one
core per mesh, and an hour for `fine`.
"""

import argparse
import itertools
import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gelgap.benchmarks.common.tables import print_table
from gelgap.benchmarks.fem.axisymmetric import Press, solve_press
from gelgap.benchmarks.physics.cases import Case, Workers
from gelgap.benchmarks.physics.reference import NO_SLIP_FRICTION
from gelgap.sim import Elastomer, Pose, Sharing, Sphere
from gelgap.sim.mesh import LARGEST_POISSON_RATIO, mesh_moduli
from gelgap.sim.problem import quality_named
from gelgap.sim.scene import Moduli

SHARES_OF_DEEPEST = (0.2, 0.6, 1.0)
CALIBRATION = tuple(
    replace(Press.scaled(1.5, 3.0, poisson_ratio, friction), energy="stable")
    for poisson_ratio, friction in itertools.product((0.3, 0.45, 0.49), (0.0, math.inf))
)
CHECK = tuple(
    replace(Press.scaled(*scene), energy="stable")
    for scene in (
        (1.0, 2.0, 0.47, 0.3),
        (2.5, 4.0, 0.485, math.inf),
        (3.0, 3.0, 0.46, 0.0),
        (1.0, 3.0, 0.495, 0.2),
    )
)


def depths_mm(press: Press) -> tuple[float, ...]:
    """Return the depths at which forces are compared."""
    return tuple(round(press.deepest_mm * share, 4) for share in SHARES_OF_DEEPEST)


def mujoco_case(press: Press, quality: str, mesh: str) -> Case:
    """Return the same press for MuJoCo, on half a disc or a whole pad."""
    elastomer = Elastomer(
        young_modulus_mpa=press.young_modulus_mpa,
        poisson_ratio=press.poisson_ratio,
        friction=min(press.friction, NO_SLIP_FRICTION),
        thickness_mm=press.thickness_mm,
        pad_size_mm=(40.0, 40.0),
        strain_energy="stable-neo-hookean",
    )
    return Case(
        f"{mesh} {press}",
        elastomer,
        tuple(Pose(depth_mm=depth) for depth in depths_mm(press)),
        quality,
        Sphere(diameter_mm=2 * press.indenter_radius_mm),
        Sharing(translation=mesh == "disc", cache=False),
    )


def locking_free_force_n(press: Press) -> np.ndarray:
    """Return Fz of the project's own solver at each depth."""
    return np.array([state.force_n for state in solve_press(press, depths_mm(press))])


def main() -> None:
    """Print the factors by quality and ν that remain, and the check; both are 1 where `mesh_moduli` is right."""
    parser = argparse.ArgumentParser(description="Calibrate the meshes' stiffness.")
    parser.add_argument("--quality", nargs="+", default=["draft", "standard"])
    parser.add_argument("--mesh", nargs="+", default=["disc"], choices=["disc", "pad"])
    chosen = parser.parse_args()
    workers = Workers(os.cpu_count() or 1, Path("benchmark-results/mesh-solves"))
    print(f"FORCE_RISE_PER_POISSON = {force_rise_per_poisson():.2f}")
    for title, presses in (("Calibration", CALIBRATION), ("Check: not used", CHECK)):
        rows = []
        truths = workers.map(locking_free_force_n, presses)
        for quality, mesh in itertools.product(chosen.quality, chosen.mesh):
            solved = workers.solve(mujoco_case(press, quality, mesh) for press in presses)
            forces = [np.array([state.force_n[2] for state in s.states]) for s in solved]
            ratios = [force / truth for force, truth in zip(forces, truths, strict=True)]
            for press, ratio in zip(presses, ratios, strict=True):
                error = " ".join(f"{100 * (r - 1):+.2f}" for r in ratio)
                rows.append([quality, mesh, str(press), error, ratio.mean()])
            if presses is CALIBRATION:
                a, b = coefficients(ratios, getattr(quality_named(quality), mesh).stiffness)
                print(f"    {quality} {mesh}: stiffness=({a:.4f}, {b:.5f})")
        print_table(title, ["quality", "mesh", "scene", "Fz error by depth, %", "mean ratio"], rows)
    workers.forget()


def force_rise_per_poisson() -> float:
    """Return by how much the force rises with ν above the meshes' largest, over depths, with and without slip."""
    depths_mm = (0.2, 0.4, 0.6, 0.8, 1.0)
    rises = []
    for friction in (0.0, math.inf):
        softer, nearly = (
            np.array([state.force_n for state in solve_press(press, depths_mm)])
            for press in (
                Press(poisson_ratio=nu, energy="stable", friction=friction)
                for nu in (LARGEST_POISSON_RATIO, 0.499)
            )
        )
        rises.append((nearly / softer - 1) / (0.499 - LARGEST_POISSON_RATIO))
    return float(np.mean(rises))


def coefficients(ratios: Sequence[np.ndarray], stiffness: tuple[float, float]) -> tuple[float, float]:
    """Fit 1 + a + b / (1 − 2ν) to the factors: ratios that remain times the stiffness taken out already."""
    slack = 1 - 2 * np.array([press.poisson_ratio for press in CALIBRATION])
    taken_out = np.array(
        [
            1 / mesh_moduli(Moduli(1.0, press.poisson_ratio), stiffness).young_modulus_mpa
            for press in CALIBRATION
        ]
    )
    factor = np.array([ratio.mean() for ratio in ratios]) * taken_out
    fitted = np.linalg.lstsq(np.stack([np.ones_like(slack), 1 / slack], axis=-1), factor - 1, rcond=None)[0]
    return float(fitted[0]), float(fitted[1])


if __name__ == "__main__":
    main()
