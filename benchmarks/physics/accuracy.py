"""`gelgap benchmark physics`: forces and surfaces against independent finite elements, and what they cost.

Processor seconds of single-threaded processes are the run time of the tables, since wall time depends on what
else the machine does; both are in the JSON.
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
from numpy.typing import ArrayLike

from gelgap.benchmarks.common import plot_frontier, psnr_db, show, write_json
from gelgap.benchmarks.fem import theory
from gelgap.benchmarks.physics import savings
from gelgap.benchmarks.physics.cases import Case, Floats, SolvedCase, Solver
from gelgap.benchmarks.physics.references import (
    FORCE_UNCERTAINTY,
    HELD_BACK,
    LARGER_SPHERES,
    LESS_DEEP_MM,
    NO_SLIP_FRICTION,
    drag_cases,
    own_cases,
    press_cases,
    tabled_sphere,
)
from gelgap.sim import Elastomer, MembraneState, Pose, Sphere
from gelgap.sim.problem import QUALITIES

Picture = Callable[[MembraneState, np.ndarray], np.ndarray]

QUICK_CASE = FINE_CASE = "nh49_no_slip"
QUICK_DEPTH_MM = 0.4
QUICK_PROCESSES = 2
TITLE = "Presses against independent finite elements"
RUBBING = {"friction": 0.8}
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
SHALLOW_DEPTHS_MM = np.array([0.05, 0.1, 0.2])
SHALLOW = Case(
    "theory",
    "shallow",
    Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.495, friction=0.0),
    tuple(Pose(depth_mm=float(depth)) for depth in SHALLOW_DEPTHS_MM),
)
SLIP_SHEAR_MODULUS_MPA = 0.1
PARTIAL_SLIP = Case(
    "theory",
    "partial slip",
    Elastomer(
        young_modulus_mpa=2 * SLIP_SHEAR_MODULUS_MPA * (1 + 0.495),
        poisson_ratio=0.495,
        friction=0.3,
        thickness_mm=10.0,
        pad_size_mm=(60.0, 60.0),
    ),
    tuple(Pose(depth_mm=0.1, shear_x_mm=travel) for travel in (0.0, 0.01, 0.02, 0.03, 0.05, 0.08)),
    indenter=Sphere(diameter_mm=6.0),
)


def run(quick: bool, out_dir: Path) -> None:
    """Run the benchmark, print its tables, and write `physics.json` and `physics-frontier.png` to `out_dir`.

    Until the end, what is solved is kept in `out_dir`/physics-solves: a benchmark that was stopped goes on from there.
    """
    started = time.perf_counter()
    solver = Solver(QUICK_PROCESSES if quick else os.cpu_count() or 1, out_dir / "physics-solves")
    results = quick_tables(solver) if quick else full_tables(solver)
    show_targets(results["presses"], results["shears"])
    points = frontier(results["presses"])
    if not quick:
        points = pd.concat([points, savings.points(results["savings"])])
    figure = out_dir / "physics-frontier.png"
    plot_frontier(
        figure,
        points,
        title="Run time against error of the normal force",
        time_label="processor time per pose, s",
        error_label="Fz error, rms, %",
        uncertainty=100 * FORCE_UNCERTAINTY,
        targets=(2.0,),
        unjoined=(savings.SERIES,),
    )
    wall_s = time.perf_counter() - started
    about = {"quick": quick, "processes": solver.processes, "wall_s": wall_s}
    write_json(out_dir / "physics.json", results | about)
    shutil.rmtree(solver.folder, ignore_errors=True)
    print(f"{wall_s:.0f} s in all; results in {out_dir / 'physics.json'}, plot in {figure}")


def quick_tables(solver: Solver) -> dict[str, pd.DataFrame]:
    """Measure one press down to 0.4 mm, shallow presses and one drag."""
    press = press_cases()[QUICK_CASE].down_to(QUICK_DEPTH_MM)
    presses = at_both([press])
    drags, shallow = [replace(drag_cases()[0], quality="draft")], replace(SHALLOW, quality="draft")
    solved = solver.solve([*presses, *drags, shallow])
    pressed = press_table(TITLE, presses, solved, picture_maker())
    return {
        "presses": pressed,
        "theory": shallow_table(solved[shallow]),
        "convergence": convergence_table(pressed),
        "shears": drag_table(drags, solved),
        "condensation": savings.condensation_table(solver, quick=True),
    }


def full_tables(solver: Solver) -> dict[str, pd.DataFrame]:
    """Measure all presses and drags whose solution is known, the paper's path and what sharing changes."""
    tables = press_cases()
    presses = [*at_both(tables.values()), replace(tables[FINE_CASE], quality="fine")]
    held_back = own_cases("held back", HELD_BACK, solver)
    sphere = tabled_sphere()
    less_deep = replace(sphere.down_to(LESS_DEEP_MM), name=f"{sphere.name} to {LESS_DEEP_MM:g} mm")
    spheres = [sphere, less_deep, *own_cases("larger", LARGER_SPHERES, solver)]
    larger, drags = at_both(spheres), at_both(drag_cases())
    own_energy = [
        replace(case, study="own energy", elastomer=case.elastomer.model_copy(update=RUBBING))
        for case in (tables["snh45_no_slip"], tables["nh49_no_slip"])
    ]
    saved = [*savings.saving_cases(), *savings.edge_cases()]
    solved = solver.solve([*presses, *held_back, *larger, *drags, SHALLOW, PARTIAL_SLIP, *own_energy, *saved])
    own_energies = press_table("Gels with friction 0.8 against the no-slip tables", own_energy, solved)
    pressed = press_table(TITLE, presses, solved, picture_maker())
    return {
        "own_energy": own_energies,
        "presses": pressed,
        "held_back": press_table("Held-back presses", held_back, solved),
        "larger_spheres": press_table("Larger spheres", larger, solved),
        "partial_slip": partial_slip_table(solved[PARTIAL_SLIP]),
        "theory": shallow_table(solved[SHALLOW]),
        "convergence": convergence_table(pressed),
        "path": savings.path_table(solver),
        "condensation": savings.condensation_table(solver, quick=False),
        "savings": savings.saving_table(solved),
        "edges": savings.edge_table(solved),
        "descents": savings.descent_table(solver),
        "shears": drag_table(drags, solved),
    }


