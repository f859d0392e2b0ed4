"""Load steps: what they end on must not depend on how many of them there were."""

from dataclasses import replace

import numpy as np
import pytest

from gelgap.sim import newton
from gelgap.sim.elastomer import Elastomer
from gelgap.sim.indenters.sphere import Sphere
from gelgap.sim.newton import solve
from gelgap.sim.scene import Scene, Sharing
from gelgap.sim.solution import Solution

NO_SLIP = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.45, friction=10)


def _pressed(step_mm: float) -> Solution:
    problem = Scene(NO_SLIP, Sphere(), "draft", Sharing()).problem(None, ((0, 0, -0.8),), (-1,))
    return solve(replace(problem, quality=replace(problem.quality, press_step_mm=step_mm)))


def test_vertices_that_land_within_a_load_step_hardly_depend_on_its_size() -> None:
    """Without slip a vertex stays where it lands; held from the step's end on, the first press would be 11 µm off."""
    solutions = [_pressed(step_mm) for step_mm in (0.2, 0.05)]
    coarse, fine = (solution.records[0] for solution in solutions)
    near = np.hypot(*solutions[0].rest_mm.T) < 5
    apart_um = 1e3 * (coarse.displacement_mm - fine.displacement_mm)[near, :2]
    assert np.sqrt((apart_um**2).sum(axis=1).mean()) < 7
    assert abs(coarse.force_n[2] / fine.force_n[2] - 1) < 0.01


def test_a_load_step_that_does_not_settle_is_taken_in_halves(monkeypatch: pytest.MonkeyPatch) -> None:
    gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=0.8)
    way = ((0, 0, -0.4), (0.2, 0, -0.4))
    problem = Scene(gel, Sphere(), "draft", Sharing()).problem(None, way, (-1, 0))
    in_half_steps = replace(problem.quality, press_step_mm=0.1, travel_step_mm=0.05)
    expected = solve(replace(problem, quality=in_half_steps)).records[-1].force_n
    monkeypatch.setattr(newton, "THRESHOLDS", replace(newton.THRESHOLDS, iterations_per_step=2))
    dragged = solve(problem).records[-1]
    assert dragged.converged
    np.testing.assert_allclose(dragged.force_n, expected, rtol=2e-3, atol=1e-6)
