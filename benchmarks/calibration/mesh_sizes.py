"""How the mesh of `standard` was chosen: run time and errors of others beside it, in presses to a third of the pad.

`python -m gelgap.benchmarks.calibration.mesh_sizes` takes some five minutes on two cores.
"""

import argparse
import itertools
import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

from gelgap.benchmarks.common.tables import print_table
from gelgap.benchmarks.physics.accuracy import PressErrors, judge_press, press_job
from gelgap.benchmarks.physics.reference import press_references
from gelgap.benchmarks.physics.solve_jobs import Outcome, single_threaded
from gelgap.sim import PosePath, plan_solves
from gelgap.sim.newton import solve
from gelgap.sim.quality import QUALITIES, MeshSize

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


def press(case: str, size: MeshSize) -> PressErrors:
    """Solve a case of the tables with a mesh of that size, and judge it."""
    reference = press_references()[case]
    job = press_job(reference, "standard")
    path = PosePath(case, tuple(replace(pose, trajectory=0) for pose in job.poses))
    plan = plan_solves(job.elastomer, job.indenter, path, job.quality, job.sharing)
    problem = plan.solves[0].problem
    started = time.process_time()
    solution = solve(replace(problem, quality=replace(problem.quality, disc=size)))
    seconds = time.process_time() - started
    states = tuple(plan.state(index, solution) for index in range(len(job.poses)))
    return judge_press(Outcome(job, states, seconds, seconds, 0.0), reference)


def main() -> None:
    """Print run time and errors of each mesh."""
    parser = argparse.ArgumentParser(description="Compare meshes of the quality standard.")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    chosen = parser.parse_args()
    scenes = list(itertools.product(SIZES, CASES))
    spawn = multiprocessing.get_context("spawn")
    with single_threaded(), ProcessPoolExecutor(chosen.processes, mp_context=spawn) as pool:
        found = list(pool.map(press, [case for _, case in scenes], [SIZES[name] for name, _ in scenes]))
    print_table(
        "Meshes of half a disc",
        ["mesh", "case", "core s a pose", "Fz by depth %", "radius worst %", "u_z rms µm", "in-plane rms µm",
         "peak µm", "normals rms °", "worst °", "unconverged"],
        (
            [name, case, e.processor_s_per_pose, " ".join(f"{x:+.1f}" for x in e.fz_percent),
             max(map(abs, e.radius_percent)), e.surface.uz_rms_um, e.surface.in_plane_rms_um, e.surface.peak_um,
             e.surface.normal_rms_deg, e.surface.normal_worst_deg, e.unconverged]
            for (name, case), e in zip(scenes, found, strict=True)
        ),
        note="Fz with the stiffness of standard's mesh, which another mesh would have its own of",
    )  # fmt: skip


if __name__ == "__main__":
    main()
