"""Load steps: what they end on must not depend on how many of them there were; extrapolation of their iterations."""

from dataclasses import replace

import numpy as np
import pytest

from gelgap.sim import newton
from gelgap.sim.indenter import Sphere
from gelgap.sim.newton import AndersonAcceleration, solve
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
    near = np.hypot(*solutions[0].rest_mm[0].T) < 5
    apart_um = 1e3 * (coarse.displacement_mm - fine.displacement_mm)[near, :2]
    assert np.sqrt((apart_um**2).sum(axis=1).mean()) < 7
    assert abs(coarse.force_n[2] / fine.force_n[2] - 1) < 0.013


def test_a_load_step_that_does_not_settle_is_taken_in_halves(monkeypatch: pytest.MonkeyPatch) -> None:
    gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=0.8)
    way = ((0, 0, -0.4), (0.2, 0, -0.4))
    problem = ContactProblem.of(Scene(gel, Sphere(), "draft", Sharing()), None, way, (-1, 0))
    in_half_steps = replace(problem.quality, press_step_mm=0.1, travel_step_mm=0.05)
    expected = solve(replace(problem, quality=in_half_steps)).records[-1].force_n
    load_step = newton.StaticNewton.load_step

    def unsettled_where_long(
        self: newton.StaticNewton, command: np.ndarray, *limit: int, **how: bool
    ) -> object:
        length_mm = np.abs(command - self.command).max()
        converged, ran_away = load_step(self, command, *limit, **how)
        return converged and length_mm < 0.11, ran_away

    monkeypatch.setattr(newton.StaticNewton, "load_step", unsettled_where_long)
    dragged = solve(problem).records[-1]
    assert dragged.converged
    np.testing.assert_allclose(dragged.force_n, expected, rtol=2e-3, atol=1e-6)


def test_a_way_that_takes_too_long_ends_in_its_last_equilibrium(monkeypatch: pytest.MonkeyPatch) -> None:
    way = ((0, 0, -0.1), (0, 0, -0.5), (0.1, 0, -0.5))
    problem = ContactProblem.of(Scene(NO_SLIP, Sphere(), "draft", Sharing()), None, way, (-1, 0, 1))
    whole = solve(problem).records
    first, second = (record.diagnostics.iterations for record in whole[:2])
    monkeypatch.setattr(newton, "most_iterations", lambda _: first + 2 * second // 3)
    reached, ended, after = solve(problem).records
    assert reached.converged
    np.testing.assert_array_equal(reached.force_n, whole[0].force_n)
    assert not ended.converged
    assert not after.converged
    assert -0.5 < ended.indenter_mm[2] <= -0.1
    assert whole[1].force_n[2] < ended.force_n[2] < 0.9 * whole[0].force_n[2]
    assert ended.diagnostics.residual < 1e-3
    assert after.diagnostics.iterations <= 2
    np.testing.assert_allclose(after.force_n, ended.force_n, rtol=1e-3, atol=1e-6)


def test_a_way_ends_at_the_load_step_that_inverts_an_element(monkeypatch: pytest.MonkeyPatch) -> None:
    way = ((0, 0, -0.6), (0.1, 0, -0.6))
    problem = ContactProblem.of(Scene(NO_SLIP, Sphere(), "draft", Sharing()), None, way, (-1, 0))
    own_step = newton.StaticNewton.load_step

    def inverting_below(self: newton.StaticNewton, *how: object, **passes: bool) -> object:
        ended = own_step(self, *how, **passes)
        if self.command[2] < -0.3:
            # The membrane's vertex on the axis goes down through the layers below it.
            self.data.qpos[self.gel.vertex_dof[0] + 2] -= 1.0
        return ended

    monkeypatch.setattr(newton.StaticNewton, "load_step", inverting_below)
    ended, after = solve(problem).records
    assert not ended.converged
    assert ended.diagnostics.min_volume_ratio <= 0
    assert ended.indenter_mm[2] == pytest.approx(-0.4)
    assert not after.converged


@pytest.mark.usefixtures("coarse")
def test_a_press_after_a_lift_is_the_press_alone() -> None:
    lifted, again = (0.4, 0, 0), (0.4, 0, -0.2)
    way, parents = ((0, 0, -0.2), (0.1, 0, -0.2), lifted, again, lifted, again), (-1, 0, 1, 2, -1, 4)
    gel = NO_SLIP.model_copy(update={"friction": 0.3})
    problem = ContactProblem.of(Scene(gel, Sphere(), "draft", Sharing()), None, way, parents)
    *_, up, pressed, _, alone = solve(problem).records
    assert abs(up.force_n[2]) < 1e-5
    assert pressed.converged
    np.testing.assert_array_equal(pressed.contact_force_n, alone.contact_force_n)
    assert problem.way(3) == (2, 3)


def ends(rates: list[float], furthest: float, number: int) -> np.ndarray:
    """Return how far from its end, 0, a linear iteration of those rates is after some accelerated iterations."""
    acceleration, place = AndersonAcceleration(), np.ones(len(rates))
    for _ in range(number):
        increment = (np.array(rates) - 1) * place
        place = place + increment
        place = place + acceleration.correction(place, increment, furthest)
    return place


@pytest.mark.parametrize("rates", [[0.9], [-0.6], [0.9, 0.5], [0.95, 0.8, -0.7]])
def test_an_iteration_with_few_rates_ends_after_few_increments(rates: list[float]) -> None:
    number = max(3, len(rates) + 1)
    assert np.abs(ends(rates, 1e3, number)).max() < 1e-6 < np.abs(np.array(rates) ** number).max()


def test_nothing_is_moved_further_than_is_allowed() -> None:
    assert ends([0.9], 1e-2, 3) == pytest.approx([0.729 - 1e-2])


def test_increments_that_grow_are_left_alone() -> None:
    acceleration = AndersonAcceleration()
    for size in (1.0, 1.2, 1.5):
        assert not acceleration.correction(np.array([size, 0.0]), np.array([0.0, size]), 1e3).any()


@pytest.mark.parametrize(("turns", "led"), [(1.0, True), (-1.0, False)])
def test_increments_that_grow_again_are_led_on_if_they_keep_their_direction(turns: float, led: bool) -> None:
    acceleration = AndersonAcceleration()
    increments = [turns**k * np.array([0.0, 1e-3 * 1.04**k]) for k in range(4)]
    *before, last = (acceleration.correction(np.zeros(2), increment, 1.0) for increment in increments)
    assert not np.any(before)
    assert last == pytest.approx([0.0, 0.5 if led else 0.0])
