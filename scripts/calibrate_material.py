"""Derive the equivalent material from locking-free presses of both energies, and check it elsewhere.

python scripts/calibrate_material.py    # ten minutes: the coefficients of `equivalent_moduli`, the errors without them
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from gelgap.benchmarks.common import show
from gelgap.benchmarks.fem.spheres import Press, solve_press
from gelgap.sim.scene import Moduli, equivalent_moduli

Floats = NDArray[np.float64]

GEL_POISSON_RATIOS = (0.3, 0.35, 0.4, 0.43, 0.45, 0.47, 0.48, 0.49, 0.495, 0.499)
SOFT_POISSON_RATIOS = (0.3, 0.33, 0.36, 0.39, 0.42, 0.44, 0.46, 0.47)
MUJOCO_POISSON_RATIOS = (*SOFT_POISSON_RATIOS, 0.48, 0.485, 0.49, 0.494, 0.497, 0.499, 0.4995)
FRICTIONS = (0.0, math.inf)
SHARES_OF_DEEPEST = (0.2, 0.4, 0.6, 0.8, 1.0)
# An error of one counts as much as an error of the other.
FORCE_SCALE, SURFACE_SCALE_MM = 0.01, 0.005
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


def respond(
    press: Press, shares: Sequence[float] = SHARES_OF_DEEPEST, nodes_per_step: float = 0.5
) -> Response:
    """Press to shares of the scene's greatest depth; surfaces reach to 5 mm under R 1.5 mm."""
    states = solve_press(press, tuple(press.deepest_mm * share for share in shares), nodes_per_step)
    radii_mm = np.linspace(0, 5.0 * press.indenter_radius_mm / 1.5, 101)
    return Response(
        np.array([state.force_n for state in states]),
        np.array([state.surface_mm(radii_mm) for state in states]),
        np.array([state.volume_change_mm3 for state in states]),
    )


def compare(stable: Response, gel: Response) -> dict[str, float | Floats]:
    """Return how far a Stable Neo-Hookean press is from the isochoric one; its volume at the deepest."""
    surface_um = 1e3 * (stable.surface_mm - gel.surface_mm)
    return {
        "force %": 100 * (stable.force_n / gel.force_n - 1),
        "surface rms, µm": float(np.sqrt((surface_um**2).mean())),
        "peak, µm": float(np.abs(surface_um).max()),
        "volume change, mm³": float(stable.volume_change_mm3[-1] - gel.volume_change_mm3[-1]),
    }


def stable_family(friction: float) -> Callable[[float], tuple[Floats, Floats]]:
    """Return force and surface of Stable Neo-Hookean presses of one friction, interpolated over ν′ in log(1 − 2ν′)."""
    descending = sorted(MUJOCO_POISSON_RATIOS, reverse=True)
    presses = [
        respond(Press(poisson_ratio=nu, energy="stable", friction=friction, element_mm=0.1))
        for nu in descending
    ]
    at = np.log(1 - 2 * np.array(descending))
    force = CubicSpline(at, np.array([press.force_n for press in presses]))
    surface = CubicSpline(at, np.array([press.surface_mm for press in presses]))
    return lambda nu: (force(np.log(1 - 2 * nu)), surface(np.log(1 - 2 * nu)))


def best_moduli(nu: float, gels: Sequence[Response], families: Sequence[Callable]) -> tuple[float, float]:
    """Return (E′/E, ν′) of the stable presses that come closest to the isochoric gel's."""

    def mismatch(candidate: float) -> tuple[float, float]:
        pressed = [family(candidate) for family in families]
        pairs = list(zip(gels, pressed, strict=True))
        log_ratio = np.array([np.log(gel.force_n / force) for gel, (force, _) in pairs])
        surface = np.array([surface - gel.surface_mm for gel, (_, surface) in pairs])
        return (
            np.exp(log_ratio.mean()),
            log_ratio.std() / FORCE_SCALE + np.sqrt((surface**2).mean()) / SURFACE_SCALE_MM,
        )

    slack = 1 - 2 * nu
    bounds = (max(MUJOCO_POISSON_RATIOS[0], nu - 0.2 * slack), nu + 0.4 * slack)
    best = minimize_scalar(
        lambda nu: mismatch(nu)[1], bounds=bounds, method="bounded", options={"xatol": 1e-6}
    ).x
    return mismatch(best)[0], best


def fit() -> None:
    """Fit E′/E and ν′ over ν, and print them."""
    families = [stable_family(friction) for friction in FRICTIONS]
    moduli = []
    for nu in GEL_POISSON_RATIOS:
        gels = [respond(Press(poisson_ratio=nu, friction=mu, element_mm=0.1)) for mu in FRICTIONS]
        moduli.append(best_moduli(nu, gels, families))
    nu, (ratio, poisson) = np.array(GEL_POISSON_RATIOS), np.array(moduli).T
    x = 1 - 2 * nu
    basis = np.stack([x, x**2], axis=-1)
    a = np.linalg.lstsq(basis, ratio - 1, rcond=None)[0]
    b = np.linalg.lstsq(basis / x[:, None], (poisson - nu) / x, rcond=None)[0]
    columns = {
        "E′/E best": ratio,
        "E′/E fitted": 1 + basis @ a,
        "ν′ best": poisson,
        "ν′ fitted": nu + basis @ b,
    }
    show("Calibration: R 1.5 mm on 3 mm", pd.DataFrame({"ν": nu, **columns}))
    print(f"MODULUS_COEFFICIENTS = ({a[0]:.4f}, {a[1]:.4f})\nPOISSON_COEFFICIENTS = ({b[0]:.4f}, {b[1]:.4f})")


def check() -> None:
    """Print how close MuJoCo's energy comes with the gel's own moduli and with the equivalent ones."""
    rows = []
    for gel in CHECKS:
        truth, moved = respond(gel), equivalent_moduli(Moduli(gel.young_modulus_mpa, gel.poisson_ratio))
        same = replace(gel, energy="stable")
        moduli = {"young_modulus_mpa": moved.young_modulus_mpa, "poisson_ratio": moved.poisson_ratio}
        for name, press in (("same", same), ("equivalent", replace(same, **moduli))):
            found = compare(respond(press), truth)
            found["force %"] = " ".join(f"{error:+.1f}" for error in found["force %"])
            rows.append({"press": str(gel), "moduli": name, **found})
    show("Check: what the calibration did not use", pd.DataFrame(rows))


if __name__ == "__main__":
    fit()
    check()
