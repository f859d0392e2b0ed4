"""The project's own solver of presses: derivatives, tables that it has never seen, theory, invariants."""

import csv
import math

import numpy as np
import pytest

from gelgap.assets import asset_path
from gelgap.benchmarks.fem.spheres import Pad, Press, solve_press, touched
from gelgap.sim.press import bonded_layer_force_n

REFERENCE_UNCERTAINTY = 0.003
SURFACE_UNCERTAINTY_MM = 0.003


def reference_force_n(case: str, depth_mm: float) -> float:
    with asset_path("reference", "force_depth.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["case"] == case]
    return next(float(row["fz_n"]) for row in rows if math.isclose(float(row["depth_mm"]), depth_mm))


@pytest.mark.parametrize(
    ("case", "poisson_ratio", "energy", "friction"),
    [
        ("nh48_friction_0.5", 0.48, "isochoric", 0.5),
        ("nh499_no_slip", 0.499, "isochoric", math.inf),
        ("snh45_no_slip", 0.45, "stable", math.inf),
    ],
)
def test_press_reproduces_independent_finite_elements(case, poisson_ratio, energy, friction):
    problem = Press(poisson_ratio=poisson_ratio, energy=energy, friction=friction, element_mm=0.1)
    profile = np.genfromtxt(asset_path("reference", "profiles", f"{case}.csv"), delimiter=",", names=True)
    for state in solve_press(problem, (0.6,)):
        expected = reference_force_n(case, state.depth_mm)
        assert state.force_n == pytest.approx(expected, rel=REFERENCE_UNCERTAINTY)
        rows = profile[np.isclose(profile["depth_mm"], state.depth_mm) & (profile["r_mm"] <= 5)]
        u_r, u_z = state.surface_mm(rows["r_mm"])
        assert np.abs(u_z - rows["u_z_mm"]).max() < SURFACE_UNCERTAINTY_MM
        assert np.abs(u_r - rows["u_r_mm"]).max() < SURFACE_UNCERTAINTY_MM


@pytest.mark.parametrize("energy", ["isochoric", "stable"])
def test_the_stiffness_is_the_derivative_of_the_forces(energy):
    pad = Pad(Press(poisson_ratio=0.48, energy=energy, element_mm=1.0), deepest_mm=0.5)
    rng = np.random.default_rng(0)
    u = 0.02 * rng.standard_normal(pad.size)
    direction = rng.standard_normal(pad.size)
    step = 1e-6
    _, matrix = pad.assemble(u)
    change = (pad.assemble(u + step * direction)[0] - pad.assemble(u - step * direction)[0]) / (2 * step)
    assert np.abs(matrix @ direction - change).max() < 1e-7 * np.abs(change).max()
    assert np.abs((matrix - matrix.T) @ direction).max() < 1e-12 * np.abs(change).max(), (
        "forces have an energy"
    )


def test_shallow_press_meets_the_bonded_layer():
    (state,) = solve_press(Press(poisson_ratio=0.4999, friction=0.0, element_mm=0.04), (0.025,))
    expected = bonded_layer_force_n(0.3, 1.5, 3.0, 0.025)
    assert -state.force_n == pytest.approx(expected, rel=0.02)  # the exact sphere and finite strain: −1.1 %
    assert state.contact_radius_mm == pytest.approx((1.5 * 0.025) ** 0.5, rel=0.1)  # Hertz


def test_force_scales_with_the_modulus():
    soft, stiff = (
        solve_press(Press(young_modulus_mpa=e, element_mm=0.15), (0.15, 0.3)) for e in (0.01, 10.0)
    )
    for a, b in zip(soft, stiff, strict=True):
        assert b.force_n == pytest.approx(1000 * a.force_n, rel=1e-6)


def test_coulomb_friction_limits_the_shear():
    (state,) = solve_press(Press(friction=0.1, element_mm=0.15), (0.3,))
    touching = state.pressure_mpa > 0
    ratio = np.abs(state.shear_mpa[touching]) / state.pressure_mpa[touching]
    assert ratio.max() <= 0.1 * (1 + 1e-9)
    assert ratio.max() == pytest.approx(0.1)


def test_bad_input_names_the_field_and_the_range():
    with pytest.raises(ValueError, match=r"poisson_ratio = 0\.5 must be in \[0, 0\.5\)"):
        Press(poisson_ratio=0.5)
    with pytest.raises(ValueError, match="must rise"):
        solve_press(Press(), (0.4, 0.2))


def test_moduli_agree_with_each_other():
    gel = Press(young_modulus_mpa=0.3, poisson_ratio=0.45)
    mu, k = gel.shear_modulus_mpa, gel.volumetric_modulus_mpa
    assert 9 * k * mu / (3 * k + mu) == pytest.approx(0.3)


def test_contact_tangent_is_the_slope_of_sticking_and_slipping_forces():
    press = Press(friction=0.3, element_mm=0.2)
    pad = Pad(press, deepest_mm=0.5)
    rng = np.random.default_rng(1)
    rest = pad.nodes[pad.surface]
    displaced, direction = rest + 0.02 * rng.normal(size=rest.shape), rng.normal(size=rest.shape)
    from_centre = rest - [0, press.indenter_radius_mm - 0.2]
    stick = from_centre + 6 * rng.normal(size=rest.shape) * rng.uniform(size=(len(rest), 1)) ** 4

    def touch(step: float):
        return touched(press, displaced + step * direction, pad.surface_area_mm2, 0.2, stick)

    now = touch(0.0)
    pushed = now.pressure_mpa > 0
    slides = np.linalg.norm(now.shear_mpa, axis=1) > 0.299 * now.pressure_mpa
    assert 0 < (pushed & slides).sum() < pushed.sum()
    slope = (touch(1e-7).force_n - touch(-1e-7).force_n) / 2e-7
    expected = -np.einsum("nij,nj->ni", now.tangent, direction)
    assert np.abs(slope - expected).max() < 1e-5 * np.abs(expected).max()
