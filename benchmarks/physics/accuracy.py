"""`gelgap benchmark physics`: forces and surfaces against independent finite elements, and what they cost.

Every case is a row of one table of errors, of which each study prints columns. Processor seconds of single-threaded
processes are the run time of the tables, since wall time depends on what else the machine does; both are in the JSON.
"""

import os
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import rms, show, write_json
from gelgap.benchmarks.physics import condensation
from gelgap.benchmarks.physics.cases import Case, Floats, Solver
from gelgap.benchmarks.physics.references import (
    FORCE_UNCERTAINTY,
    HELD_BACK,
    LARGER_SPHERES,
    NO_SLIP_FRICTION,
    drag_cases,
    own_cases,
    press_cases,
    tabled_sphere,
)
from gelgap.render.imaging import psnr_db
from gelgap.sim import MembraneState

Picture = Callable[[MembraneState, np.ndarray], np.ndarray]

QUICK_CASE = FINE_CASE = "nh49_no_slip"
QUICK_DEPTH_MM = 0.4
LESS_DEEP_MM = 0.6
QUICK_PROCESSES = 2
SURFACE_REACH_MM = 5.0
NORMALS_REACH_MM = 3.0  # from the contact
PRESS = (
    *("case", "quality", "Fz rms %", "Fz by pose %", "radius worst %", "ref ± %", "core s/pose", "MiB"),
    "unconverged",
)
SURFACE = ("u_z rms µm", "in-plane rms µm", "peak µm", "normals rms °", "worst °")
MEMBRANE = ("case", "quality", *SURFACE, "PSNR dB")
MEMBRANE_NOTE = (
    "displacement within 5 mm of the contact point, normals within 3 mm of the contact; PSNR: worst depth"
)
DRAG = (
    *("reference", "case", "quality", "Fx rms %", "Fx by pose %", "ref ± %", "Fz rms %", "Fz by pose %"),
    *("Fx/|Fz|", "reference's", "|f_t|/μf_n − 1", "core s/pose", "unconverged"),
)
DRAG_NOTE = (
    f"friction {NO_SLIP_FRICTION:g} does not slip; ratios at the end of the drag; the contact points' own friction "
    "stays within μ of their normal force, the ratio of the whole contact need not"
)
TITLES = {
    "presses": "Presses against independent finite elements",
    "held back": "Held-back presses",
    "larger": "Larger spheres",
    "drags": "Drags to 0.6 mm, ν 0.48, against 3-D finite elements",
}
TARGETS = {
    "Fz rms, %": 2.0,
    "Fz worst, %": 4.0,
    "Fx rms, %": 5.0,
    "u_z rms, µm": 5.0,
    "in-plane rms, µm": 5.0,
    "surface peak, µm": 15.0,
    "normals rms, °": 1.0,
    "normals worst, °": 4.0,
    "contact radius worst, %": 3.0,
    "peak memory, MiB": 2048.0,
}


def run(quick: bool, out_dir: Path) -> None:
    """Run the benchmark, print its tables, and write `physics.json` and `physics-frontier.png` to `out_dir`.

    The quick form is a press down to 0.4 mm and a drag; the full one adds all others whose solution is known. Until the
    end, what is solved is kept in `out_dir`/physics-solves: a benchmark that was stopped goes on from there.
    """
    started = time.perf_counter()
    solver = Solver(QUICK_PROCESSES if quick else os.cpu_count() or 1, out_dir / "physics-solves")
    cases = quick_cases() if quick else full_cases(solver)
    solved, picture = solver.cases(cases), picture_maker()
    rows = [errors(case, solved[case], picture if case.study == "presses" else None) for case in cases]
    results = {study: own.dropna(axis=1, how="all") for study, own in pd.DataFrame(rows).groupby("study")}
    for study, title in TITLES.items():
        if study == "drags":
            show(title, results[study][list(DRAG)], DRAG_NOTE)
        elif study in results:
            show(f"{title}: force, contact radius, cost", results[study][list(PRESS)])
            show(f"{title}: membrane", results[study].reindex(columns=list(MEMBRANE)), MEMBRANE_NOTE)
    results["condensation"] = condensation.condensation_table(solver, quick)
    show_targets(results["presses"], results["drags"])
    figure = out_dir / "physics-frontier.png"
    plot_frontier(figure, frontier(results["presses"]))
    wall_s = time.perf_counter() - started
    about = {"quick": quick, "processes": solver.processes, "wall_s": wall_s}
    write_json(out_dir / "physics.json", results | about)
    shutil.rmtree(solver.folder, ignore_errors=True)
    print(f"{wall_s:.0f} s in all; results in {out_dir / 'physics.json'}, plot in {figure}")