def at_both(cases: Iterable[Case]) -> list[Case]:
    """Return cases at `draft` and at `standard`."""
    cases = list(cases)
    return [replace(case, quality=quality) for quality in ("draft", "standard") for case in cases]


def press_table(
    title: str, cases: Sequence[Case], solved: Mapping[Case, SolvedCase], picture: Picture | None = None
) -> pd.DataFrame:
    """Compare presses with their truth; print force, contact radius and cost, then the membrane."""
    rows = pd.DataFrame([press_errors(solved[case], picture) for case in cases])
    show(f"{title}: force, contact radius, cost", rows[list(PRESS)])
    show(f"{title}: membrane", rows[list(MEMBRANE)], MEMBRANE_NOTE)
    return rows


def force_errors(solved: SolvedCase) -> dict[str, Any]:
    """Compare the forces of a case with the truth, and say what it took."""
    case, truth, force_n = solved.case, solved.case.truth, solved.force_n
    dragged = np.array([pose.radius_mm > 0 for pose in case.poses])
    fx = 100 * (force_n[dragged, 0] / truth.force_n[dragged, 0] - 1)
    fz = 100 * (force_n[:, 2] / truth.force_n[:, 2] - 1)
    return {
        "reference": truth.source,
        "case": case.name,
        "quality": case.quality,
        "Fx rms %": rms(fx) if len(fx) else None,
        "Fx by pose %": signed(fx),
        "Fz rms %": rms(fz),
        "Fz by pose %": signed(fz),
        "core s/pose": solved.core_s_per_pose,
        "wall s/pose": solved.wall_s_per_pose,
        "MiB": solved.peak_mib,
        "unconverged": solved.unconverged,
        "fx_percent": fx.tolist(),
        "fz_percent": fz.tolist(),
    }


