"""Load steps: what they end on must not depend on how many of them there were; extrapolation of their iterations."""

from dataclasses import replace

import numpy as np
import pytest

from gelgap.sim import newton
from gelgap.sim.indenter import Sphere
from gelgap.sim.newton import GeometricSeries, solve
from gelgap.sim.problem import ContactProblem
from gelgap.sim.scene import Elastomer, Scene, Sharing
from gelgap.sim.solution import Solution

pytestmark = pytest.mark.numerical

NO_SLIP = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.45, friction=10)


def _pressed(step_mm: float) -> Solution:
    problem = ContactProblem.of(Scene(NO_SLIP, Sphere(), "draft", Sharing()), None, ((0, 0, -0.8),), (-1,))
    return solve(replace(problem, quality=replace(problem.quality, press_step_mm=step_mm)))


def test_vertices_that_land_within_a_load_step_hardly_depend_on_its_size() -> None:
    """Without slip a vertex stays where it lands; held from the step's end on, the first press would be 11 µm off."""
    solutions = [_pressed(step_mm) for step_mm in (0.2, 0.05)]
    coarse, fine = (solution.records[0] for solution in solutions)
    near = np.hypot(*solutions[0].rest_mm.T) < 5
    apart_um = 1e3 * (coarse.displacement_mm - fine.displacement_mm)[near, :2]
    assert np.sqrt((apart_um**2).sum(axis=1).mean()) < 7
    assert abs(coarse.force_n[2] / fine.force_n[2] - 1) < 0.013


def test_a_load_step_that_does_not_settle_is_taken_in_halves(monkeypatch: pytest.MonkeyPatch) -> None:
    gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=0.8)
    way = ((0, 0, -0.4), (0.2, 0, -0.4))
    problem = ContactProblem.of(Scene(gel, Sphere(), "draft", Sharing()), None, way, (-1, 0))
    in_half_steps = replace(problem.quality, press_step_mm=0.1, travel_step_mm=0.05)
    expected = solve(replace(problem, quality=in_half_steps)).records[-1].force_n
    monkeypatch.setattr(newton, "_ITERATIONS_PER_STEP", 2)
    dragged = solve(problem).records[-1]
    assert dragged.converged
    np.testing.assert_allclose(dragged.force_n, expected, rtol=2e-3, atol=1e-6)


DOFS = np.arange(3)
FAR = 1e3


def remainders(ratio: float, number: int = 4) -> list[float]:
    series, step = GeometricSeries(), np.array([1.0, -2.0, 0.5])
    return [series.remainder(step * ratio**k, DOFS, FAR) for k in range(number)]


def test_third_step_gives_the_series_remainder_and_the_next_starts_anew() -> None:
    assert remainders(0.6) == [0.0, 0.0, pytest.approx(0.6 / 0.4), 0.0]


@pytest.mark.parametrize("ratio", [0.1, -0.6])
def test_fast_and_alternating_series_are_left_alone(ratio: float) -> None:
    assert remainders(ratio) == [0.0] * 4


@pytest.mark.parametrize("ratio", [0.97, 1.2])
def test_series_without_an_end_in_sight_go_as_far_as_allowed(ratio: float) -> None:
    assert remainders(ratio)[2] * 2.0 * ratio**2 == pytest.approx(FAR)


def test_only_the_given_dofs_decide() -> None:
    series = GeometricSeries()
    for step in ([1.0, 0.0, 5.0], [1.0, 0.0, -9.0]):
        series.remainder(np.array(step), np.array([0, 1]), FAR)
    assert series.remainder(np.array([0.5, 0.0, 20.0]), np.array([0, 1]), FAR) == pytest.approx(1.0)


def test_dofs_that_do_not_move_start_no_series() -> None:
    """Where all touching nodes stick, an extrapolation of their rounding errors once moved the gel by kilometres."""
    series = GeometricSeries()
    found = [
        series.remainder(np.array([1e-17, 0.0, ratio]), np.array([0]), 1e-2) for ratio in (1.0, 0.5, 0.2)
    ]
    assert found == [0.0, 0.0, 0.0]


def test_nothing_is_moved_further_than_is_allowed() -> None:
    series = GeometricSeries()
    step = np.array([0.2, 0.0, 5.0])
    assert [series.remainder(step, np.array([0]), 1e-2) for _ in range(3)][2] * 5.0 == pytest.approx(1e-2)


def test_steps_that_turn_are_no_series() -> None:
    series = GeometricSeries()
    for step in ([1.0, 0.0, 0.0], [1.0, 0.0, 0.0]):
        series.remainder(np.array(step), DOFS, FAR)
    assert series.remainder(np.array([0.5, 0.5, 0.0]), DOFS, FAR) == 0.0


def test_later_extrapolations_ask_for_longer_series() -> None:
    assert np.flatnonzero(remainders(0.9, 28)).tolist() == [2, 5, 8, 12, 18, 26]
