"""Derive the equivalent material from locking-free presses of both energies, and check it elsewhere.

`python -m gelgap.benchmarks.calibration.material` takes some ten minutes on one core and prints the coefficients
that `sim/material.py` holds, and the errors with and without them where they were not fitted.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from gelgap.benchmarks.common.tables import print_table
from gelgap.benchmarks.fem.axisymmetric import Press, PressState, solve_press
from gelgap.sim.scene import Moduli, equivalent_moduli

Floats = NDArray[np.float64]

GEL_POISSON_RATIOS = (0.3, 0.35, 0.4, 0.43, 0.45, 0.47, 0.48, 0.49, 0.495, 0.499)
SOFT_POISSON_RATIOS = (0.3, 0.33, 0.36, 0.39, 0.42, 0.44, 0.46, 0.47)
MUJOCO_POISSON_RATIOS = (*SOFT_POISSON_RATIOS, 0.48, 0.485, 0.49, 0.494, 0.497, 0.499, 0.4995)
FRICTIONS = (0.0, math.inf)
SHARES_OF_DEEPEST = (0.2, 0.4, 0.6, 0.8, 1.0)
# An error of one counts as much as an error of the other.
FORCE_SCALE = 0.01
SURFACE_SCALE_MM = 0.005
CHECKS = (  # presses that the calibration did not use
    Press.scaled(1.0, 3.0, 0.46, math.inf),
    Press.scaled(3.0, 3.0, 0.46, 0.3),
    Press.scaled(1.5, 5.0, 0.475, 0.0),
    Press.scaled(2.0, 2.0, 0.485, 0.5),
    Press.scaled(4.0, 4.0, 0.44, math.inf),
    Press.scaled(1.0, 1.5, 0.37, 0.3),
    Press.scaled(2.5, 6.0, 0.4975, math.inf),
)


@dataclass(frozen=True)
class Response:
    """What a press shows, by depth: force, volume change (depths,), surface (depths, 2, radii)."""

    force_n: Floats
    surface_mm: Floats
    volume_change_mm3: Floats


@dataclass(frozen=True)
class MaterialErrors:
    """How far a Stable Neo-Hookean press is from the isochoric one; the volume change's error is at the deepest."""

    force_percent: Floats
    surface_rms_um: float
    surface_peak_um: float
    volume_change_mm3: float


def respond(press: Press) -> Response:
    """Press as deep as the scene allows, and describe it by depth."""
    states = solve_press(press, tuple(press.deepest_mm * share for share in SHARES_OF_DEEPEST))
    return describe(states, 5.0 * press.indenter_radius_mm / 1.5)


def describe(states: tuple[PressState, ...], furthest_mm: float) -> Response:
    """Collect forces, volume changes and surfaces up to a material radius."""
    radii = np.linspace(0, furthest_mm, 101)
    return Response(
        np.array([state.force_n for state in states]),
        np.array([state.surface_mm(radii) for state in states]),
        np.array([state.volume_change_mm3 for state in states]),
    )


class StableFamily:
    """Stable Neo-Hookean presses of one friction, interpolated over ν′ in log(1 − 2ν′)."""

    def __init__(self, friction: float) -> None:
        order = np.log(1 - 2 * np.array(MUJOCO_POISSON_RATIOS))[::-1]
        presses = [
            respond(Press(poisson_ratio=nu, energy="stable", friction=friction, element_mm=0.1))
            for nu in reversed(MUJOCO_POISSON_RATIOS)
        ]
        self._force = CubicSpline(order, np.array([press.force_n for press in presses]))
        self._surface = CubicSpline(order, np.array([press.surface_mm for press in presses]))

    def __call__(self, poisson_ratio: float) -> tuple[Floats, Floats]:
        at = np.log(1 - 2 * poisson_ratio)
        return self._force(at), self._surface(at)


