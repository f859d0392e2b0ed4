"""Cases with a true solution: the finite elements in assets/reference."""

import json
import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from gelgap.assets import asset_path
from gelgap.benchmarks.physics.cases import Case, Floats, Truth
from gelgap.sim import Box, Cone, Cylinder, Edge, Elastomer, Pose, Sphere, Surface
from gelgap.sim.shapes import AnyIndenter

FORCE_UNCERTAINTY_PERCENT = 0.3
DRAG_UNCERTAINTY_PERCENT = 4.0  # of Fx
RADIUS_UNCERTAINTY_PERCENT = 0.5  # elements of 0.0125 mm differ by less
# A contact's end is extrapolated from this many gaps beside it; a smaller gap than this is penetration.
SMALLEST_GAP_MM, GAPS = 5e-4, 4
NO_SLIP_FRICTION = 10.0  # more than any contact of a sphere can use up
TABLED_SPHERE = "d_sph_R4_h3_nu49_stick"
WIDE_PAD_MM = (60.0, 60.0)
# Long enough that the middle is in plane strain: its ends are further away than two thicknesses.
LONG_MM = 16.0
# Of heights, as finely as they are kept; all of a ring's half height can be pressed in.
FINEST_MM = 0.04
RING_HEIGHT_MM = 0.6


@cache
def press_cases() -> dict[str, Case]:
    """Return the neo-Hookean presses of the tables by name (the linear elastic ones are not a material of gelgap)."""
    rows = pd.read_csv(asset_path("reference", "force_depth.csv"))
    rows = rows[rows["energy"].str.contains("neo-Hookean")]
    isochoric = rows["energy"].str.startswith("isochoric")
    energy = np.where(isochoric, "isochoric", "stable-neo-hookean")
    return tabled_cases("presses", of_spheres(rows, energy), "profiles/{}.csv")


def tabled_sphere() -> Case:
    """Return the press of a sphere of 8 mm diameter on 3 mm of gel."""
    rows = second_model("spheres/forces.csv").query("case == @TABLED_SPHERE")
    rows = rows.assign(off_percent=RADIUS_UNCERTAINTY_PERCENT)
    return tabled_cases("presses", rows, "spheres/{}_profile.csv")[TABLED_SPHERE]


def held_back_cases() -> dict[str, Case]:
    """Return presses of spheres that no other table and no calibration has."""
    rows = pd.read_csv(asset_path("reference", "spheres", "held_back.csv"))
    return tabled_cases("held back", of_spheres(rows, "isochoric"), "spheres/{}_profile.csv")


def of_spheres(rows: pd.DataFrame, strain_energy: Any) -> pd.DataFrame:
    """Return presses with their spheres and what their tables do not state."""
    body = [Sphere(diameter_mm=2 * radius_mm) for radius_mm in rows["indenter_radius_mm"]]
    return rows.assign(body=body, strain_energy=strain_energy, off_percent=RADIUS_UNCERTAINTY_PERCENT)


def shape_cases() -> tuple[Case, ...]:
    """Return the presses of bodies of revolution, and last that of a long lying cylinder."""
    cases = tabled_cases(
        "shapes", second_model("shapes/forces.csv"), "shapes/{}_profile.csv", pad_size_mm=WIDE_PAD_MM
    )
    *round_bodies, lying = cases.values()
    # The table has one side of the cylinder.
    sides = tuple(np.hstack([[[-1], [-1], [1]] * own[:, :0:-1], own]) for own in lying.known.profiles)
    return *round_bodies, replace(lying, truth=replace(lying.known, profiles=sides))


def second_model(place: str) -> pd.DataFrame:
    """Return a table of presses by the second finite-element model, in the names and signs of the first one's."""
    rows = pd.read_csv(asset_path("reference", *place.split("/")))
    names = {
        "nu": "poisson_ratio",
        "E_MPa": "young_modulus_mpa",
        "h_mm": "thickness_mm",
        "unc_pct": "off_percent",
    }
    return rows.rename(columns=names).assign(
        body=list(map(body_of, rows.itertuples())),
        strain_energy="isochoric",
        fz_n=-rows["F_fine"],
    )


def body_of(row: Any) -> AnyIndenter:
    """Return the indenter of a row of the second model; its sphere in plane strain is a long lying cylinder."""
    size = json.loads(row.shape_params)
    match row.shape, row.kind:
        case "Flat", _:
            return Cylinder(diameter_mm=2 * size["R"], edge_radius_mm=size["f"])
        case "Cone", _:
            half_angle_deg = round(90 - math.degrees(size["b"]), 9)
            return Cone(diameter_mm=6.0, half_angle_deg=half_angle_deg, tip_radius_mm=size["rho"])
        case _, "plane strain (N/mm)":
            return Edge(diameter_mm=2 * size["R"], length_mm=LONG_MM, edge_radius_mm=0.5)
    return Sphere(diameter_mm=2 * size["R"])


