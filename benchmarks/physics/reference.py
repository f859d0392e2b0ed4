"""The independent finite-element solutions in assets/reference, as arrays and as membranes."""

import csv
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gelgap.assets import asset_path

Floats = NDArray[np.float64]
Rows = list[dict[str, str]]

FORCE_UNCERTAINTY = 0.003
DRAG_FX_UNCERTAINTY = 0.04
NO_SLIP_FRICTION = 10.0  # more than any contact of a sphere can use up


@dataclass(frozen=True)
class PressReference:
    """An axisymmetric press: arrays over depths; `profiles` holds (r, u_r, u_z) of the surface for each depth."""

    name: str
    strain_energy: Literal["isochoric", "stable-neo-hookean"]
    poisson_ratio: float
    young_modulus_mpa: float
    friction: float
    indenter_radius_mm: float
    thickness_mm: float
    depths_mm: tuple[float, ...]
    force_n: Floats
    contact_radius_mm: Floats
    contact_radius_uncertainty_mm: Floats
    profiles: tuple[Floats, ...]

    def down_to(self, depth_mm: float) -> "PressReference":
        """Return the part of the press that is no deeper."""
        kept = slice(int(np.searchsorted(self.depths_mm, depth_mm, side="right")))
        names = ("depths_mm", "force_n", "contact_radius_mm", "contact_radius_uncertainty_mm", "profiles")
        return replace(self, **{name: getattr(self, name)[kept] for name in names})

    def displacement_mm(self, index: int, x_mm: Floats, y_mm: Floats) -> Floats:
        """Return the surface's displacement (ny, nx, 3) on a rest grid centred on the contact."""
        r, u_r, u_z = self.profiles[index]
        x, y = np.meshgrid(x_mm, y_mm)
        radius = np.hypot(x, y)
        outward = np.interp(radius, r, u_r) / np.maximum(radius, 1e-9)
        return np.stack([outward * x, outward * y, np.interp(radius, r, u_z)], axis=-1)


@dataclass(frozen=True)
class DragReference:
    """A drag along x at one depth: forces by travel, and how far Fx may be off, as a share."""

    source: str
    friction: float
    fx_uncertainty: float
    poisson_ratio: float
    young_modulus_mpa: float
    depth_mm: float
    element_mm: float
    travel_mm: Floats
    fx_n: Floats
    fz_n: Floats


@cache
def press_references() -> dict[str, PressReference]:
    """Return the neo-Hookean presses by name (the linear elastic ones are not a material of gelgap)."""
    rows = _rows("force_depth.csv")
    names = dict.fromkeys(row["case"] for row in rows if "neo-Hookean" in row["energy"])
    return {name: _press_reference(name, [row for row in rows if row["case"] == name]) for name in names}


@cache
def no_slip_drags() -> tuple[DragReference, ...]:
    """Return the drags without slip on a 20×20 mm pad, the one with the smallest elements for each depth."""
    rows = [row | {"friction": str(NO_SLIP_FRICTION)} for row in _rows("shear_no_slip.csv")]
    return tuple(_drag_reference("table", meshes[0], DRAG_FX_UNCERTAINTY) for meshes in _drags(rows))


@cache
def coulomb_drags() -> tuple[DragReference, ...]:
    """Return the drags with Coulomb friction of the project's own 3-D solver (`calibration/drag_reference.py`).

    Their error falls with the square of the elements' size, so that the fine mesh is off by what the coarse one
    differs from it, over (ratio of sizes)² − 1.
    """
    references = []
    for fine, *coarser in _drags([row for row in _rows("drag_coulomb.csv") if row["friction"] != "inf"]):
        if coarser and len(coarser[0]) == len(fine):
            ratio = _column(coarser[0], "element_mm")[0] / _column(fine, "element_mm")[0]
            apart = np.abs(_column(coarser[0], "fx_n")[1:] / _column(fine, "fx_n")[1:] - 1).max()
            references.append(_drag_reference("own 3-D", fine, float(apart / (ratio**2 - 1))))
    return tuple(references)


def _rows(name: str) -> Rows:
    with asset_path("reference", name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _column(rows: Rows, field: str) -> Floats:
    return np.array([float(row[field]) for row in rows])


def _drags(rows: Rows) -> list[list[Rows]]:
    """Return the rows of each drag by the mesh that they were solved on, the finest mesh first."""
    drags: dict[tuple[str, str], dict[str, Rows]] = {}
    for row in sorted(rows, key=lambda row: float(row["element_mm"])):
        meshes = drags.setdefault((row["friction"], row["depth_mm"]), {})
        meshes.setdefault(row["element_mm"], []).append(row)
    order = dict.fromkeys((row["friction"], row["depth_mm"]) for row in rows)
    return [list(drags[drag].values()) for drag in order]


def _press_reference(name: str, rows: Rows) -> PressReference:
    first, depths = rows[0], _column(rows, "depth_mm")
    contact = first["contact"]
    profiles = np.genfromtxt(asset_path("reference", "profiles", f"{name}.csv"), delimiter=",", skip_header=1)
    radius_range = _column(rows, "contact_radius_high_mm") - _column(rows, "contact_radius_low_mm")
    frictions = {"no slip": NO_SLIP_FRICTION, "frictionless": 0.0}
    return PressReference(
        name=name,
        strain_energy="isochoric" if first["energy"].startswith("isochoric") else "stable-neo-hookean",
        poisson_ratio=float(first["poisson_ratio"]),
        young_modulus_mpa=float(first["young_modulus_mpa"]),
        friction=frictions[contact] if contact in frictions else float(contact.split()[-1]),
        indenter_radius_mm=float(first["indenter_radius_mm"]),
        thickness_mm=float(first["thickness_mm"]),
        depths_mm=tuple(depths),
        force_n=_column(rows, "fz_n"),
        contact_radius_mm=_column(rows, "contact_radius_mm"),
        contact_radius_uncertainty_mm=radius_range / 2,
        profiles=tuple(profiles[np.isclose(profiles[:, 0], depth), 1:].T for depth in depths),
    )


def _drag_reference(source: str, rows: Rows, fx_uncertainty: float) -> DragReference:
    numbers = ("friction", "poisson_ratio", "young_modulus_mpa", "depth_mm", "element_mm")
    return DragReference(
        source=source,
        fx_uncertainty=fx_uncertainty,
        travel_mm=_column(rows, "shear_x_mm"),
        fx_n=_column(rows, "fx_n"),
        fz_n=_column(rows, "fz_n"),
        **{name: float(rows[0][name]) for name in numbers},
    )
