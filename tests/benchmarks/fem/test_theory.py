"""The closed forms against each other and against the limits that they must reach."""

import numpy as np
import pytest

from gelgap.benchmarks.fem import theory
from gelgap.sim import bonded_layer_force_n


def test_hertz_force_of_a_hand_computed_case():
    # 4/3 · 0.3/(1−0.25) · √1.5 · 0.1^1.5
    assert theory.hertz_force_n(0.3, 0.5, 1.5, 0.1) == pytest.approx(0.0206559, rel=1e-5)


def test_bonded_layer_tends_to_hertz_on_a_thick_pad():
    hertz = theory.hertz_force_n(0.3, 0.5, 1.5, 0.1)
    assert bonded_layer_force_n(0.3, 1.5, 1e5, 0.1) == pytest.approx(hertz, rel=1e-4)
    assert bonded_layer_force_n(0.3, 1.5, 3.0, 0.1) > hertz


def test_closed_forms_scale_with_the_modulus_and_broadcast():
    depth_mm = np.array([0.1, 0.2])
    soft, stiff = (bonded_layer_force_n(e, 1.5, 3.0, depth_mm) for e in (0.2, 0.8))
    np.testing.assert_allclose(stiff, 4 * soft)
