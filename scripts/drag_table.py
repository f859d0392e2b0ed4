"""Tabulate drags with Coulomb friction by the project's own 3-D solver, on two meshes each: the table shows its error.

python scripts/drag_table.py assets/reference/drag_coulomb.csv    # hours; a run that was stopped goes on
"""

import math
import shutil
import sys
from pathlib import Path

import pandas as pd

from gelgap.benchmarks.common import Results
from gelgap.benchmarks.fem.spheres import Drag, solve_drag
from gelgap.benchmarks.physics.cases import Solver

KEPT = Path("benchmark-results/drags")
TRAVELS_MM = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
FRICTIONS = (0.3, 0.8, math.inf)
# Elements, mm, and sectors of the coarse and the fine mesh by depth; a shallow contact is small.
MESHES = {0.6: ((0.36, 12), (0.25, 20)), 1.0: ((0.36, 12), (0.25, 20)), 0.2: ((0.2, 12), (0.125, 20))}


def drag_rows(drag: Drag) -> Results:
    """Solve a drag; it has no rows, and it is said why, where there is no equilibrium."""
    try:
        states = solve_drag(drag, TRAVELS_MM)
    except RuntimeError as failure:
        print(f"left out: {drag}: {failure}", flush=True)
        states = ()
    return {"rows": [(f"{s.travel_mm:.9g}", f"{s.force_n[0]:.5f}", f"{s.force_n[2]:.5f}") for s in states]}


def main(table: Path) -> None:
    """Solve all drags and write the table."""
    drags = [
        Drag(friction=friction, depth_mm=depth_mm, element_mm=element_mm, sectors=sectors)
        for depth_mm, meshes in MESHES.items()
        for friction in FRICTIONS
        for element_mm, sectors in meshes
    ]
    found = Solver(None, KEPT).measure(drag_rows, {str(drag): drag for drag in drags}, tasks_per_worker=None)
    scene = ["poisson_ratio", "young_modulus_mpa", "friction", "depth_mm", "element_mm"]
    rows = [
        (*(getattr(drag, name) for name in scene), *row)
        for drag, own in zip(drags, found["rows"], strict=True)
        for row in own
    ]
    columns = [*scene, "shear_x_mm", "fx_n", "fz_n"]
    pd.DataFrame(rows, columns=columns).to_csv(table, index=False, lineterminator="\r\n")
    shutil.rmtree(KEPT)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