def quick_cases() -> list[Case]:
    """Return one press at two qualities, and one drag."""
    return [
        *at_both([press_cases()[QUICK_CASE].down_to(QUICK_DEPTH_MM)]),
        replace(drag_cases()[0], quality="draft"),
    ]


def full_cases(solver: Solver) -> list[Case]:
    """Return all presses and drags whose solution is known."""
    tables, sphere = press_cases(), tabled_sphere()
    less_deep = replace(sphere.down_to(LESS_DEEP_MM), name=f"{sphere.name} to {LESS_DEEP_MM:g} mm")
    return [
        *at_both(tables.values()),
        replace(tables[FINE_CASE], quality="fine"),
        *own_cases("held back", HELD_BACK, solver),
        *at_both([sphere, less_deep, *own_cases("larger", LARGER_SPHERES, solver)]),
        *at_both(drag_cases()),
    ]


def at_both(cases: Iterable[Case]) -> list[Case]:
    """Return cases at `draft` and at `standard`."""
    cases = list(cases)
    return [replace(case, quality=quality) for quality in ("draft", "standard") for case in cases]


def errors(case: Case, solved: Any, picture: Picture | None = None) -> dict[str, Any]:
    """Compare what `Solver.cases` returns for a case with the truth: a row of the table.

    Presses have errors of the membrane, and with a `picture` maker of their pictures; drags those of Fx.
    """
    truth, states = case.truth, solved.states
    row = force_errors(case, solved, np.array([state.force_n for state in states]))
    if truth.profiles:
        expected = [truth.displacement_mm(index, s.x_mm, s.y_mm) for index, s in enumerate(states)]
        radius = np.array([state.contact_radius_mm for state in states]) / truth.radius_mm
        row |= {
            "radius worst %": float(np.abs(100 * (radius - 1)).max()),
            "ref ± %": float(100 * (truth.radius_uncertainty_mm / truth.radius_mm).max()),
            **combined(map(surface_errors, states, expected, truth.radius_mm)),
        }
        if picture is not None:
            pairs = zip(states, expected, strict=True)
            psnrs = [psnr_db(picture(s, s.displacement_mm), picture(s, right)) for s, right in pairs]
            row["PSNR dB"] = min(psnrs)
    return row


def force_errors(case: Case, solved: Any, force_n: Floats) -> dict[str, Any]:
    """Compare forces (poses, 3) with the truth, Fx where the indenter is dragged; with what they cost."""
    truth, states = case.truth, solved.states
    fz = 100 * (force_n[:, 2] / truth.force_n[:, 2] - 1)
    row = {
        "study": case.study,
        "reference": truth.source,
        "case": case.name,
        "quality": case.quality,
        "Fz rms %": rms(fz),
        "Fz by pose %": signed(fz),
        "core s/pose": solved.core_s / len(states),
        "wall s/pose": solved.wall_s / len(states),
        "MiB": solved.peak_mib,
        "unconverged": sum(not state.converged for state in states),
        "fz_percent": fz.tolist(),
    }
    dragged = np.array([pose.radius_mm > 0 for pose in case.poses])
    if dragged.any():
        fx = 100 * (force_n[dragged, 0] / truth.force_n[dragged, 0] - 1)
        row |= {
            "Fx rms %": rms(fx),
            "Fx by pose %": signed(fx),
            "ref ± %": 100 * truth.fx_uncertainty,
            "Fx/|Fz|": -force_n[-1, 0] / force_n[-1, 2],
            "reference's": -truth.force_n[-1, 0] / truth.force_n[-1, 2],
            "|f_t|/μf_n − 1": max(state.diagnostics.coulomb_excess for state in states),
            "fx_percent": fx.tolist(),
        }
    return row


def surface_errors(state: MembraneState, expected_mm: Floats, contact_radius_mm: float) -> dict[str, float]:
    """Compare a membrane with displacements (ny, nx, 3) on its rest grid, centred on the contact."""
    radius = np.hypot(*np.meshgrid(state.x_mm, state.y_mm))
    error = 1e3 * (state.displacement_mm - expected_mm)[radius <= SURFACE_REACH_MM]
    in_plane = np.hypot(error[:, 0], error[:, 1])
    own, expected = (normals(state.x_mm, state.y_mm, u) for u in (state.displacement_mm, expected_mm))
    angle = np.degrees(np.arccos(np.clip((own * expected).sum(-1), -1, 1)))
    angle = angle[radius <= contact_radius_mm + NORMALS_REACH_MM]
    peak = float(max(np.abs(error[:, 2]).max(), in_plane.max()))
    values = rms(error[:, 2]), rms(in_plane), peak, rms(angle), float(angle.max())
    return dict(zip(SURFACE, values, strict=True))


