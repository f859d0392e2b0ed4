"""The equivalent material on a press that its calibration did not use."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelgap.benchmarks.calibration.material import describe, material_errors
from gelgap.benchmarks.fem.axisymmetric import Press, solve_press
from gelgap.sim.equivalent_material import equivalent_material


def test_equivalent_material_brings_mujocos_energy_to_the_isochoric_gel():
    gel = Press(
        poisson_ratio=0.46, friction=math.inf, indenter_radius_mm=2.0, thickness_mm=4.0, element_mm=0.2
    )
    modulus, poisson_ratio = equivalent_material(gel.young_modulus_mpa, gel.poisson_ratio)

    def errors(problem: Press):
        pressed = (describe(solve_press(p, (0.6, 1.2), nodes_per_step=1.0), 6.0) for p in (problem, gel))
        return material_errors(*pressed)

    same = errors(replace(gel, energy="stable"))
    moved = errors(
        replace(gel, energy="stable", young_modulus_mpa=modulus, poisson_ratio=poisson_ratio),
    )
    assert np.abs(same.force_percent).max() > 3
    assert np.abs(moved.force_percent).max() < 2
    assert moved.surface_rms_um < same.surface_rms_um


@given(st.floats(0.0, 0.4999), st.floats(1e-3, 100))
def test_equivalent_material_is_a_material_and_scales_with_the_modulus(poisson_ratio, modulus_mpa):
    moved, poisson = equivalent_material(modulus_mpa, poisson_ratio)
    assert modulus_mpa <= moved <= 1.1 * modulus_mpa
    assert abs(poisson - poisson_ratio) < 0.006
    assert 0 <= poisson < 0.5
    assert moved / modulus_mpa == pytest.approx(equivalent_material(1.0, poisson_ratio)[0])


def test_equivalent_material_tends_to_the_identity():
    modulus, poisson = equivalent_material(0.3, 0.49999)
    assert modulus == pytest.approx(0.3, rel=1e-5)
    assert poisson == pytest.approx(0.49999, abs=1e-6)


@pytest.mark.parametrize(("modulus", "poisson"), [(0.0, 0.4), (0.3, 0.5), (0.3, -0.1), (math.nan, 0.4)])
def test_bad_moduli_are_refused(modulus, poisson):
    with pytest.raises(ValueError, match="must be"):
        equivalent_material(modulus, poisson)
