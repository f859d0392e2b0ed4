"""`gelgap benchmark physics --what shapes`: other indenters than spheres, against finite elements.

A body of revolution has tables of forces, surfaces and torques, a long lying cylinder those of plane strain, which its
middle is in; a long box is pressed and dragged across beside a table of the project's own finite elements in plane
strain.
"""

import json
import math
import shutil
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gelgap.assets import asset_path
from gelgap.benchmarks.common import rms, show, write_json
from gelgap.benchmarks.fem.theory import hertz_contact_radius_mm
from gelgap.benchmarks.physics.accuracy import (
    SURFACE_REACH_MM,
    at_both,
    combined,
    force_errors,
    surface_errors,
)
from gelgap.benchmarks.physics.cases import Case, Floats, Solver, Truth
from gelgap.benchmarks.physics.references import (
    friction_of,
    normal,
    press_case,
    profiles,
)
from gelgap.sim import (
    AnyIndenter,
    Box,
    Cone,
    Cylinder,
    Edge,
    Elastomer,
    MembraneState,
    Pose,
    Sphere,
    Traction,
    traction_map,
)

PAD_MM = (60.0, 60.0)
# Long enough that the middle is in plane strain: its ends are further away than two thicknesses.
LONG_MM = 16.0
MIDDLE_MM = 1.0  # half of what counts as the middle
QUICK_DEPTHS = 2
COLUMNS = (
    *("case", "quality", "Fz rms %", "worst %", "Fz by pose %", "ref ± %", "u_z rms µm", "in-plane rms µm"),
    *("core s/pose", "vertices", "unconverged"),
)
ACROSS_COLUMNS = (
    *("case", "quality", "Fz by pose %", "Fz rms %", "Fx by pose %", "Fx rms %", "u_z rms µm"),
    *("in-plane rms µm", "|f_t|/μf_n − 1", "core s/pose", "unconverged"),
)
QUALITIES = ("draft", "standard")
LONG_BOX = Box(size_mm=(3.0, LONG_MM), edge_radius_mm=0.5)
TWIST_DEG = 1.0  # a small twist, in which nothing slips
TWISTED_DEPTHS = 2  # of each body
# A sphere on thick gel that turns until all of its contact slips: radius, thickness, depth, friction and twist.
FULL_SLIP = (3.0, 10.0, 0.1, 0.3, 20.0)
NOTE = "displacement within 5 mm; ref ±: the references' own; core s: a process with imports, over its poses"
TARGETS = (
    "targets at standard: round bodies 3 % rms, 6 % worst, 8 µm; "
    "lying cylinder and box 4 % rms, 10 µm, Fx 6 % rms"
)


def run(quick: bool, out_dir: Path) -> None:
    """Print errors and run time by shape, and write `shapes.json` to `out_dir`.

    The quick form has two depths of each round body at `draft`, and one twist of each; the full one all depths at
    `draft` and `standard`, the lying cylinder and the long box.
    """
    started = time.perf_counter()
    solver = Solver(1, out_dir / "shape-solves")
    rounds, lying = round_cases(), lying_case()
    if quick:
        shallow = [case.down_to(case.poses[QUICK_DEPTHS - 1].depth_mm) for case in rounds]
        cases = [replace(case, quality="draft") for case in shallow]
    else:
        cases = at_both([*rounds, lying])
    solved = solver.cases(cases)
    table = pd.DataFrame([row(case, solved[case]) for case in cases])
    show("Indenters against independent finite elements", table[list(COLUMNS)], f"{NOTE}; {TARGETS}")
    results: dict[str, Any] = {"shapes": table}
    twists = twist_cases(1, ["draft"]) if quick else twist_cases(TWISTED_DEPTHS, QUALITIES)
    twisted = solver.cases(twists)
    results["twist"] = pd.DataFrame([twist_row(case, twisted[case], *own) for case, own in twists.items()])
    note = "torque per degree without slip beside the tables; in full slip beside Hertz's 3π/16 μ P a"
    show("Twists of a pressed indenter", results["twist"], note)
    if not quick:
        across = solver.cases(at_both(across_cases()))
        results["across"] = pd.DataFrame(row(*pair) for pair in across.items())[list(ACROSS_COLUMNS)]
        note = f"per mm of length, beside plane strain by elements of 0.12 mm; {TARGETS}"
        show("A long box in its middle, pressed and dragged across", results["across"], note)
    write_json(out_dir / "shapes.json", results | {"quick": quick, "wall_s": time.perf_counter() - started})
    shutil.rmtree(solver.folder, ignore_errors=True)
    print(f"{time.perf_counter() - started:.0f} s in all; results in {out_dir / 'shapes.json'}")


