"""How far solved cases are from the truth: forces, contact radii, membranes, normals and pictures."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gelgap.benchmarks.common import rms
from gelgap.benchmarks.physics.cases import Case, Floats, Truth, solved_cases
from gelgap.render.imaging import psnr_db
from gelgap.sim import Box, Edge, MembraneState
from gelgap.sim.traction import Traction

Picture = Callable[[MembraneState], np.ndarray]
"""Renders a membrane."""

SURFACE_REACH_MM = 5.0
NORMALS_REACH_MM = 3.0  # from the contact
MIDDLE_MM = 1.0  # half of what counts as the middle of a long body
SURFACE = ("u_z rms µm", "in-plane rms µm", "peak µm", "normals rms °", "worst °")


def measured(cases: Sequence[Case], folder: Path, picture: Picture | None = None) -> pd.DataFrame:
    """Solve cases and return a row of errors a case; of the presses' pictures, too."""
    solved = solved_cases(cases, folder)
    rows = [errors(case, solved[case], picture if case.study == "presses" else None) for case in cases]
    return pd.DataFrame(rows)


def errors(case: Case, solved: Any, picture: Picture | None = None) -> dict[str, Any]:
    """Compare what `solved_cases` returns for a case with its truth: a row of the table.

    Of a long body the middle is compared, which is in plane strain; its forces are per mm of length. Presses have
    errors of the membrane, and with a `picture` maker of their pictures; drags those of Fx.
    """
    truth, states = case.truth, solved.states
    force_n, surfaces = np.array([state.force_n for state in states]), []
    if isinstance(case.indenter, Edge | Box) and len(truth.profiles[0]) == 3:
        along = int(isinstance(case.indenter, Box))  # axis x or y
        force_n = np.array([middle_force_n(state.traction(), along) for state in states])
        surfaces = [middle_errors(*pair, along) for pair in zip(states, truth.profiles, strict=True)]
    elif truth.profiles:
        right = [truth.state(index, state) for index, state in enumerate(states)]
        surfaces = list(map(surface_errors, states, right))
    row = {
        "study": case.study,
        "reference": truth.source,
        "case": case.name,
        "quality": case.quality,
        **force_errors(truth, force_n, np.array([pose.radius_mm > 0 for pose in case.poses])),
        "ref ± %": truth.uncertainty_percent,
        "|f_t|/μf_n − 1": max(state.diagnostics.coulomb_excess for state in states),
        "core s/pose": solved.core_s / len(states),
        "MiB": solved.peak_mib,
        "vertices": sum(map(len, solved.solution.rest_mm)),
        "unconverged": sum(not state.converged for state in states),
        **combined(surfaces),
    }
    if len(truth.radius_mm):
        radius = np.array([state.contact_radius_mm for state in states]) / truth.radius_mm
        row["radius worst %"] = float(np.abs(100 * (radius - 1)).max())
    if picture is not None:
        row["PSNR dB"] = min(psnr_db(*map(picture, pair)) for pair in zip(states, right, strict=True))
    return row


def force_errors(truth: Truth, force_n: Floats, dragged: np.ndarray) -> dict[str, Any]:
    """Compare forces (poses, 3) with the truth, Fx where the indenter is dragged."""
    fz = 100 * (force_n[:, 2] / truth.force_n[:, 2] - 1)
    row = {
        "Fz rms %": rms(fz),
        "Fz worst %": float(np.abs(fz).max()),
        "Fz by pose %": signed(fz),
        "fz_percent": fz.tolist(),
    }
    if dragged.any():
        fx = 100 * (force_n[dragged, 0] / truth.force_n[dragged, 0] - 1)
        row |= {
            "Fx rms %": rms(fx),
            "Fx by pose %": signed(fx),
            "fx_percent": fx.tolist(),
            "Fx/|Fz|": -force_n[-1, 0] / force_n[-1, 2],
            "reference's": -truth.force_n[-1, 0] / truth.force_n[-1, 2],
        }
    return row


def surface_errors(state: MembraneState, right: MembraneState) -> dict[str, float]:
    """Compare a membrane with the true one on the same rest grid, centred on the contact."""
    radius = np.hypot(*np.meshgrid(state.x_mm, state.y_mm))
    error = 1e3 * (state.displacement_mm - right.displacement_mm)[radius <= SURFACE_REACH_MM]
    in_plane = np.hypot(error[:, 0], error[:, 1])
    angle = np.degrees(np.arccos(np.clip((normals(state) * normals(right)).sum(-1), -1, 1)))
    angle = angle[radius <= right.contact_radius_mm + NORMALS_REACH_MM]
    peak = float(max(np.abs(error[:, 2]).max(), in_plane.max()))
    values = rms(error[:, 2]), rms(in_plane), peak, rms(angle), float(angle.max())
    return dict(zip(SURFACE, values, strict=True))


def normals(state: MembraneState) -> Floats:
    """Return unit normals (ny, nx, 3) of the deformed membrane by central differences, pointing to +z at rest."""
    along_y, along_x = np.gradient(state.places_mm, state.y_mm, state.x_mm, axis=(0, 1))
    normal = np.cross(along_x, along_y)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


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


def combined(surfaces: Iterable[dict[str, float]]) -> dict[str, float]:
    """Return the root mean squares of the rms errors and the largest of the peaks."""
    table = pd.DataFrame(surfaces)
    return {name: rms(table[name]) if "rms" in name else float(table[name].max()) for name in table}


def signed(values: Sequence[float] | Floats) -> str:
    """Return numbers with one decimal and their signs."""
    return " ".join(f"{value:+.1f}" for value in values)
