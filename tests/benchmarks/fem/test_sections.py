"""Long bodies in plane strain: an independent table, Coulomb's bound, and what a cylinder and a box have in common."""

import math

import numpy as np
import pandas as pd
import pytest

from gelgap.assets import asset_path
from gelgap.benchmarks.fem.sections import Section, section_of_strip, solve_section


def test_a_lying_cylinder_presses_as_independent_finite_elements_say() -> None:
    rows = pd.read_csv(asset_path("reference", "shapes", "forces.csv"))
    rows = rows[rows["kind"].str.startswith("plane strain")]
    expected = float(rows[np.isclose(rows["depth_mm"], 0.4)]["F_fine"].iloc[0])
    (found,) = solve_section(Section(0.0, 1.5, math.inf, element_mm=0.2), ((0.0, 0.4),), step_mm=0.05)
    assert -found.force_n_per_mm[1] == pytest.approx(expected, rel=0.04)
    assert found.force_n_per_mm[0] == pytest.approx(0, abs=1e-9)
    x, _, down = found.surface_mm
    assert down[np.abs(x).argmin()] == pytest.approx(-0.4, abs=2e-3)


def test_a_box_that_slides_drags_as_much_as_coulomb_allows() -> None:
    problem = Section(1.0, 0.5, 0.1, furthest_mm=0.3, element_mm=0.35)
    pressed, slid = solve_section(problem, ((0.0, 0.2), (0.3, 0.2)), step_mm=0.1)
    across, down = slid.force_n_per_mm
    assert -pressed.force_n_per_mm[1] > 0.03
    # On elements this coarse the flanks in front and behind do not quite carry what they should.
    assert across / -down == pytest.approx(0.1, rel=0.25)


def test_a_strip_is_as_thick_and_wide_as_it_is() -> None:
    pad = section_of_strip(Section(1.0, 0.5, 0.0, element_mm=0.3))
    assert pad.volume.sum() == pytest.approx(24.0 * 3.0 * 0.2)
    assert pad.surface_area_mm2.sum() == pytest.approx(24.0 * 0.2)
