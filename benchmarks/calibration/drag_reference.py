"""Tabulate drags with Coulomb friction by the project's own 3-D solver.

Run as `python -m gelgap.benchmarks.calibration.drag_reference`.

Each drag is solved on two meshes, so that the table shows its own uncertainty, and its rows are written when it is
done: a run that was stopped goes on where it was. The table is assets/reference/drag_coulomb.csv.
"""

import csv
import math
import time
from pathlib import Path

from gelgap.assets import asset_path
from gelgap.benchmarks.fem.hexahedral import Drag, solve_drag

COLUMNS = (
    "poisson_ratio", "young_modulus_mpa", "friction", "depth_mm", "element_mm", "shear_x_mm", "fx_n", "fz_n",
    "sticking_fraction",
)  # fmt: skip
TRAVELS_MM = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
CASES = [(friction, depth) for depth in (0.6, 1.0, 0.2) for friction in (0.3, 0.8, math.inf)]


def meshes(depth_mm: float) -> tuple[tuple[float, int], ...]:
    """Return (element_mm, sectors) of the coarse and the fine mesh; a shallow contact is small."""
    return ((0.2, 12), (0.125, 20)) if depth_mm <= 0.3 else ((0.36, 12), (0.25, 20))


def main() -> None:
    path = Path(asset_path("reference")) / "drag_coulomb.csv"
    done = _done(path)
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if not done:
            writer.writerow(COLUMNS)
        for friction, depth in CASES:
            for element, sectors in meshes(depth):
                if (friction, depth, element) not in done:
                    drag = Drag(friction=friction, depth_mm=depth, element_mm=element, sectors=sectors)
                    try:
                        writer.writerows(_rows(drag))
                    except RuntimeError as failure:
                        print(f"left out: {failure}", flush=True)
                    file.flush()


def _done(path: Path) -> set[tuple[float, float, float]]:
    if not path.exists():
        return set()
    with path.open(newline="", encoding="utf-8") as file:
        return {
            (float(r["friction"]), float(r["depth_mm"]), float(r["element_mm"])) for r in csv.DictReader(file)
        }


def _rows(drag: Drag) -> list[list[object]]:
    started = time.process_time()
    states = solve_drag(drag, TRAVELS_MM, step_mm=0.05)
    print(
        f"friction {drag.friction} depth {drag.depth_mm} element {drag.element_mm}: "
        f"Fx {states[-1].force_n[0]:.4f} Fz {states[-1].force_n[2]:.4f}, {time.process_time() - started:.0f} s",
        flush=True,
    )
    return [
        [drag.poisson_ratio, drag.young_modulus_mpa, drag.friction, drag.depth_mm, drag.element_mm,
         f"{state.travel_mm:.9g}", f"{state.force_n[0]:.5f}", f"{state.force_n[2]:.5f}",
         f"{state.sticking_fraction:.3f}"]
        for state in states
    ]  # fmt: skip


if __name__ == "__main__":
    main()
