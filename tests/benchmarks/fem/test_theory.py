"""The closed forms against each other and against the limits that they must reach."""

import numpy as np
import pytest

from gelgap.benchmarks.fem import theory


def test_hertz_force_of_a_hand_computed_case():
    # 4/3 · 0.3/(1−0.25) · √1.5 · 0.1^1.5
    assert theory.hertz_force_n(0.3, 0.5, 1.5, 0.1) == pytest.approx(0.0206559, rel=1e-5)


def test_bonded_layer_tends_to_hertz_on_a_thick_pad():
    hertz = theory.hertz_force_n(0.3, 0.5, 1.5, 0.1)
    assert theory.bonded_layer_force_n(0.3, 1.5, 1e5, 0.1) == pytest.approx(hertz, rel=1e-4)
    assert theory.bonded_layer_force_n(0.3, 1.5, 3.0, 0.1) > hertz


def test_closed_forms_scale_with_the_modulus_and_broadcast():
    depth_mm = np.array([0.1, 0.2])
    soft, stiff = (theory.bonded_layer_force_n(e, 1.5, 3.0, depth_mm) for e in (0.2, 0.8))
    np.testing.assert_allclose(stiff, 4 * soft)


def test_partial_slip_has_mindlins_stiffness_and_coulombs_limit():
    e, nu, r, d, mu = 0.3, 0.48, 1.5, 0.05, 0.4
    small_mm = 1e-6
    stiffness = theory.partial_slip_force_n(e, nu, r, d, mu, small_mm) / small_mm
    expected = 8 * theory.hertz_contact_radius_mm(r, d) * theory.shear_modulus_mpa(e, nu) / (2 - nu)
    assert stiffness == pytest.approx(expected, rel=1e-3)
    limit = mu * theory.hertz_force_n(e, nu, r, d)
    assert theory.partial_slip_force_n(e, nu, r, d, mu, 1.0) == pytest.approx(limit)


def test_moduli_agree_with_each_other():
    e, nu = 0.3, 0.45
    mu, k = theory.shear_modulus_mpa(e, nu), theory.bulk_modulus_mpa(e, nu)
    assert 9 * k * mu / (3 * k + mu) == pytest.approx(e)
