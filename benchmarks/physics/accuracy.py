"""`gelgap benchmark physics`: forces and surfaces against independent finite elements, and what they cost.

Processor seconds of single-threaded processes are the run time of the tables, since wall time depends on what
else the machine does; both are in the JSON.
"""

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gelgap.benchmarks.common.tables import Point, plot_frontier, print_table, write_json
from gelgap.benchmarks.physics import closed_forms, condensation, path, savings
from gelgap.benchmarks.physics.cases import Case, Workers
from gelgap.benchmarks.physics.drags import DragErrors, compare_drags, drag_case
from gelgap.benchmarks.physics.larger_spheres import sphere_references
from gelgap.benchmarks.physics.presses import (
    HELD_BACK,
    PressErrors,
    compare_presses,
    held_back_reference,
    own_energy,
    own_energy_cases,
    picture_maker,
    press_case,
)
from gelgap.benchmarks.physics.reference import (
    FORCE_UNCERTAINTY,
    coulomb_drags,
    no_slip_drags,
    press_references,
)
from gelgap.benchmarks.physics.surface_errors import combined, rms
from gelgap.sim.problem import QUALITIES

QUICK_CASE = FINE_CASE = "nh49_no_slip"
QUICK_DEPTH_MM = 0.4
QUICK_PROCESSES = 2
SLOWEST_FIRST = ("fine", "standard", "draft")
TITLE = "Presses against independent finite elements"


def run(quick: bool, out_dir: Path) -> None:
    """Run the benchmark, print its tables, and write `physics.json` and `physics-frontier.png` to `out_dir`.

    Until the end, what is solved is kept in `out_dir`/physics-solves: a benchmark that was stopped goes on from there.
    """
    started = time.perf_counter()
    workers = Workers(QUICK_PROCESSES if quick else os.cpu_count() or 1, out_dir / "physics-solves")
    results = quick_tables(workers) if quick else full_tables(workers)
    print_targets(results["presses"], results["shears"])
    figure = out_dir / "physics-frontier.png"
    plot_frontier(
        figure,
        [*frontier(results["presses"]), *(() if quick else savings.points(results["savings"]["savings"]))],
        title="Run time against error of the normal force",
        time_label="processor time per pose, s",
        error_label="Fz error, rms, %",
        uncertainty=100 * FORCE_UNCERTAINTY,
        targets=(2.0,),
        unjoined=(savings.SERIES,),
    )
    results |= {"quick": quick, "processes": workers.processes, "wall_s": time.perf_counter() - started}
    write_json(out_dir / "physics.json", results)
    workers.forget()
    print(f"{results['wall_s']:.0f} s in all; results in {out_dir / 'physics.json'}, plot in {figure}")


def quick_tables(workers: Workers) -> dict[str, Any]:
    """Measure one press down to 0.4 mm, shallow presses and one drag."""
    reference = press_references()[QUICK_CASE].down_to(QUICK_DEPTH_MM)
    presses = {press_case(reference, quality): reference for quality in ("draft", "standard")}
    drags = {drag_case(no_slip_drags()[0], "draft"): no_slip_drags()[0]}
    solve_ahead(workers, [*presses, *drags, closed_forms.shallow_case("draft")])
    pressed = compare_presses(TITLE, presses, workers, picture_maker())
    return {
        "presses": pressed,
        "theory": closed_forms.shallow_presses("draft", workers),
        "convergence": convergence(pressed),
        "shears": compare_drags(drags, workers),
        "condensation": condensation.measure(condensation.cases(quick=True), workers),
    }