def best_moduli(
    poisson_ratio: float, gels: list[Response], families: list[StableFamily]
) -> tuple[float, float]:
    """Return (E′/E, ν′) of the stable presses that come closest to the isochoric gel's."""

    def compare(candidate: float) -> tuple[float, float]:
        pressed = [family(candidate) for family in families]
        log_ratio = np.array(
            [np.log(gel.force_n / force) for gel, (force, _) in zip(gels, pressed, strict=True)]
        )
        surface = np.array([u - gel.surface_mm for gel, (_, u) in zip(gels, pressed, strict=True)])
        modulus = np.exp(log_ratio.mean())
        return modulus, log_ratio.std() / FORCE_SCALE + np.sqrt((surface**2).mean()) / SURFACE_SCALE_MM

    slack = 1 - 2 * poisson_ratio
    bounds = (max(MUJOCO_POISSON_RATIOS[0], poisson_ratio - 0.2 * slack), poisson_ratio + 0.4 * slack)
    best = minimize_scalar(
        lambda nu: compare(nu)[1], bounds=bounds, method="bounded", options={"xatol": 1e-6}
    )
    return compare(best.x)[0], best.x


def fit() -> None:
    """Fit E′/E and ν′ over ν, and print them."""
    families = [StableFamily(friction) for friction in FRICTIONS]
    moduli = []
    for nu in GEL_POISSON_RATIOS:
        gels = [respond(Press(poisson_ratio=nu, friction=mu, element_mm=0.1)) for mu in FRICTIONS]
        moduli.append(best_moduli(nu, gels, families))
    x = 1 - 2 * np.array(GEL_POISSON_RATIOS)
    ratio, poisson = np.array(moduli).T
    basis = np.stack([x, x**2], axis=-1)
    modulus_fit = np.linalg.lstsq(basis, ratio - 1, rcond=None)[0]
    poisson_fit = np.linalg.lstsq(basis / x[:, None], (poisson - GEL_POISSON_RATIOS) / x, rcond=None)[0]
    rows = [
        [nu, best[0], 1 + b @ modulus_fit, best[1], nu + b @ poisson_fit]
        for nu, best, b in zip(GEL_POISSON_RATIOS, moduli, basis, strict=True)
    ]
    print_table(
        "Calibration: R 1.5 mm on 3 mm", ["ν", "E′/E best", "E′/E fitted", "ν′ best", "ν′ fitted"], rows
    )
    print(f"MODULUS_COEFFICIENTS = ({modulus_fit[0]:.4f}, {modulus_fit[1]:.4f})")
    print(f"POISSON_COEFFICIENTS = ({poisson_fit[0]:.4f}, {poisson_fit[1]:.4f})")


def material_errors(stable: Response, gel: Response) -> MaterialErrors:
    """Compare two presses depth by depth."""
    surface = 1e3 * (stable.surface_mm - gel.surface_mm)
    return MaterialErrors(
        100 * (stable.force_n / gel.force_n - 1),
        float(np.sqrt((surface**2).mean())),
        float(np.abs(surface).max()),
        float(stable.volume_change_mm3[-1] - gel.volume_change_mm3[-1]),
    )


def check() -> None:
    """Print how close MuJoCo's energy comes with the gel's own moduli and with the equivalent ones."""
    rows = []
    for gel in CHECKS:
        truth = respond(gel)
        equivalent = equivalent_moduli(Moduli(gel.young_modulus_mpa, gel.poisson_ratio))
        same = replace(gel, energy="stable")
        moved = replace(
            same,
            young_modulus_mpa=equivalent.young_modulus_mpa,
            poisson_ratio=equivalent.poisson_ratio,
        )
        for moduli, press in (("same", same), ("equivalent", moved)):
            found = material_errors(respond(press), truth)
            force = " ".join(f"{error:+.1f}" for error in found.force_percent)
            surface = (found.surface_rms_um, found.surface_peak_um)
            rows.append([str(gel), moduli, force, *surface, found.volume_change_mm3])
    columns = ["press", "moduli", "Fz error by depth, %", "surface rms, µm", "peak, µm", "volume change, mm³"]
    print_table("Check: what the calibration did not use", columns, rows)


if __name__ == "__main__":
    fit()
    check()