def press_errors(solved: SolvedCase, picture: Picture | None = None) -> dict[str, Any]:
    """Compare the states of a descent with the truth; with a `picture` maker their pictures too."""
    surfaces, psnrs, truth = [], [], solved.case.truth
    for index, state in enumerate(solved.states):
        expected = truth.displacement_mm(index, state.x_mm, state.y_mm)
        surfaces.append(surface_errors(state, expected, float(truth.radius_mm[index])))
        if picture is not None:
            psnrs.append(psnr_db(picture(state, state.displacement_mm), picture(state, expected)))
    radius = np.array([state.contact_radius_mm for state in solved.states]) / truth.radius_mm
    return {
        **force_errors(solved),
        "radius worst %": float(np.abs(100 * (radius - 1)).max()),
        "ref ± %": float(100 * (truth.radius_uncertainty_mm / truth.radius_mm).max()),
        **combined(surfaces),
        "PSNR dB": min(psnrs, default=None),
    }


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


def combined(errors: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Return the root mean squares of the rms errors and the largest of the peaks."""
    columns = {name: [one[name] for one in errors] for name in SURFACE}
    return {name: rms(values) if "rms" in name else max(values) for name, values in columns.items()}


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


def convergence_table(presses: pd.DataFrame) -> pd.DataFrame:
    """Print the order of convergence: the power of the surface spacing with which the error of Fz falls."""
    rows = []
    for case, found in presses.groupby("case", sort=False):
        if len(found) > 1:
            size_mm = [QUALITIES[quality].disc.surface_mm for quality in found["quality"]]
            order = np.polyfit(np.log(size_mm), np.log(found["Fz rms %"]), 1)[0]
            errors = zip(found["quality"], found["Fz rms %"], strict=True)
            rows.append((case, " ".join(f"{quality} {error:.2f}" for quality, error in errors), order))
    table = pd.DataFrame(rows, columns=["case", "Fz rms % by quality", "order"])
    show("Mesh convergence", table)
    return table


def drag_table(cases: Sequence[Case], solved: Mapping[Case, SolvedCase]) -> pd.DataFrame:
    """Compare drags with their truth, and print both's forces."""
    rows = []
    for case in cases:
        end, expected = solved[case].force_n[-1], case.truth.force_n[-1]
        ratios = {"Fx/|Fz|": -end[0] / end[2], "reference's": -expected[0] / expected[2]}
        ratios["|f_t|/μf_n − 1"] = max(state.diagnostics.coulomb_excess for state in solved[case].states)
        rows.append(force_errors(solved[case]) | {"ref ± %": 100 * case.truth.fx_uncertainty} | ratios)
    table = pd.DataFrame(rows)
    note = (
        f"friction {NO_SLIP_FRICTION:g} does not slip; ratios at the end of the drag; the contact points' own "
        "friction stays within μ of their normal force, the ratio of the whole contact need not"
    )
    show("Drags to 0.6 mm, ν 0.48, against 3-D finite elements", table[list(DRAG)], note)
    return table


def shallow_table(solved: SolvedCase) -> pd.DataFrame:
    """Print shallow presses beside Hertz and the bonded layer."""
    force, layer = -solved.force_n[:, 2], theory.bonded_layer_force_n(0.3, 1.5, 3.0, SHALLOW_DEPTHS_MM)
    columns = {
        "depth mm": [f"{depth:g}" for depth in SHALLOW_DEPTHS_MM],
        "|Fz| N": force,
        "Hertz half-space N": theory.hertz_force_n(0.3, 0.495, 1.5, SHALLOW_DEPTHS_MM),
        "bonded layer N": layer,
        "to the layer %": 100 * (force / layer - 1),
    }
    note = (
        "finite strain and the exact sphere put converged finite elements 1.6 % below the layer at 0.05 mm, "
        "2.4 % at 0.1 mm and 3.7 % at 0.2 mm"
    )
    show("Closed forms: frictionless, ν 0.495", table := pd.DataFrame(columns), note)
    return table


def partial_slip_table(solved: SolvedCase) -> pd.DataFrame:
    """Print a shallow drag beside Cattaneo and Mindlin's partial slip: the only closed form with Coulomb friction."""
    gel, press = PARTIAL_SLIP.elastomer, solved.states[0]
    travel_mm = np.array([pose.shear_x_mm for pose in PARTIAL_SLIP.poses[1:]])
    limit = -gel.friction * press.force_n[2]
    contact = (limit, press.contact_radius_mm, SLIP_SHEAR_MODULUS_MPA, gel.poisson_ratio)
    measured = solved.force_n[1:, 0] / limit
    expected = theory.partial_slip_force_n(*contact, travel_mm) / limit
    table = pd.DataFrame(
        {
            "travel mm": [f"{travel:g}" for travel in travel_mm],
            "share of full slip": np.minimum(travel_mm / theory.full_slip_mm(*contact), 1.0),
            "Fx/(μ Fz)": measured,
            "theory": expected,
            "difference": measured - expected,
        }
    )
    show(
        f"Partial slip: R 3 mm, 0.1 mm deep in 10 mm, friction {gel.friction:g}, against Cattaneo–Mindlin",
        table,
        "the theory is that of a half-space, with the measured normal force and contact radius",
    )
    return table


def show_targets(presses: pd.DataFrame, drags: pd.DataFrame) -> None:
    """Print the accuracy that `standard` promises for the isochoric gel beside what was measured."""
    found = presses[(presses["quality"] == "standard") & presses["case"].str.startswith("nh")]
    standard = drags[drags["quality"] == "standard"]
    drags = drags if standard.empty else standard
    fz = np.concatenate(found["fz_percent"].to_list())
    surface = combined(found.to_dict("records"))
    rows: list[tuple] = [
        ("Fz rms, %", rms(fz), 2.0),
        ("Fz worst, %", np.abs(fz).max(), 4.0),
        (f"Fx rms ({drags['quality'].iloc[0]}), %", rms(np.concatenate(drags["fx_percent"].to_list())), 5.0),
        *zip(
            ("u_z rms, µm", "in-plane rms, µm", "surface peak, µm", "normals rms, °", "normals worst, °"),
            surface.values(),
            (5.0, 5.0, 15.0, 1.0, 4.0),
            strict=True,
        ),
        ("contact radius worst, %", found["radius worst %"].max(), 3.0),
        ("peak memory, MiB", found["MiB"].max(), 2048.0),
    ]
    rows = [(name, float(value), f"≤ {limit:g}", bool(value <= limit)) for name, value, limit in rows]
    psnr = found["PSNR dB"].min()
    rows.append(("picture PSNR, dB", psnr, "≥ 40", bool(psnr >= 40)))
    table = pd.DataFrame(rows, columns=["quantity", "measured", "target", "met"])
    show(f"Targets at standard over {len(found)} cases", table)


def frontier(presses: pd.DataFrame) -> pd.DataFrame:
    """Return the qualities as points: mean cost and error over the cases that all of them solved."""
    shared = presses[presses.groupby("case")["quality"].transform("nunique") == presses["quality"].nunique()]
    of_quality = shared.groupby("quality", sort=False)
    points = of_quality["core s/pose"].mean().rename("seconds").to_frame()
    points["error"] = of_quality["Fz rms %"].agg(rms)
    return points.rename_axis("name").reset_index().assign(series="one descent: against finite elements")


def rms(values: ArrayLike) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.square(values).mean()))


def signed(values: Sequence[float] | Floats) -> str:
    """Return numbers with one decimal and their signs."""
    return " ".join(f"{value:+.1f}" for value in values)