@cache
def _tables() -> pd.DataFrame:
    return pd.read_csv(asset_path("reference", "shapes", "forces.csv"))


def round_cases() -> tuple[Case, ...]:
    """Return the presses of bodies of revolution that have a table."""
    cases = []
    for name, own in _tables().groupby("case", sort=False):
        given = json.loads(own["shape_params"].iloc[0])
        match own["shape"].iloc[0]:
            case "Flat":
                body = Cylinder(diameter_mm=2 * given["R"], edge_radius_mm=given["f"])
            case "Cone":
                half_angle_deg = round(90 - np.degrees(given["b"]), 9)
                body = Cone(diameter_mm=6.0, half_angle_deg=half_angle_deg, tip_radius_mm=given["rho"])
            case _:
                continue
        cases.append(_case(name, body, own))
    return tuple(cases)


def lying_case() -> Case:
    """Return the press of a long lying cylinder, whose middle is in plane strain."""
    own = _tables()[_tables()["kind"].str.startswith("plane strain")]
    radius_mm = json.loads(own["shape_params"].iloc[0])["R"]
    body = Edge(diameter_mm=2 * radius_mm, length_mm=LONG_MM, edge_radius_mm=0.5)
    case = _case(own["case"].iloc[0], body, own)
    # The table has one side of the cylinder.
    sides = tuple(
        np.hstack([[[-1], [-1], [1]] * profile[:, :0:-1], profile]) for profile in case.truth.profiles
    )
    return replace(case, truth=replace(case.truth, profiles=sides))


def across_cases() -> tuple[Case, ...]:
    """Return a long box that is pressed and dragged across, with what plane strain has per mm of its length."""
    forces, surfaces = (
        pd.read_csv(asset_path("reference", "shapes", f"box_across_{kind}.csv")).groupby(
            "contact", sort=False
        )
        for kind in ("forces", "profiles")
    )
    cases = []
    for (contact, own), (_, surface) in zip(forces, surfaces, strict=True):
        gel = Elastomer(
            young_modulus_mpa=0.3, poisson_ratio=0.48, friction=friction_of(contact), pad_size_mm=PAD_MM
        )
        at_poses = surface.groupby(["depth_mm", "travel_mm"])[["x_rest_mm", "u_x_mm", "u_z_mm"]]
        truth = Truth(
            force_n=own.assign(fy=np.nan)[["fx_n_per_mm", "fy", "fz_n_per_mm"]].to_numpy(),
            profiles=tuple(rows.to_numpy().T for _, rows in at_poses),
        )
        poses = tuple(Pose(depth_mm=p.depth_mm, shear_x_mm=p.travel_mm) for p in own.itertuples())
        cases.append(Case("across", contact, gel, poses, indenter=LONG_BOX, truth=truth))
    return tuple(cases)


def _case(name: str, body: AnyIndenter, own: pd.DataFrame) -> Case:
    first = own.iloc[0]
    truth = Truth(
        force_n=normal(-own["F_fine"]),
        fx_uncertainty=float(own["unc_pct"].max()),
        profiles=profiles(own["depth_mm"], "shapes", f"{name}_profile.csv"),
    )
    gel = {
        "young_modulus_mpa": first["E_MPa"],
        "poisson_ratio": first["nu"],
        "thickness_mm": first["h_mm"],
        "friction": friction_of(first["contact"]),
        "pad_size_mm": PAD_MM,
    }
    return press_case("shapes", name, own["depth_mm"], body, truth, **gel)


def row(case: Case, solved: Any) -> dict[str, Any]:
    """Compare what `Solver.cases` returns for a case with its table; of a long body the middle is compared."""
    states, truth = solved.states, case.truth
    if isinstance(case.indenter, Edge | Box):
        along = int(isinstance(case.indenter, Box))
        maps = [traction_map(case.plan, k, solved.solution, state) for k, state in enumerate(states)]
        force_n = np.array([middle_force_n(found, along) for found in maps])
        surfaces = [middle_errors(*pair, along) for pair in zip(states, truth.profiles, strict=True)]
    else:
        force_n = np.array([state.force_n for state in states])
        expected = [truth.displacement_mm(index, s.x_mm, s.y_mm) for index, s in enumerate(states)]
        radii = [state.contact_radius_mm for state in states]
        surfaces = [combined(map(surface_errors, states, expected, radii))]
    found = force_errors(case, solved, force_n)
    return found | {
        "worst %": float(np.abs(found["fz_percent"]).max()),
        "ref ± %": truth.fx_uncertainty,
        **{name: rms([one[name] for one in surfaces]) for name in ("u_z rms µm", "in-plane rms µm")},
        "vertices": len(solved.solution.rest_mm),
    }