def tabled_cases(study: str, rows: pd.DataFrame, profiles: str, **gel: Any) -> dict[str, Case]:
    """Return the presses of a table by name, with the surfaces in files of assets/reference that are named alike."""
    cases: dict[str, Case] = {}
    for name, own in rows.groupby("case", sort=False):
        first, place = own.iloc[0], asset_path("reference", *profiles.format(name).split("/"))
        surface = np.genfromtxt(place, delimiter=",", skip_header=1)
        surfaces = tuple(surface[np.isclose(surface[:, 0], depth), 1:].T for depth in own["depth_mm"])
        radius_mm = np.array(list(map(rim_mm, own["body"], own["depth_mm"], surfaces)))
        truth = Truth(normal(own["fz_n"]), "table", own["off_percent"].max(), radius_mm, surfaces)
        material = first[["young_modulus_mpa", "poisson_ratio", "thickness_mm", "strain_energy"]]
        elastomer = Elastomer(**material, **gel, friction=friction_of(first["contact"]))
        poses = tuple(map(Pose, own["depth_mm"]))
        cases[str(name)] = Case(study, str(name), elastomer, poses, indenter=first["body"], truth=truth)
    return cases


def rim_mm(body: AnyIndenter, depth_mm: float, profile: Floats) -> float:
    """Return the deformed radius at which a profile (r, u_r, u_z) leaves a body: the gap goes as (r − a)^1.5."""
    r_mm, u_r_mm, u_z_mm = profile
    places_mm = np.stack([0 * r_mm, r_mm + u_r_mm, u_z_mm + depth_mm - body.origin_height_mm], axis=-1)
    gap_mm = body.project(places_mm).distance_mm
    beside = np.flatnonzero((gap_mm > SMALLEST_GAP_MM) & (r_mm > 0))[:GAPS]
    slope, offset = np.polyfit(places_mm[beside, 1], gap_mm[beside] ** (2 / 3), 1)
    return float(-offset / slope)


def across_cases() -> tuple[Case, ...]:
    """Return a long box that is pressed and dragged across, with what plane strain has per mm of its length."""
    forces, surfaces = (
        pd.read_csv(asset_path("reference", "shapes", f"box_across_{kind}.csv"))
        for kind in ("forces", "profiles")
    )
    box, cases = Box(size_mm=(3.0, LONG_MM), edge_radius_mm=0.5), []
    for contact, own in forces.groupby("contact", sort=False):
        gel = Elastomer(
            young_modulus_mpa=0.3, poisson_ratio=0.48, friction=friction_of(contact), pad_size_mm=WIDE_PAD_MM
        )
        surface = surfaces[surfaces["contact"] == contact].groupby(["depth_mm", "travel_mm"])
        truth = Truth(
            force_n=own.assign(fy=np.nan)[["fx_n_per_mm", "fy", "fz_n_per_mm"]].to_numpy(),
            profiles=tuple(rows.to_numpy().T for _, rows in surface[["x_rest_mm", "u_x_mm", "u_z_mm"]]),
        )
        poses = tuple(Pose(depth_mm=p.depth_mm, shear_x_mm=p.travel_mm) for p in own.itertuples())
        cases.append(Case("across", contact, gel, poses, indenter=box, truth=truth))
    return tuple(cases)


def solid_cases() -> tuple[Case, ...]:
    """Return a short box that is pressed and an upright cylinder that is dragged, beside felupe's solids.

    Each was solved on two meshes; forces of the second are the truth, and uncertain by what they differ from the first.
    Surfaces are those of elements of 0.05 mm.
    """
    forces, surfaces = (
        pd.read_csv(asset_path("reference", "shapes", f"solid_{kind}.csv")) for kind in ("forces", "surfaces")
    )
    # The tables have a quarter of the box and half of the cylinder; across a plane of symmetry u turns with its place.
    bodies = {
        "box": (Box(size_mm=(3.0, 2.0), edge_radius_mm=0.4), ((1, 1), (1, -1), (-1, 1), (-1, -1))),
        "cylinder": (Cylinder(diameter_mm=3.0, edge_radius_mm=0.3), ((1, 1), (1, -1))),
    }
    gel = Elastomer(
        young_modulus_mpa=0.3, poisson_ratio=0.48, friction=NO_SLIP_FRICTION, pad_size_mm=WIDE_PAD_MM
    )
    cases = []
    for name, (body, mirrors) in bodies.items():
        coarse, fine = (mesh for _, mesh in forces[forces["case"] == name].groupby("element_mm", sort=False))
        surface = surfaces[surfaces["case"] == name].groupby(["depth_mm", "travel_mm"])
        parts = [rows[list(rows)[3:]].to_numpy() for _, rows in surface]
        truth = Truth(
            force_n=fine.assign(fy=np.nan)[["fx_n", "fy", "fz_n"]].to_numpy(),
            uncertainty_percent=100 * float(np.abs(coarse["fz_n"].values / fine["fz_n"].values - 1).max()),
            profiles=tuple(np.vstack([part * [x, y, x, y, 1] for x, y in mirrors]).T for part in parts),
        )
        poses = tuple(Pose(depth_mm=p.depth_mm, shear_x_mm=p.travel_mm) for p in fine.itertuples())
        cases.append(Case("solids", name, gel, poses, indenter=body, truth=truth))
    return tuple(cases)


