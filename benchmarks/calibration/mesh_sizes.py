"""How the mesh of `standard` was chosen: run time and errors of others beside it, in presses to a third of the pad.

`python -m gelgap.benchmarks.calibration.mesh_sizes` takes some five minutes on two cores.
"""

import itertools
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path

from gelgap.benchmarks.common.tables import print_table
from gelgap.benchmarks.physics.cases import SolvedCase, Workers
from gelgap.benchmarks.physics.presses import PressErrors, judge_press, press_case, signed
from gelgap.benchmarks.physics.reference import press_references
from gelgap.sim import plan_visit
from gelgap.sim.newton import solve
from gelgap.sim.problem import QUALITIES, MeshSize

CASES = ("nh49_no_slip", "nh49_frictionless", "nh499_no_slip")
STANDARD = QUALITIES["standard"].disc
SIZES = {
    "standard": STANDARD,
    "8 sectors": replace(STANDARD, sectors=8),
    "16 sectors": replace(STANDARD, sectors=16),
    "vertices 0.25 mm apart": replace(STANDARD, surface_mm=0.25),
    "layers grow by 1.5": replace(STANDARD, layer_growth=1.5),
    "the former one": MeshSize(0.25, 0.15, 1.25, 1.5, 8, stiffness=(0.0044, 0.00052)),
}


@dataclass(frozen=True)
class Trial:
    """A case of the tables on a mesh of some size."""

    name: str
    case: str
    size: MeshSize


def press(trial: Trial) -> PressErrors:
    """Solve a case of the tables with a mesh of that size, and compare it with the table."""
    reference = press_references()[trial.case]
    case = press_case(reference, "standard")
    plan = plan_visit(case.elastomer, case.indenter, case.poses, case.quality, case.sharing)
    problem = plan.solves[0].problem
    started = time.process_time()
    solution = solve(replace(problem, quality=replace(problem.quality, disc=trial.size)))
    seconds = time.process_time() - started
    states = tuple(plan.state(index, solution) for index in range(len(case.poses)))
    return judge_press(SolvedCase(case, states, seconds, seconds, 0.0), reference)


def main() -> None:
    """Print run time and errors of each mesh."""
    trials = [Trial(name, case, size) for (name, size), case in itertools.product(SIZES.items(), CASES)]
    workers = Workers(os.cpu_count() or 1, Path("benchmark-results/mesh-size-solves"))
    found = workers.map(press, trials)
    print_table(
        "Meshes of half a disc",
        ["mesh", "case", "core s/pose", "Fz by depth %", "radius worst %", "u_z rms µm", "in-plane rms µm",
         "peak µm", "normals rms °", "worst °", "unconverged"],
        (
            [trial.name, e.case, e.processor_s_per_pose, signed(e.fz_percent), e.radius_worst_percent,
             *e.surface.values, e.unconverged]
            for trial, e in zip(trials, found, strict=True)
        ),
        note="Fz with the stiffness of standard's mesh; another mesh would have its own",
    )  # fmt: skip
    workers.forget()


if __name__ == "__main__":
    main()
