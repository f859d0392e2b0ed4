"""The independent finite-element solutions in assets/reference, as arrays and as membranes."""

import csv
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gelgap.assets import asset_path

Floats = NDArray[np.float64]

FORCE_UNCERTAINTY = 0.003
SURFACE_UNCERTAINTY_MM = 0.003
SHEAR_FX_UNCERTAINTY = 0.04
SHEAR_FZ_UNCERTAINTY = 0.02
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

    def displacement_mm(self, index: int, x_mm: Floats, y_mm: Floats) -> Floats:
        """Return the surface's displacement (ny, nx, 3) on a rest grid centred on the contact."""
        r, u_r, u_z = self.profiles[index]
        x, y = np.meshgrid(x_mm, y_mm)
        radius = np.hypot(x, y)
        outward = np.interp(radius, r, u_r) / np.maximum(radius, 1e-9)
        return np.stack([outward * x, outward * y, np.interp(radius, r, u_z)], axis=-1)


@dataclass(frozen=True)
class ShearReference:
    """A drag along x at one depth: forces by sideways travel, and how far they may be off, as shares."""

    source: str
    friction: float
    fx_uncertainty: float
    fz_uncertainty: float
    poisson_ratio: float
    young_modulus_mpa: float
    depth_mm: float
    element_mm: float
    shear_mm: Floats
    fx_n: Floats
    fz_n: Floats


def _rows(*parts: str) -> list[dict[str, str]]:
    with asset_path("reference", *parts).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _friction(contact: str) -> float:
    if contact == "no slip":
        return NO_SLIP_FRICTION
    return 0.0 if contact == "frictionless" else float(contact.split()[-1])


@cache
def press_references() -> dict[str, PressReference]:
    """Return the neo-Hookean presses by name (the linear elastic ones are not a material of gelgap)."""
    rows = _rows("force_depth.csv")
    names = dict.fromkeys(row["case"] for row in rows if "neo-Hookean" in row["energy"])
    return {name: _press_reference(name, [row for row in rows if row["case"] == name]) for name in names}


def _press_reference(name: str, rows: list[dict[str, str]]) -> PressReference:
    def column(field: str) -> Floats:
        return np.array([float(row[field]) for row in rows])

    first, depths = rows[0], column("depth_mm")
    table = np.genfromtxt(asset_path("reference", "profiles", f"{name}.csv"), delimiter=",", skip_header=1)
    return PressReference(
        name=name,
        strain_energy="isochoric" if first["energy"].startswith("isochoric") else "stable-neo-hookean",
        poisson_ratio=float(first["poisson_ratio"]),
        young_modulus_mpa=float(first["young_modulus_mpa"]),
        friction=_friction(first["contact"]),
        indenter_radius_mm=float(first["indenter_radius_mm"]),
        thickness_mm=float(first["thickness_mm"]),
        depths_mm=tuple(depths),
        force_n=column("fz_n"),
        contact_radius_mm=column("contact_radius_mm"),
        contact_radius_uncertainty_mm=(column("contact_radius_high_mm") - column("contact_radius_low_mm"))
        / 2,
        profiles=tuple(table[np.isclose(table[:, 0], depth), 1:].T for depth in depths),
    )


@cache
def shear_references() -> tuple[ShearReference, ...]:
    """Return the no-slip drags on a 20×20 mm pad, the one with the smaller elements for each depth."""
    rows = [row | {"friction": str(NO_SLIP_FRICTION)} for row in _rows("shear_no_slip.csv")]
    return tuple(
        _shear_reference("table", _finest(group), SHEAR_FX_UNCERTAINTY, SHEAR_FZ_UNCERTAINTY)
        for group in _by_scene(rows)
    )


@cache
def coulomb_references() -> tuple[ShearReference, ...]:
    """Return the drags with Coulomb friction of the project's own 3-D solver (`benchmarks/drag_reference.py`).

    Their error falls with the square of the elements' size, so that the fine mesh is off by what the coarse one
    differs from it, over (ratio of sizes)² − 1.
    """
    references = []
    for group in _by_scene([row for row in _rows("drag_coulomb.csv") if row["friction"] != "inf"]):
        fine = _finest(group)
        coarse = [row for row in group if row["element_mm"] != fine[0]["element_mm"]]
        if len(coarse) == len(fine):
            ratio = float(coarse[0]["element_mm"]) / float(fine[0]["element_mm"])
            uncertainty = [
                max(
                    abs(float(c[force]) / float(f[force]) - 1)
                    for c, f in zip(coarse[1:], fine[1:], strict=True)
                )
                / (ratio**2 - 1)
                for force in ("fx_n", "fz_n")
            ]
            references.append(_shear_reference("own 3-D", fine, *uncertainty))
    return tuple(references)


def _by_scene(rows: list[dict[str, str]]) -> list[list[dict[str, str]]]:
    scenes = dict.fromkeys((row["friction"], row["depth_mm"]) for row in rows)
    return [[row for row in rows if (row["friction"], row["depth_mm"]) == scene] for scene in scenes]


def _finest(rows: list[dict[str, str]]) -> list[dict[str, str]]:
    finest = min((row["element_mm"] for row in rows), key=float)
    return [row for row in rows if row["element_mm"] == finest]


def _shear_reference(
    source: str, rows: list[dict[str, str]], fx_uncertainty: float, fz_uncertainty: float
) -> ShearReference:
    first = rows[0]
    return ShearReference(
        source=source,
        friction=float(first["friction"]),
        fx_uncertainty=fx_uncertainty,
        fz_uncertainty=fz_uncertainty,
        poisson_ratio=float(first["poisson_ratio"]),
        young_modulus_mpa=float(first["young_modulus_mpa"]),
        depth_mm=float(first["depth_mm"]),
        element_mm=float(first["element_mm"]),
        shear_mm=np.array([float(row["shear_x_mm"]) for row in rows]),
        fx_n=np.array([float(row["fx_n"]) for row in rows]),
        fz_n=np.array([float(row["fz_n"]) for row in rows]),
    )