def middle_force_n(found: Traction, along: int = 0) -> Floats:
    """Return the force (3,) per mm of length on the middle of a body that lies along x or y (0, 1)."""
    place_mm = (found.state.x_mm, found.state.y_mm)[along]
    middle = np.abs(place_mm) < MIDDLE_MM + 1e-9
    per_slice = np.compress(middle, found.cell_force_n, axis=1 - along).sum(axis=along)
    return per_slice.mean(axis=0) / (place_mm[1] - place_mm[0])


def middle_errors(state: MembraneState, profile: Floats, along: int = 0) -> dict[str, float]:
    """Compare the membrane in the middle of a body that lies along x or y with a profile (place, aside, u_z)."""
    across_mm, along_mm = (state.y_mm, state.x_mm)[:: 1 - 2 * along]
    found = np.take(state.displacement_mm, np.abs(along_mm).argmin(), axis=1 - along).astype(float)
    near = np.abs(across_mm) <= SURFACE_REACH_MM
    place, found, (at, u_aside, u_z) = across_mm[near], found[near], profile
    aside, down = np.interp(place, at, u_aside), np.interp(place, at, u_z)
    return {
        "u_z rms µm": 1e3 * rms(found[:, 2] - down),
        "in-plane rms µm": 1e3 * rms(np.hypot(found[:, 1 - along] - aside, found[:, along])),
    }


def twist_cases(depths: int, qualities: Sequence[str]) -> dict[Case, tuple[float, float]]:
    """Return small twists with their torques by the tables and how far these may be off, %, and a twist to full slip.

    Some of the depths of each body without slip have a table; in full slip Hertz's 3π/16 μ P a takes its place.
    """
    rows = pd.read_csv(asset_path("reference", "shapes", "torque.csv"))
    radius_mm, thickness_mm, depth_mm, friction, twist_deg = FULL_SLIP
    gel = {
        "young_modulus_mpa": 0.3,
        "poisson_ratio": 0.48,
        "friction": friction,
        "thickness_mm": thickness_mm,
    }
    thick = Elastomer(**gel, pad_size_mm=(9 * thickness_mm, 9 * thickness_mm))
    expected = {}
    for quality in qualities:
        for case in round_cases():
            for row in rows[rows["case"] == case.name].iloc[::-2][:depths].itertuples():
                pose, name = Pose(depth_mm=row.depth_mm), f"{case.name}, {row.depth_mm:g} mm"
                poses = (pose, replace(pose, twist_deg=TWIST_DEG))
                twist = replace(case, study="twists", name=name, poses=poses, quality=quality)
                expected[twist] = row.T_per_deg_best_Nmm * TWIST_DEG, row.unc_pct
        pose, ball = Pose(depth_mm=depth_mm), Sphere(diameter_mm=2 * radius_mm)
        poses = (pose, replace(pose, twist_deg=twist_deg))
        expected[Case("twists", "sphere, full slip", thick, poses, quality, ball)] = math.nan, math.nan
    return expected


def twist_row(case: Case, solved: Any, expected_n_mm: float, uncertain: float) -> dict[str, Any]:
    """Compare the torque of a twist with what is expected, which in full slip follows from the press."""
    pressed, twisted = solved.states
    torque_n_mm, force_n = float(twisted.torque_n_mm[2]), -float(pressed.force_n[2])
    if math.isnan(expected_n_mm):
        radius_mm = float(hertz_contact_radius_mm(case.indenter.radius_mm, case.poses[0].depth_mm))
        expected_n_mm = 3 * math.pi / 16 * case.elastomer.friction * force_n * radius_mm
    return {
        "case": case.name,
        "quality": case.quality,
        "torque, N mm": torque_n_mm,
        "expected": expected_n_mm,
        "error %": 100 * (torque_n_mm / expected_n_mm - 1),
        "ref ± %": uncertain,
        "force sideways / Fz": float(np.linalg.norm(twisted.force_n[:2]) / force_n),
        "sticks": twisted.diagnostics.sticking_fraction,
        "core s/pose": solved.core_s / 2,
        "unconverged": sum(not state.converged for state in solved.states),
    }
