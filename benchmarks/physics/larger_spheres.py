"""Spheres larger than those that meshes are calibrated with: an outside table, and presses of the project's solver."""

import csv
import json
import math
from dataclasses import replace

import numpy as np

from gelgap.assets import asset_path
from gelgap.benchmarks.fem.axisymmetric import Press
from gelgap.benchmarks.physics.cases import Workers
from gelgap.benchmarks.physics.presses import solved_reference
from gelgap.benchmarks.physics.reference import NO_SLIP_FRICTION, PressReference

TABLED = "d_sph_R4_h3_nu49_stick"
LESS_DEEP_MM = 0.6
OWN = tuple(  # a pad must reach so far beyond the contact that its rim does not matter
    (replace(Press.scaled(*scene), pad_radius_mm=scene[0] + 3.5 * scene[1], element_mm=scene[1] / 20), depths)
    for scene, depths in (
        ((4.0, 3.0, 0.49, 0.0), (0.2, 0.55, 0.9)),
        ((6.0, 2.0, 0.48, math.inf), (0.15, 0.375, 0.6)),
        ((6.0, 2.0, 0.48, 0.0), (0.15, 0.375, 0.6)),
        ((6.0, 4.0, 0.49, 0.3), (0.3, 0.75, 1.2)),
        ((6.0, 4.0, 0.49, 0.3), (0.33, 0.67, 1.0, 1.33)),
        ((6.0, 3.0, 0.45, math.inf), (0.2, 0.55, 0.9)),
        ((10.0, 4.0, 0.49, math.inf), (0.1, 0.25, 0.4)),
        ((10.0, 4.0, 0.49, math.inf), (0.1, 0.65, 1.2)),
    )
)
"""The project's own presses, and to which depths, mm: those of docs/physics.md."""


def sphere_references(workers: Workers) -> list[PressReference]:
    """Return the references of all rows of the table of larger spheres in docs/physics.md, in its order."""
    table = tabled_sphere()
    less_deep = replace(table.down_to(LESS_DEEP_MM), name=f"{table.name} to {LESS_DEEP_MM:g} mm")
    return [table, less_deep, *workers.map(_own_reference, OWN)]


def _own_reference(scene: tuple[Press, tuple[float, ...]]) -> PressReference:
    press, depths_mm = scene
    return replace(solved_reference(press, depths_mm), name=f"{press} to {depths_mm[-1]:g} mm")


def tabled_sphere() -> PressReference:
    """Return the table of a sphere of 8 mm diameter on 3 mm of gel, in assets/reference/spheres."""
    with asset_path("reference", "spheres", "forces.csv").open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["case"] == TABLED]
    profiles = np.genfromtxt(
        asset_path("reference", "spheres", f"{TABLED}_profile.csv"), delimiter=",", skip_header=1
    )
    depths_mm = [float(row["depth_mm"]) for row in rows]
    # The true radius lies between the last node that touches and the next, one element further out.
    element_mm = float(rows[0]["element_mm_fine"])
    return PressReference(
        name=TABLED,
        strain_energy="isochoric",
        poisson_ratio=float(rows[0]["nu"]),
        young_modulus_mpa=float(rows[0]["E_MPa"]),
        friction=NO_SLIP_FRICTION,
        indenter_radius_mm=json.loads(rows[0]["shape_params"])["R"],
        thickness_mm=float(rows[0]["h_mm"]),
        depths_mm=tuple(depths_mm),
        force_n=-np.array([float(row["F_fine"]) for row in rows]),
        contact_radius_mm=np.array([float(row["contact_radius_now_mm"]) for row in rows]) + element_mm / 2,
        contact_radius_uncertainty_mm=np.full(len(rows), element_mm / 2),
        profiles=tuple(profiles[np.isclose(profiles[:, 0], depth), 1:].T for depth in depths_mm),
    )
