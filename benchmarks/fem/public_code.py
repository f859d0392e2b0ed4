"""The project's axisymmetric solver beside a public code: presses of spheres without slip by felupe.

python -m gelgap.benchmarks.fem.public_code    # a minute of a core; needs: pip install felupe

The energy is the same; elements (four-node quadrilaterals of constant volume ratio) and contact differ: nodes that
reach the sphere are held on it, those that would pull are let go. Vectors are (r, z), those of felupe (z, r).
"""

import math
import sys
from importlib.util import find_spec

import numpy as np
import pandas as pd
from scipy.sparse.linalg import spsolve

from gelgap.benchmarks.common import show
from gelgap.benchmarks.fem.spheres import Floats, Press, solve_press

SCENES = ((1.5, 3.0, 0.48), (1.5, 3.0, 0.495), (4.0, 3.0, 0.49), (2.5, 6.0, 0.45))  # radius, thickness, ν
DEPTHS_MM = (0.2, 0.4, 0.6)
STEPS_PER_DEPTH = 16
ELEMENTS = 40  # across √(R d), the radius at which contact is looked for
GROWTH = 1.12  # of elements elsewhere
TOLERANCE = 1e-6  # of the force
MOST_ITERATIONS = 80


class PublicPad:
    """felupe's model of a press: half the section of a pad; `surface` are the membrane's nodes, from the axis on."""

    def __init__(self, press: Press, deepest_mm: float) -> None:
        import felupe as fem

        self.press = press
        reach_mm = 1.1 * math.sqrt(press.indenter_radius_mm * deepest_mm)
        fine_mm, thick_mm = reach_mm / ELEMENTS, press.thickness_mm
        outside = reach_mm + _graded(press.pad_radius_mm - reach_mm, fine_mm)
        r = np.append(np.linspace(0, reach_mm, ELEMENTS, endpoint=False), outside)
        mesh = fem.Grid(-_graded(thick_mm, fine_mm)[::-1], r)
        region = fem.RegionQuad(mesh)
        self.field = fem.FieldContainer([fem.FieldAxisymmetric(region, dim=2)])
        material = fem.NeoHooke(mu=press.shear_modulus_mpa)
        self.solid = fem.SolidBodyNearlyIncompressible(
            material, self.field, bulk=press.volumetric_modulus_mpa
        )
        z, radius = mesh.points.T
        backing, axis = np.flatnonzero(z < 1e-9 - thick_mm), np.flatnonzero(radius < 1e-9)
        self.fixed = np.concatenate([2 * backing, 2 * backing + 1, 2 * axis + 1])
        self.surface = np.flatnonzero(z > -1e-9)
        self.rest_mm = mesh.points[self.surface][:, ::-1]
        # Where a node is held, from the sphere's lowest point.
        self.held_mm = np.full(self.rest_mm.shape, np.nan)

    def equilibrium(self, depth_mm: float) -> float:
        """Bring the pad into equilibrium at a depth, and return the force on it, N; RuntimeError if that fails."""
        dofs, values = 2 * self.surface[:, None] + [1, 0], self.field[0].values
        centre_mm = np.array([0.0, self.press.indenter_radius_mm - depth_mm])
        for _ in range(MOST_ITERATIONS):
            held = ~np.isnan(self.held_mm[:, 0])
            place_mm = self.rest_mm + values[self.surface][:, ::-1]
            step, given = np.zeros(values.size), np.zeros(values.size, dtype=bool)
            step[dofs[held]] = (self.held_mm - [0, depth_mm] - place_mm)[held]
            step[self.fixed] = 0.0
            given[dofs[held].ravel()] = given[self.fixed] = True
            force = self.solid.assemble.vector(self.field).toarray().ravel()
            total = abs(force[dofs[held][:, 1]].sum())
            if np.abs(force[~given]).max() <= TOLERANCE * total and np.abs(step).max() < 1e-9:
                from_centre = place_mm - centre_mm
                distance = np.linalg.norm(from_centre, axis=1, keepdims=True)
                pulls = held & ((force[dofs] * from_centre).sum(axis=1) < -TOLERANCE * total)
                lands = ~held & (distance[:, 0] < self.press.indenter_radius_mm - 1e-9)
                if not (pulls | lands).any():
                    return -total
                onto = centre_mm + self.press.indenter_radius_mm * from_centre / distance + [0, depth_mm]
                self.held_mm[pulls] = np.nan
                self.held_mm[lands] = onto[lands]
                continue
            stiffness = self.solid.assemble.matrix(self.field).tocsr()
            rows = stiffness[~given]
            step[~given] = spsolve(rows[:, ~given].tocsc(), -force[~given] - rows[:, given] @ step[given])
            values += step.reshape(-1, 2)
        raise RuntimeError(f"{self.press} found no equilibrium at {depth_mm:g} mm")


def _graded(length_mm: float, first_mm: float) -> Floats:
    """Return places from 0 to a length, whose distances grow in a geometric series from about the first one on."""
    count = math.ceil(math.log(1 + (GROWTH - 1) * length_mm / first_mm, GROWTH))
    return length_mm * (GROWTH ** np.arange(count + 1) - 1) / (GROWTH**count - 1)


def main() -> None:
    """Print both solvers' forces and what they differ by."""
    if find_spec("felupe") is None:
        sys.exit("this check needs the package felupe; install it with: pip install felupe")
    tables = []
    for radius_mm, thick_mm, nu in SCENES:
        sizes_mm = {"indenter_radius_mm": radius_mm, "thickness_mm": thick_mm, "pad_radius_mm": 14.0}
        press = Press(**sizes_mm, poisson_ratio=nu)
        own, pad = solve_press(press, DEPTHS_MM), PublicPad(press, DEPTHS_MM[-1])
        way_mm = np.linspace(0, DEPTHS_MM[-1], STEPS_PER_DEPTH * len(DEPTHS_MM) + 1)[1:]
        force_n = [pad.equilibrium(depth_mm) for depth_mm in way_mm][STEPS_PER_DEPTH - 1 :: STEPS_PER_DEPTH]
        columns = {"press": str(press), "depth mm": DEPTHS_MM, "own N": [state.force_n for state in own]}
        tables.append(pd.DataFrame({**columns, "felupe N": force_n}))
    table = pd.concat(tables)
    apart = 100 * (table["own N"] / table["felupe N"] - 1)
    show(
        "Presses without slip by the project's solver and by felupe",
        table.assign(**{"own − felupe, %": apart}),
    )


if __name__ == "__main__":
    main()