def surface_cases() -> tuple[Case, ...]:
    """Return a torus and a ring-shaped flat punch, pressed by their surface, beside felupe's axisymmetric solutions.

    Each was solved on two meshes; the second is the truth, and uncertain by what it differs from the first.
    """
    forces, profiles = (
        pd.read_csv(asset_path("reference", "shapes", f"surface_{kind}.csv"))
        for kind in ("forces", "profiles")
    )
    bodies = {"torus": rounded_ring(1.4, 2.6, 0.6), "ring": rounded_ring(1.0, 2.0, 0.2)}
    cases = []
    for (name, contact), own in forces.groupby(["case", "contact"], sort=False):
        coarse, fine = (mesh for _, mesh in own.groupby("element_mm", sort=False))
        surface = profiles[(profiles["case"] == name) & (profiles["contact"] == contact)].groupby("depth_mm")
        truth = Truth(
            normal(fine["fz_n"]),
            uncertainty_percent=100 * float(np.abs(coarse["fz_n"].values / fine["fz_n"].values - 1).max()),
            radius_mm=fine["outer_radius_mm"].to_numpy(),
            profiles=tuple(rows[["r_mm", "u_r_mm", "u_z_mm"]].to_numpy().T for _, rows in surface),
        )
        gel = Elastomer(
            young_modulus_mpa=0.3, poisson_ratio=0.48, friction=friction_of(contact), pad_size_mm=WIDE_PAD_MM
        )
        poses = tuple(map(Pose, fine["depth_mm"]))
        cases.append(Case("surfaces", f"{name}, {contact}", gel, poses, indenter=bodies[name], truth=truth))
    return tuple(cases)


def rounded_ring(inner_mm: float, outer_mm: float, edge_mm: float) -> Surface:
    """Return a ring between two radii whose edges are rounded: a torus, if they are half as wide as the ring."""
    place = np.arange(-math.ceil(outer_mm / FINEST_MM), math.ceil(outer_mm / FINEST_MM) + 1) * FINEST_MM
    off_middle_mm = np.abs(np.hypot(*np.meshgrid(place, place)) - (inner_mm + outer_mm) / 2)
    over_mm = np.maximum(off_middle_mm - (outer_mm - inner_mm) / 2 + edge_mm, 0.0)
    heights_mm = edge_mm - np.sqrt(np.maximum(edge_mm**2 - over_mm**2, 0.0))
    return Surface.of(
        np.where(over_mm <= edge_mm, heights_mm, np.inf), FINEST_MM, height_mm=2 * RING_HEIGHT_MM
    )


@cache
def drag_cases() -> tuple[Case, ...]:
    """Return drags along x: without slip from a table of others, then with Coulomb friction from one of the project's.

    Of the first, on a pad of 20×20 mm, the ones with the smallest elements. The second has an error that falls with the
    square of the elements' size, so that the fine mesh is off by what the coarse one differs from it, over (ratio of
    sizes)² − 1.
    """
    table = pd.read_csv(asset_path("reference", "shear_no_slip.csv")).assign(friction=NO_SLIP_FRICTION)
    own = pd.read_csv(asset_path("reference", "drag_coulomb.csv"))
    cases = []
    for source, rows in (("table", table), ("own 3-D", own[np.isfinite(own["friction"])])):
        for (friction, depth_mm), drag in rows.groupby(["friction", "depth_mm"], sort=False):
            fine, *coarser = [mesh for _, mesh in drag.groupby("element_mm")]
            uncertainty_percent = DRAG_UNCERTAINTY_PERCENT
            if source != "table":
                if not coarser or len(coarser[0]) != len(fine):
                    continue
                ratio = coarser[0]["element_mm"].iloc[0] / fine["element_mm"].iloc[0]
                apart = np.abs(coarser[0]["fx_n"].to_numpy()[1:] / fine["fx_n"].to_numpy()[1:] - 1).max()
                uncertainty_percent = 100 * float(apart / (ratio**2 - 1))
            gel = fine.iloc[0][["young_modulus_mpa", "poisson_ratio", "friction"]]
            poses = tuple(Pose(depth_mm=depth_mm, shear_x_mm=float(x)) for x in fine["shear_x_mm"])
            force_n = np.stack([fine["fx_n"], np.full(len(fine), np.nan), fine["fz_n"]], axis=-1)
            name = f"{depth_mm:g} mm, friction {friction:g}"
            elastomer = Elastomer(pad_size_mm=(20.0, 20.0), **gel)
            cases.append(
                Case("drags", name, elastomer, poses, truth=Truth(force_n, source, uncertainty_percent))
            )
    return tuple(cases)


def friction_of(contact: str) -> float:
    """Return the friction that a table's words for a contact mean, such as "friction 0.5"."""
    known = {"no slip": NO_SLIP_FRICTION, "stick": NO_SLIP_FRICTION, "frictionless": 0.0, "slip": 0.0}
    return known[contact] if contact in known else float(contact.split()[-1])


def normal(fz_n: pd.Series | Floats) -> Floats:
    """Return forces (k, 3) that have no other component than Fz."""
    return np.outer(fz_n, [0.0, 0.0, 1.0])
