"""How stiff each quality's mesh is beside locking-free presses of the same energy, and how `standard` was chosen.

python scripts/calibrate_mesh.py    # ten minutes a mesh, an hour for fine: the coefficients of `mesh_moduli`, errors
python scripts/calibrate_mesh.py --sizes    # five minutes: run time and errors of meshes beside that of standard
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

from gelgap.benchmarks.common import show
from gelgap.benchmarks.fem.spheres import Press, solve_press
from gelgap.benchmarks.physics.accuracy import MEMBRANE_NOTE, PRESS, SURFACE, errors
from gelgap.benchmarks.physics.cases import Case, Solver
from gelgap.benchmarks.physics.references import own_cases, press_cases
from gelgap.sim import Sharing, Solve
from gelgap.sim.mesh import LARGEST_POISSON_RATIO, mesh_moduli
from gelgap.sim.problem import QUALITIES, MeshSize, quality_named
from gelgap.sim.scene import Moduli

KEPT = Path("benchmark-results/mesh-solves")
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
TABLES = ("nh49_no_slip", "nh49_frictionless", "nh499_no_slip")
STANDARD = QUALITIES["standard"].disc
SIZES = {
    "standard": STANDARD,
    "8 sectors": replace(STANDARD, sectors=8),
    "16 sectors": replace(STANDARD, sectors=16),
    "vertices 0.25 mm apart": replace(STANDARD, surface_mm=0.25),
    "layers grow by 1.5": replace(STANDARD, layer_growth=1.5),
    "the former one": MeshSize(0.25, 0.15, 1.25, 1.5, 8, stiffness=(0.0044, 0.00052)),
}


def calibrate(qualities: Sequence[str], meshes: Sequence[str], solver: Solver) -> None:
    """Print the factors by quality and ν that remain, and the check; both are 1 where `mesh_moduli` is right."""
    print(f"FORCE_RISE_PER_POISSON = {force_rise_per_poisson():.2f}")
    for title, presses in (("Calibration", CALIBRATION), ("Check: not used", CHECK)):
        truths = own_cases(title, [(press, depths_mm(press)) for press in presses], solver)
        rows = []
        for quality, mesh in itertools.product(qualities, meshes):
            cases = [
                on_mesh(truth, press, quality, mesh) for truth, press in zip(truths, presses, strict=True)
            ]
            solved = solver.cases(cases)
            ratios = [
                np.array([state.force_n[2] for state in solved[case].states]) / case.truth.force_n[:, 2]
                for case in cases
            ]
            for press, ratio in zip(presses, ratios, strict=True):
                error = " ".join(f"{100 * (r - 1):+.2f}" for r in ratio)
                rows.append((quality, mesh, str(press), error, ratio.mean()))
            if presses is CALIBRATION:
                a, b = coefficients(ratios, getattr(quality_named(quality), mesh).stiffness)
                print(f"    {quality} {mesh}: stiffness=({a:.4f}, {b:.5f})")
        columns = ["quality", "mesh", "scene", "Fz error by depth, %", "mean ratio"]
        show(title, pd.DataFrame(rows, columns=columns))


def depths_mm(press: Press) -> tuple[float, ...]:
    """Return the depths at which forces are compared."""
    return tuple(round(press.deepest_mm * share, 4) for share in SHARES_OF_DEEPEST)


def on_mesh(truth: Case, press: Press, quality: str, mesh: str) -> Case:
    """Return a press of MuJoCo's own energy, on half a disc or a whole pad."""
    gel = {"strain_energy": "stable-neo-hookean", "pad_size_mm": (40.0, 40.0)}
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


def coefficients(ratios: Sequence[np.ndarray], stiffness: tuple[float, float]) -> tuple[float, float]:
    """Fit 1 + a + b / (1 − 2ν) to the factors: ratios that remain times the stiffness taken out already."""
    poisson = np.array([press.poisson_ratio for press in CALIBRATION])
    taken_out = [1 / mesh_moduli(Moduli(1.0, nu), stiffness).young_modulus_mpa for nu in poisson]
    factor = np.array([ratio.mean() for ratio in ratios]) * taken_out
    basis = np.stack([np.ones_like(poisson), 1 / (1 - 2 * poisson)], axis=-1)
    a, b = np.linalg.lstsq(basis, factor - 1, rcond=None)[0]
    return float(a), float(b)


def press_on(sizes: dict[str, MeshSize], cases: Sequence[Case], solver: Solver) -> pd.DataFrame:
    """Solve cases of the tables with meshes of other sizes, and compare them with the tables."""
    grid = list(itertools.product(sizes, cases))
    solves = {}
    for name, case in grid:
        problem = case.solve.problem
        quality = replace(problem.quality, disc=sizes[name])
        solves[f"{name}: {case.name}"] = Solve(replace(problem, quality=quality), cached=False)
    found = solver.solve(solves)
    found["states"] = [case.states(own) for (_, case), own in zip(grid, found["solution"], strict=True)]
    found["core_s"] = found["solve_s"]
    rows = zip(grid, found.itertuples(), strict=True)
    return pd.DataFrame([{"mesh": name, **errors(case, own)} for (name, case), own in rows])


def main() -> None:
    """Print the calibration, or the choice of sizes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quality", nargs="+", default=["draft", "standard"])
    parser.add_argument("--mesh", nargs="+", default=["disc"], choices=["disc", "pad"])
    parser.add_argument("--sizes", action="store_true")
    chosen = parser.parse_args()
    solver = Solver(None, KEPT)
    if chosen.sizes:
        table = press_on(SIZES, [press_cases()[name] for name in TABLES], solver)
        note = f"Fz with the stiffness of standard's mesh; another mesh would have its own; {MEMBRANE_NOTE}"
        show("Meshes of half a disc", table[["mesh", *PRESS, *SURFACE]], note)
    else:
        calibrate(chosen.quality, chosen.mesh, solver)
    shutil.rmtree(KEPT)


if __name__ == "__main__":
    main()
