"""By how much each quality's mesh is too stiff: MuJoCo's presses against locking-free ones of the same energy.

`python -m gelgap.benchmarks.calibration.mesh` prints the coefficients that the meshes of `sim/quality.py` hold, and the
errors of the force with the present ones, on the calibration's scenes and on others. It takes some ten
minutes on one core for each mesh, and an hour for `fine`.
"""

import argparse
import itertools
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gelgap.benchmarks.common.tables import print_table
from gelgap.benchmarks.fem.axisymmetric import Press, solve_press
from gelgap.benchmarks.physics.reference import NO_SLIP_FRICTION
from gelgap.benchmarks.physics.solve_jobs import Job, solve_jobs
from gelgap.sim import Elastomer, Pose, Sharing, Sphere
from gelgap.sim.material import LARGEST_POISSON_RATIO, Moduli, mesh_moduli
from gelgap.sim.quality import quality_named

YOUNG_MPA = 0.3
SHARES_OF_DEEPEST = (0.2, 0.6, 1.0)


@dataclass(frozen=True)
class PressScene:
    """A press to a third of the thickness or two thirds of the radius, in MuJoCo's own energy."""

    poisson_ratio: float
    friction: float
    indenter_radius_mm: float = 1.5
    thickness_mm: float = 3.0

    @property
    def depths_mm(self) -> tuple[float, ...]:
        deepest = min(self.thickness_mm / 3, 2 * self.indenter_radius_mm / 3)
        return tuple(round(deepest * share, 4) for share in SHARES_OF_DEEPEST)

    def __str__(self) -> str:
        return f"R {self.indenter_radius_mm:g} h {self.thickness_mm:g} ν {self.poisson_ratio:g} μ {self.friction:g}"


CALIBRATION = tuple(
    PressScene(nu, friction) for nu in (0.3, 0.45, 0.49) for friction in (0.0, NO_SLIP_FRICTION)
)
CHECK = (
    PressScene(0.47, 0.3, 1.0, 2.0),
    PressScene(0.485, NO_SLIP_FRICTION, 2.5, 4.0),
    PressScene(0.46, 0.0, 3.0, 3.0),
    PressScene(0.495, 0.2, 1.0, 3.0),
)


def force_ratios(scenes: Sequence[PressScene], quality: str, mesh: str, processes: int) -> list[np.ndarray]:
    """Return MuJoCo's Fz over the locking-free one at each scene's depths, on half a disc or a whole pad."""
    jobs = [
        Job(
            name=str(scene),
            elastomer=Elastomer(
                young_modulus_mpa=YOUNG_MPA,
                poisson_ratio=scene.poisson_ratio,
                friction=scene.friction,
                thickness_mm=scene.thickness_mm,
                pad_size_mm=(40.0, 40.0),
                strain_energy="stable-neo-hookean",
            ),
            poses=tuple(Pose(depth_mm=depth) for depth in scene.depths_mm),
            quality=quality,
            indenter=Sphere(diameter_mm=2 * scene.indenter_radius_mm),
            sharing=Sharing(translation=mesh == "disc", cache=False),
        )
        for scene in scenes
    ]
    ratios = []
    for scene, outcome in zip(scenes, solve_jobs(jobs, processes), strict=True):
        press = Press(
            young_modulus_mpa=YOUNG_MPA,
            poisson_ratio=scene.poisson_ratio,
            energy="stable",
            friction=math.inf if scene.friction == NO_SLIP_FRICTION else scene.friction,
            indenter_radius_mm=scene.indenter_radius_mm,
            thickness_mm=scene.thickness_mm,
            pad_radius_mm=3.5 * scene.thickness_mm,
            element_mm=scene.indenter_radius_mm / 15,
        )
        truth = np.array([state.force_n for state in solve_press(press, scene.depths_mm)])
        ratios.append(np.array([state.force_n[2] for state in outcome.states]) / truth)
        print(f"  {quality} {mesh} {scene}: {np.round(100 * (ratios[-1] - 1), 2)} %", flush=True)
    return ratios


def main() -> None:
    """Print the factors by quality and ν that remain, and the check; both are 1 where `mesh_moduli` is right."""
    parser = argparse.ArgumentParser(description="Calibrate the meshes' stiffness.")
    parser.add_argument("--quality", nargs="+", default=["draft", "standard"])
    parser.add_argument("--mesh", nargs="+", default=["disc"], choices=["disc", "pad"])
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    chosen = parser.parse_args()
    print(f"FORCE_RISE_PER_POISSON = {force_rise_per_poisson():.2f}")
    for title, scenes in (("Calibration", CALIBRATION), ("Check: not used", CHECK)):
        rows = []
        for quality, mesh in itertools.product(chosen.quality, chosen.mesh):
            ratios = force_ratios(scenes, quality, mesh, chosen.processes)
            for scene, ratio in zip(scenes, ratios, strict=True):
                error = " ".join(f"{100 * (r - 1):+.2f}" for r in ratio)
                rows.append([quality, mesh, str(scene), error, ratio.mean()])
            if scenes is CALIBRATION:
                a, b = coefficients(ratios, getattr(quality_named(quality), mesh).stiffness)
                print(f"    {quality} {mesh}: stiffness=({a:.4f}, {b:.5f})")
        print_table(title, ["quality", "mesh", "scene", "Fz error by depth, %", "mean ratio"], rows)


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
    slack = 1 - 2 * np.array([scene.poisson_ratio for scene in CALIBRATION])
    taken_out = np.array(
        [
            YOUNG_MPA / mesh_moduli(Moduli(YOUNG_MPA, s.poisson_ratio), stiffness).young_modulus_mpa
            for s in CALIBRATION
        ]
    )
    factor = np.array([ratio.mean() for ratio in ratios]) * taken_out
    fitted = np.linalg.lstsq(np.stack([np.ones_like(slack), 1 / slack], axis=-1), factor - 1, rcond=None)[0]
    return float(fitted[0]), float(fitted[1])


if __name__ == "__main__":
    main()
