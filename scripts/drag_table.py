"""Tabulate drags with Coulomb friction by the project's own 3-D solver, on two meshes each: the table shows its error.

python scripts/drag_table.py assets/reference/drag_coulomb.csv    # hours; a run that was stopped goes on
"""

import itertools
import sys
from pathlib import Path

from gelgap.benchmarks.common import Results, Setting, run_missing
from gelgap.benchmarks.fem.hexahedral import Drag, solve_drag
from gelgap.benchmarks.physics.cases import digest

TRAVELS_MM = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
DEPTHS_MM = (0.6, 1.0, 0.2)
FRICTIONS = (0.3, 0.8, "inf")
# Elements, mm, and sectors of the coarse and the fine mesh; a shallow contact is small.
MESHES = {0.6: ((0.36, 12), (0.25, 20)), 1.0: ((0.36, 12), (0.25, 20)), 0.2: ((0.2, 12), (0.125, 20))}


def solve(setting: Setting) -> Results:
    """Solve a drag; its rows end, and it is said why, where there is no equilibrium."""
    drag = Drag(
        friction=float(setting["friction"]),
        depth_mm=setting["depth_mm"],
        element_mm=setting["element_mm"],
        sectors=setting["sectors"],
    )
    try:
        states = solve_drag(drag, TRAVELS_MM)
    except RuntimeError as failure:
        print(f"left out: {drag}: {failure}", flush=True)
        states = ()
    about = {"poisson_ratio": drag.poisson_ratio, "young_modulus_mpa": drag.young_modulus_mpa}
    forces = [(f"{s.travel_mm:.9g}", f"{s.force_n[0]:.5f}", f"{s.force_n[2]:.5f}") for s in states]
    return about | {"rows": forces}


def main(table: Path) -> None:
    """Solve all drags and write the table."""
    settings = [
        {
            "friction": friction,
            "depth_mm": depth,
            "element_mm": element,
            "sectors": sectors,
            "of": digest("drags"),
        }
        for depth, friction in itertools.product(DEPTHS_MM, FRICTIONS)
        for element, sectors in MESHES[depth]
    ]
    file = Path("benchmark-results/drag-table.jsonl")
    found = run_missing(solve, settings, file).explode("rows").dropna(subset="rows")
    found[["shear_x_mm", "fx_n", "fz_n"]] = found["rows"].tolist()
    scene = ["poisson_ratio", "young_modulus_mpa", "friction", "depth_mm", "element_mm"]
    found[[*scene, "shear_x_mm", "fx_n", "fz_n"]].to_csv(table, index=False, lineterminator="\r\n")
    file.unlink()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