def combined(surfaces: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Return the root mean squares of the rms errors and the largest of the peaks."""
    table = pd.DataFrame(surfaces)
    return {name: rms(table[name]) if "rms" in name else float(table[name].max()) for name in SURFACE}


def normals(x_mm: Floats, y_mm: Floats, displacement_mm: Floats) -> Floats:
    """Return unit normals (ny, nx, 3) of the deformed membrane by central differences, pointing to +z at rest."""
    position = displacement_mm.astype(float)
    position[..., 0] += x_mm
    position[..., 1] += y_mm[:, None]
    along_y, along_x = np.gradient(position, y_mm, x_mm, axis=(0, 1))
    normal = np.cross(along_x, along_y)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def picture_maker() -> Picture:
    """Return a function that renders a displacement on a state's grid, with the paper's sensor under i0."""
    from gelgap.render import Illumination, MembraneRenderer, Sensor

    renderer = MembraneRenderer(Sensor.preset("paper"), Illumination.preset("i0"))
    return lambda state, displacement_mm: renderer.picture(
        state.x_mm, state.y_mm, np.asarray(displacement_mm, np.float32)
    )


def show_targets(presses: pd.DataFrame, drags: pd.DataFrame) -> None:
    """Print the accuracy that `standard` promises for the isochoric gel beside what was measured."""
    found = presses[(presses["quality"] == "standard") & presses["case"].str.startswith("nh")]
    drags = drags[drags["quality"] == max(drags["quality"])]  # "standard" if it is there
    fz = np.concatenate(found["fz_percent"].to_list())
    fx = np.concatenate(drags["fx_percent"].to_list())
    surface = combined(found[list(SURFACE)].to_dict("records")).values()
    worst = found[["radius worst %", "MiB"]].max()
    table = pd.DataFrame(TARGETS.items(), columns=["quantity", "target"])
    table.insert(1, "measured", [rms(fz), np.abs(fz).max(), rms(fx), *surface, *worst])
    table["met"] = table["measured"] <= table["target"]
    table["target"] = [f"≤ {limit:g}" for limit in table["target"]]
    psnr = found["PSNR dB"].min()
    table.loc[len(table)] = ["picture PSNR, dB", psnr, "≥ 40", psnr >= 40]
    show(f"Targets at standard over {len(found)} cases", table, f"Fx: drags at {drags['quality'].iloc[0]}")


def frontier(presses: pd.DataFrame) -> pd.DataFrame:
    """Return the qualities by cost: mean processor time and error over the cases that all of them solved."""
    shared = presses[presses.groupby("case")["quality"].transform("nunique") == presses["quality"].nunique()]
    of_quality = shared.groupby("quality")
    points = of_quality["core s/pose"].mean().rename("seconds").to_frame()
    return points.assign(error=of_quality["Fz rms %"].agg(rms)).sort_values("seconds")


def plot_frontier(path: Path, points: pd.DataFrame) -> None:
    """Draw error against run time, log-log; the reference's uncertainty is shaded, the target dashed."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots()
    axes.loglog(points["seconds"], points["error"], "o-")
    for quality, seconds, error in points.itertuples():
        axes.annotate(quality, (seconds, error), xytext=(5, 4), textcoords="offset points", fontsize=8)
    uncertainty = 100 * FORCE_UNCERTAINTY
    span = min(axes.get_ylim()[0], uncertainty / 3), uncertainty
    axes.axhspan(*span, color="0.85", label="the reference's uncertainty")
    axes.axhline(TARGETS["Fz rms, %"], color="0.4", linestyle="--", linewidth=1, label="target at standard")
    axes.set(
        title="Run time against error of the normal force",
        xlabel="processor time per pose, s",
        ylabel="Fz error, rms, %",
    )
    axes.grid(visible=True, which="both", linewidth=0.3)
    figure.legend(fontsize=8, loc="outside lower center", ncols=2)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)


def signed(values: Sequence[float] | Floats) -> str:
    """Return numbers with one decimal and their signs."""
    return " ".join(f"{value:+.1f}" for value in values)