def full_tables(workers: Workers) -> dict[str, Any]:
    """Measure all presses and drags that there is a reference for, the paper's path and what sharing changes."""
    presses = {
        press_case(reference, quality): reference
        for quality in QUALITIES
        for name, reference in press_references().items()
        if quality != "fine" or name == FINE_CASE
    }
    held_back = {press_case(r, "standard"): r for r in workers.map(held_back_reference, HELD_BACK)}
    spheres = sphere_references(workers)
    larger = {press_case(r, quality): r for quality in ("draft", "standard") for r in spheres}
    drag_references = (*no_slip_drags(), *coulomb_drags())
    drags = {drag_case(r, quality): r for quality in ("draft", "standard") for r in drag_references}
    others = [closed_forms.shallow_case("standard"), closed_forms.PARTIAL_SLIP, *own_energy_cases()]
    saved = [*savings.cases(), *savings.edge_cases()]
    solve_ahead(workers, [*presses, *held_back, *larger, *drags, *others, *saved])
    own = own_energy(workers)
    pressed = compare_presses(TITLE, presses, workers, picture_maker())
    return {
        "own_energy": own,
        "presses": pressed,
        "held_back": compare_presses("Held-back presses", held_back, workers),
        "larger_spheres": compare_presses("Larger spheres", larger, workers),
        "partial_slip": closed_forms.partial_slip(workers),
        "theory": closed_forms.shallow_presses("standard", workers),
        "convergence": convergence(pressed),
        "path": path.measure(workers),
        "condensation": condensation.measure(condensation.cases(quick=False), workers),
        "savings": savings.measure(workers),
        "shears": compare_drags(drags, workers),
    }


def solve_ahead(workers: Workers, cases: Sequence[Case]) -> None:
    """Solve all cases side by side, the slowest first; the tables find them solved."""
    workers.solve(sorted(cases, key=lambda case: SLOWEST_FIRST.index(case.quality)))


def convergence(presses: Sequence[PressErrors]) -> list[list[object]]:
    """Print the order of convergence: the power of the surface spacing with which the error of Fz falls."""
    rows: list[list[object]] = []
    for case in dict.fromkeys(press.case for press in presses):
        found = [press for press in presses if press.case == case]
        if len(found) > 1:
            size_mm = [QUALITIES[press.quality].disc.surface_mm for press in found]
            error = [press.fz_rms_percent for press in found]
            by_quality = " ".join(f"{press.quality} {press.fz_rms_percent:.2f}" for press in found)
            rows.append([case, by_quality, float(np.polyfit(np.log(size_mm), np.log(error), 1)[0])])
    print_table("Mesh convergence", ["case", "Fz rms % by quality", "order"], rows)
    return rows


def print_targets(presses: Sequence[PressErrors], drags: Sequence[DragErrors]) -> None:
    """Print the accuracy that `standard` promises for the isochoric gel beside what was measured."""
    found = [p for p in presses if p.quality == "standard" and p.case.startswith("nh")]
    drags = [drag for drag in drags if drag.quality == "standard"] or drags
    surface = combined([press.surface for press in found])
    lines = [
        ("Fz rms, %", rms([e for p in found for e in p.fz_percent]), 2.0),
        ("Fz worst, %", max(p.fz_worst_percent for p in found), 4.0),
        (f"Fx rms ({drags[0].quality}), %", rms([e for drag in drags for e in drag.fx_percent]), 5.0),
        ("u_z rms, µm", surface.uz_rms_um, 5.0),
        ("in-plane rms, µm", surface.in_plane_rms_um, 5.0),
        ("surface peak, µm", surface.peak_um, 15.0),
        ("normals rms, °", surface.normal_rms_deg, 1.0),
        ("normals worst, °", surface.normal_worst_deg, 4.0),
        ("contact radius worst, %", max(p.radius_worst_percent for p in found), 3.0),
        ("peak memory, MiB", max(p.peak_memory_mib for p in found), 2048.0),
    ]
    rows = [[name, value, f"≤ {limit:g}", value <= limit] for name, value, limit in lines]
    psnr = min(p.psnr_db for p in found if p.psnr_db is not None)
    rows.append(["picture PSNR, dB", psnr, "≥ 40", psnr >= 40])
    print_table(
        f"Targets at standard over {len(found)} cases", ["quantity", "measured", "target", "met"], rows
    )


def frontier(presses: Sequence[PressErrors]) -> list[Point]:
    """Return the qualities as points: mean cost and error over the cases that all of them solved."""
    by_quality: dict[str, dict[str, PressErrors]] = {}
    for press in presses:
        by_quality.setdefault(press.quality, {})[press.case] = press
    shared = set.intersection(*map(set, by_quality.values()))
    points = []
    for quality, found in by_quality.items():
        seconds = float(np.mean([found[case].processor_s_per_pose for case in shared]))
        error = rms([found[case].fz_rms_percent for case in shared])
        points.append(Point("one descent: against finite elements", quality, seconds, error))
    return points
