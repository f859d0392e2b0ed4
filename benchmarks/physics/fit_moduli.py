"""Fit `assets/fitted/moduli.toml`: the moduli with which MuJoCo's energy presses like an isochoric gel.

python -m gelgap.benchmarks.physics.fit_moduli    # ten minutes of a core: the file, and errors where nothing was fitted

Presses of both energies are solved by the axisymmetric finite elements of `axisymmetric.py`, which do not lock. For
each gel the best E′ and ν′ make force and surface of the stable energy's press agree; polynomials in 1 − 2ν are fitted
to these.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from gelgap.adapt.result_table import ResultTable
from gelgap.benchmarks.physics.axisymmetric import Press, solve_press
from gelgap.sim.scene import Moduli, equivalent_moduli

Floats = NDArray[np.float64]
Family = Callable[[float], tuple[Floats, Floats]]

GEL_POISSON_RATIOS = (0.3, 0.35, 0.4, 0.43, 0.45, 0.47, 0.48, 0.49, 0.495, 0.499)
MUJOCO_POISSON_RATIOS = (
    *(0.3, 0.33, 0.36, 0.39, 0.42, 0.44, 0.46, 0.47),
    *(0.48, 0.485, 0.49, 0.494, 0.497, 0.499, 0.4995),
)
FRICTIONS = (0.0, math.inf)
SHARES_OF_DEEPEST = (0.2, 0.4, 0.6, 0.8, 1.0)
ELEMENT_MM = 0.1
# An error of one counts as much as an error of the other.
FORCE_SCALE, SURFACE_SCALE_MM = 0.01, 0.005
CHECKS = (  # presses that the fit did not use
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
    """What a press shows, by depth: force (depths,), surface (depths, 2, radii)."""

    force_n: Floats
    surface_mm: Floats


def respond(press: Press, shares: Sequence[float] = SHARES_OF_DEEPEST) -> Response:
    """Press to shares of the scene's greatest depth; surfaces reach to 5 mm under R 1.5 mm."""
    states = solve_press(press, tuple(press.deepest_mm * share for share in shares))
    radii_mm = np.linspace(0, 5.0 * press.indenter_radius_mm / 1.5, 101)
    return Response(
        np.array([state.force_n for state in states]),
        np.array([state.surface_mm(radii_mm) for state in states]),
    )


def stable_family(friction: float, poisson_ratios: Sequence[float], element_mm: float) -> Family:
    """Return force and surface of Stable Neo-Hookean presses of one friction, interpolated over ν′ in log(1 − 2ν′)."""
    descending = sorted(poisson_ratios, reverse=True)
    presses = [
        respond(Press(poisson_ratio=nu, energy="stable", friction=friction, element_mm=element_mm))
        for nu in descending
    ]
    at = np.log(1 - 2 * np.array(descending))
    force = CubicSpline(at, np.array([press.force_n for press in presses]))
    surface = CubicSpline(at, np.array([press.surface_mm for press in presses]))
    return lambda nu: (force(np.log(1 - 2 * nu)), surface(np.log(1 - 2 * nu)))


def best_moduli(nu: float, gels: Sequence[Response], families: Sequence[Family]) -> tuple[float, float]:
    """Return (E′/E, ν′) of the stable presses that come closest to the isochoric gel's."""

    def ratio_and_mismatch(candidate: float) -> tuple[float, float]:
        forces, surfaces = zip(*(family(candidate) for family in families), strict=True)
        log_ratio = np.array([np.log(gel.force_n / force) for gel, force in zip(gels, forces, strict=True)])
        apart_mm = np.array([surface - gel.surface_mm for gel, surface in zip(gels, surfaces, strict=True)])
        mismatch = log_ratio.std() / FORCE_SCALE + np.sqrt((apart_mm**2).mean()) / SURFACE_SCALE_MM
        return float(np.exp(log_ratio.mean())), float(mismatch)

    slack = 1 - 2 * nu
    bounds = (max(MUJOCO_POISSON_RATIOS[0], nu - 0.2 * slack), nu + 0.4 * slack)
    best = minimize_scalar(
        lambda candidate: ratio_and_mismatch(candidate)[1],
        bounds=bounds,
        method="bounded",
        options={"xatol": 1e-6},
    ).x
    return ratio_and_mismatch(best)[0], float(best)


def fit(
    gel_poisson_ratios: Sequence[float] = GEL_POISSON_RATIOS,
    mujoco_poisson_ratios: Sequence[float] = MUJOCO_POISSON_RATIOS,
    frictions: Sequence[float] = FRICTIONS,
    element_mm: float = ELEMENT_MM,
) -> tuple[Floats, Floats, pd.DataFrame]:
    """Return a and b of E′/E, c and d of ν′ (see `equivalent_moduli`), and the moduli that they are fitted to."""
    families = [stable_family(friction, mujoco_poisson_ratios, element_mm) for friction in frictions]
    moduli = []
    for poisson_ratio in gel_poisson_ratios:
        gels = [
            respond(Press(poisson_ratio=poisson_ratio, friction=friction, element_mm=element_mm))
            for friction in frictions
        ]
        moduli.append(best_moduli(poisson_ratio, gels, families))
    nu = np.array(gel_poisson_ratios)
    ratio, poisson = np.array(moduli).T
    x = 1 - 2 * nu
    basis = np.stack([x, x**2], axis=-1)
    modulus_fit = np.linalg.lstsq(basis, ratio - 1, rcond=None)[0]
    poisson_fit = np.linalg.lstsq(basis / x[:, None], (poisson - nu) / x, rcond=None)[0]
    columns = {
        "ν": nu,
        "E′/E best": ratio,
        "E′/E fitted": 1 + basis @ modulus_fit,
        "ν′ best": poisson,
        "ν′ fitted": nu + basis @ poisson_fit,
    }
    return modulus_fit, poisson_fit, pd.DataFrame(columns)


def check() -> pd.DataFrame:
    """Return how close MuJoCo's energy comes with the gel's own moduli and with the equivalent ones."""
    rows = []
    for gel in CHECKS:
        truth = respond(gel)
        moved = equivalent_moduli(Moduli(gel.young_modulus_mpa, gel.poisson_ratio))
        same = replace(gel, energy="stable")
        equivalent = replace(
            same, young_modulus_mpa=moved.young_modulus_mpa, poisson_ratio=moved.poisson_ratio
        )
        for name, press in (("same", same), ("equivalent", equivalent)):
            found = respond(press)
            surface_um = 1e3 * (found.surface_mm - truth.surface_mm)
            rows.append(
                {
                    "press": str(gel),
                    "moduli": name,
                    "force %": " ".join(f"{100 * e:+.1f}" for e in found.force_n / truth.force_n - 1),
                    "surface rms, µm": float(np.sqrt((surface_um**2).mean())),
                    "peak, µm": float(np.abs(surface_um).max()),
                }
            )
    return pd.DataFrame(rows)


def main() -> None:
    """Print the fit and the check."""
    modulus, poisson, table = fit()
    ResultTable.of("Fit: R 1.5 mm on 3 mm", table).show()
    print(f"modulus = [{modulus[0]:.4f}, {modulus[1]:.4f}]\npoisson = [{poisson[0]:.4f}, {poisson[1]:.4f}]")
    ResultTable.of("Check: what the fit did not use", check()).show()


if __name__ == "__main__":
    main()
