"""Extrapolating an iteration to the end of its geometric series."""

import numpy as np
import pytest

from gelgap.sim.extrapolation import GeometricSeries

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
    assert series.remainder(np.array([0.5, 0.0, 70.0]), np.array([0, 1]), FAR) == pytest.approx(1.0)


def test_steps_that_turn_are_no_series() -> None:
    series = GeometricSeries()
    for step in ([1.0, 0.0, 0.0], [1.0, 0.0, 0.0]):
        series.remainder(np.array(step), DOFS, FAR)
    assert series.remainder(np.array([0.5, 0.5, 0.0]), DOFS, FAR) == 0.0


def test_later_extrapolations_ask_for_longer_series() -> None:
    assert np.flatnonzero(remainders(0.9, 28)).tolist() == [2, 5, 8, 12, 18, 26]
