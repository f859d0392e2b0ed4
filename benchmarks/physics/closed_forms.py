"""Presses and a drag beside closed forms of contact theory, as an approximate check."""

from gelgap.benchmarks.common.tables import print_table
from gelgap.benchmarks.fem import theory
from gelgap.benchmarks.physics.cases import Case, Workers
from gelgap.sim import Elastomer, Pose, Sphere

SHALLOW_GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.495, friction=0.0)
SHALLOW_DEPTHS_MM = (0.05, 0.1, 0.2)

SLIP_SHEAR_MODULUS_MPA = 0.1
SLIP_GEL = Elastomer(
    young_modulus_mpa=2 * SLIP_SHEAR_MODULUS_MPA * (1 + 0.495),
    poisson_ratio=0.495,
    friction=0.3,
    thickness_mm=10.0,
    pad_size_mm=(60.0, 60.0),
)
SLIP_DEPTH_MM = 0.1
SLIP_TRAVELS_MM = (0.0, 0.01, 0.02, 0.03, 0.05, 0.08)
PARTIAL_SLIP = Case(
    "partial slip",
    SLIP_GEL,
    tuple(Pose(depth_mm=SLIP_DEPTH_MM, shear_x_mm=travel) for travel in SLIP_TRAVELS_MM),
    indenter=Sphere(diameter_mm=6.0),
)


def shallow_case(quality: str) -> Case:
    """Return shallow presses without friction."""
    return Case("shallow", SHALLOW_GEL, tuple(Pose(depth_mm=depth) for depth in SHALLOW_DEPTHS_MM), quality)


def shallow_presses(quality: str, workers: Workers) -> list[list[object]]:
    """Print shallow presses beside Hertz and the bonded layer."""
    (solved,) = workers.solve([shallow_case(quality)])
    rows: list[list[object]] = []
    for depth, state in zip(SHALLOW_DEPTHS_MM, solved.states, strict=True):
        hertz = float(theory.hertz_force_n(0.3, 0.495, 1.5, depth))
        layer = float(theory.bonded_layer_force_n(0.3, 1.5, 3.0, depth))
        force = -state.force_n[2]
        rows.append([f"{depth:g}", force, hertz, layer, 100 * (force / layer - 1)])
    print_table(
        "Closed forms: frictionless, ν 0.495",
        ["depth mm", "|Fz| N", "Hertz half-space N", "bonded layer N", "to the layer %"],
        rows,
        note="finite strain and the exact sphere put converged finite elements 1.6 % below the layer at 0.05 mm, "
        "2.4 % at 0.1 mm and 3.7 % at 0.2 mm",
    )
    return rows


def partial_slip(workers: Workers) -> list[list[object]]:
    """Print a shallow drag beside Cattaneo and Mindlin's partial slip: the only closed form with Coulomb friction."""
    (solved,) = workers.solve([PARTIAL_SLIP])
    press = solved.states[0]
    limit = -SLIP_GEL.friction * press.force_n[2]
    contact = (press.contact_radius_mm, SLIP_SHEAR_MODULUS_MPA, SLIP_GEL.poisson_ratio)
    full_slip_mm = theory.full_slip_mm(limit, *contact)
    rows: list[list[object]] = []
    for travel, state in zip(SLIP_TRAVELS_MM[1:], solved.states[1:], strict=True):
        expected = float(theory.partial_slip_force_n(limit, *contact, travel) / limit)
        measured = float(state.force_n[0] / limit)
        share = float(min(travel / full_slip_mm, 1.0))
        rows.append([f"{travel:g}", share, measured, expected, measured - expected])
    print_table(
        f"Partial slip: R 3 mm, {SLIP_DEPTH_MM:g} mm deep in 10 mm, friction {SLIP_GEL.friction:g}, "
        "against Cattaneo–Mindlin",
        ["travel mm", "share of full slip", "Fx/(μ Fz)", "theory", "difference"],
        rows,
        note="the theory is that of a half-space, with the measured normal force and contact radius",
    )
    return rows
