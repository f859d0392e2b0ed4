"""Intervals and p-values of groups that share sensors, and of many methods at once."""

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelgap.benchmarks.adaptation.statistics import drawn_means, halves, holm, interval, p_value, sensor_pair


def test_a_pair_of_sensors_is_one_in_either_direction_and_with_any_markers():
    assert sensor_pair("mb0i0 → wmb1i1") == sensor_pair("wmb1i1 → mb0i0") == ("b0i0", "b1i1")
    assert sensor_pair("mb0i0 → wmb0i0") == ("b0i0", "b0i0")


def test_groups_of_one_pair_are_no_further_cases():
    """Eight copies of a group say no more than the group: the interval over pairs does not shrink."""
    rng = np.random.default_rng(0)
    values = rng.normal(size=(4, 5))
    copied = values[[0, 1, 2, 3, 3, 3, 3, 3, 3, 3, 3]]
    by_pair = interval(drawn_means(values, range(4)))
    by_group = interval(drawn_means(copied, range(11)))
    same_pair = interval(drawn_means(copied, [0, 1, 2, *[3] * 8]))
    assert np.ptp(same_pair) > 1.2 * np.ptp(by_group)
    assert np.ptp(same_pair) > 0.8 * np.ptp(by_pair)


def test_draws_without_a_choice_have_no_meaning():
    values = np.ones((3, 2))
    assert np.isnan(drawn_means(values, ["a", "a", "a"])).all()
    assert np.isnan(drawn_means(values[:, :1], "abc")).all()
    assert math.isnan(p_value(drawn_means(values, ["a", "a", "a"])))
    assert drawn_means(np.ones((2, 3, 4)), "abc").shape == (4000, 2)


def test_p_is_of_both_sides_and_never_zero():
    assert p_value(np.linspace(-1, 1, 101)) == 1.0
    assert p_value(np.full(999, 1.0)) == p_value(np.full(999, -1.0)) == 2 / 1000


@given(st.lists(st.floats(0, 1), min_size=1, max_size=12))
def test_holm_is_between_the_p_values_and_bonferronis(values):
    p = pd.Series(values)
    adjusted = holm(p)
    assert (adjusted >= p - 1e-12).all()
    assert (adjusted <= (p * len(p)).clip(upper=1) + 1e-12).all()
    order = p.sort_values(kind="stable").index
    assert adjusted[order].is_monotonic_increasing


def test_holm_of_a_known_example():
    # Holm 1979: the least of four times four, the next three, and so on, never falling.
    assert holm(pd.Series([0.01, 0.04, 0.03, 0.005])).tolist() == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert math.isnan(holm(pd.Series([0.01, math.nan])).iloc[1])


def test_the_order_of_two_halves_of_the_seeds():
    index = pd.MultiIndex.from_product([["a", "b"], range(4)])
    stable = pd.DataFrame({"x": [1.0] * 8, "y": [2.0] * 8, "z": [3.0] * 8}, index)
    assert "τ = 1.00" in halves(stable)
    turned = stable.mul([1 if seed % 2 == 0 else -1 for _, seed in index], axis=0)
    assert "τ = -1.00" in halves(turned)
    assert halves(stable[:1]) == ""
