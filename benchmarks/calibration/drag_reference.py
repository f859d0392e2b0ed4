"""Tabulate drags with Coulomb friction by the project's own 3-D solver.

`python -m gelgap.benchmarks.calibration.drag_reference` prints assets/reference/drag_coulomb.csv. Each drag is solved
on two meshes, so that the table shows its own uncertainty; a run that was stopped goes on where it was.
"""

import csv
import itertools
import math
import os
import sys
from pathlib import Path

from gelgap.benchmarks.fem.hexahedral import Drag, DragState, solve_drag
from gelgap.benchmarks.physics.cases import Workers

COLUMNS = (
    "poisson_ratio", "young_modulus_mpa", "friction", "depth_mm", "element_mm", "shear_x_mm", "fx_n", "fz_n",
)  # fmt: skip
TRAVELS_MM = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
DEPTHS_MM = (0.6, 1.0, 0.2)
FRICTIONS = (0.3, 0.8, math.inf)


def meshes(depth_mm: float) -> tuple[tuple[float, int], ...]:
    """Return (element_mm, sectors) of the coarse and the fine mesh; a shallow contact is small."""
    return ((0.2, 12), (0.125, 20)) if depth_mm <= 0.3 else ((0.36, 12), (0.25, 20))


def solve(drag: Drag) -> tuple[DragState, ...]:
    """Solve a drag; return nothing, and say why, where there is no equilibrium."""
    try:
        return solve_drag(drag, TRAVELS_MM)
    except RuntimeError as failure:
        print(f"left out: {drag}: {failure}", file=sys.stderr, flush=True)
        return ()


def main() -> None:
    """Solve all drags and print the table."""
    drags = [
        Drag(friction=friction, depth_mm=depth, element_mm=element, sectors=sectors)
        for depth, friction in itertools.product(DEPTHS_MM, FRICTIONS)
        for element, sectors in meshes(depth)
    ]
    writer = csv.writer(sys.stdout)
    writer.writerow(COLUMNS)
    workers = Workers(os.cpu_count() or 1, Path("benchmark-results/drag-solves"))
    for drag, states in zip(drags, workers.map(solve, drags), strict=True):
        scene = (drag.poisson_ratio, drag.young_modulus_mpa, drag.friction, drag.depth_mm, drag.element_mm)
        for state in states:
            forces = (f"{state.force_n[0]:.5f}", f"{state.force_n[2]:.5f}")
            writer.writerow([*scene, f"{state.travel_mm:.9g}", *forces])
    workers.forget()


if __name__ == "__main__":
    main()
