"""Groups: what is run, the share of the gap, rules beside methods, and what is compared with what."""

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from run_records import Record, headline_of, loaded, record, rows_of

from gelgap.adapt.evaluation import BASELINES, CONSTANT
from gelgap.benchmarks.adaptation import protocol
from gelgap.benchmarks.adaptation.groups import SEEDS, headline_grid, tables
from gelgap.benchmarks.adaptation.protocol import (
    GROUPS,
    LABEL_SHIFT,
    LIGHT_GROUPS,
    MAIN_METHODS,
    METHODS,
    UPPER_BOUND,
)
from gelgap.benchmarks.adaptation.study import control_of
from gelgap.benchmarks.adaptation.tables import (
    SHRUNK,
    closed,
    control_table,
    counted,
    draws_of,
    group_table,
    halves,
    holm,
    method_table,
    of_data,
    p_value,
    ranks,
    sensor_pair,
    upper_bound_table,
    upper_bounds,
    usable,
    with_rules,
)

NO_UPPER_BOUNDS = pd.DataFrame()


def records(errors: dict[str, float], seeds: int = 2, groups=GROUPS, **fields) -> list[Record]:
    return [
        record(group, method, error + 0.01 * seed, seed, **fields)
        for group in groups
        for method, error in errors.items()
        for seed in range(seeds)
    ]


def bounds_of(error_n: float, seeds: int = 2, r2=(0.95, 0.95, 0.99), **of_target) -> list[Record]:
    """Runs of targets that were trained on themselves; of some targets with another R²."""
    targets = dict.fromkeys(target for _, target in GROUPS)
    return [
        record((name, name), "source-only", error_n, seed, data=protocol.DATA, r2=of_target.get(name, r2))
        for name in targets
        for seed in range(seeds)
    ]


def changed(found: list[Record], chosen, **results) -> list[Record]:
    """Return records, those that are chosen with other results."""
    return [(run, own | results if chosen(run) else own) for run, own in found]


def test_a_stop_at_any_time_leaves_complete_seeds():
    runs = headline_grid()
    shifted = [run for run in runs if run["data"] == LABEL_SHIFT]
    own = runs[: len(runs) - len(shifted)]
    assert runs[len(own) :] == shifted
    assert [run["seed"] for run in own] == sorted(run["seed"] for run in own)
    groups = {*GROUPS, *LIGHT_GROUPS}
    first = [run for run in own if run["seed"] == 0]
    targets = {target for _, target in groups}
    assert {(run["source"], run["target"]) for run in first[: len(targets)]} == {(t, t) for t in targets}
    assert len(first) == len(targets) + len(groups) * (len(METHODS) - 1)
    assert {run["changes"] for run in runs} == {(("split_by", "point"),)}
    assert {run["method"] for run in shifted} == {*MAIN_METHODS} - {UPPER_BOUND}
    assert {run["seed"] for run in runs} == set(SEEDS)


def test_every_method_has_its_own_control():
    assert {method: control_of(method) for method in MAIN_METHODS} == {
        "source-only": None,
        "adabn": "source-only",
        "no-transfer": "adabn",
        "classifier-only": "no-transfer",
        "dann": "no-transfer",
        "daregram": "no-transfer",
        "dsan": "classifier-only",
        "supervised": None,
    }


def test_records_of_two_configurations_are_not_compared(tmp_path):
    found = [record(GROUPS[0], "dan", 0.1), record(GROUPS[0], "dann", 0.1, configuration="d")]
    with pytest.raises(ValueError, match="only runs of one profile and of the same data can be compared"):
        headline_of(tmp_path, found)


def test_methods_beside_their_controls(tmp_path):
    errors = {"source-only": 0.3, "no-transfer": 0.2, "classifier-only": 0.18, "dann": 0.182, "dsan": 0.15}
    runs = headline_of(tmp_path, records(errors))
    rows, against = (
        rows_of(table(runs, "paired", NO_UPPER_BOUNDS)) for table in (method_table, control_table)
    )
    assert against["dsan"]["control"] == "classifier-only"
    assert against["dsan"]["difference, N"] == "-0.0300"
    assert against["dsan"]["95 % interval"] == "-0.0300…-0.0300"
    # Of 4,000 draws none is above 0; three methods have a control.
    assert against["dsan"]["p, Holm"] == "0.001"
    assert against["dann"]["difference, N"] == "-0.0180"
    assert against["dsan"]["better in"] == "9 of 9"
    assert "no-transfer" not in against  # AdaBN was not run
    assert [rows[m]["rank mean"] for m in errors] == ["5", "4", "2–3", "2–3", "1"]


def test_errors_within_the_noise_of_two_runs_share_their_ranks():
    errors = pd.Series({"dan": 0.1, "dann": 0.105, "dsan": 0.114, "jan": 0.2, "uga": math.nan})
    assert ranks(errors, 0.01).tolist()[:4] == ["1–2", "1–3", "2–3", "4"]
    assert ranks(errors, 0.01).isna()["uga"]


def test_the_gap_closed(tmp_path):
    """From 0.3 N (the constant mean has 0.4) to 0.1 N; with the constant mean at 0.25 N from there."""
    errors = {"source-only": 0.3, "adabn": 0.2, "dsan": 0.15}
    found = [*records(errors, data=protocol.DATA), *bounds_of(0.1)]
    every = loaded(tmp_path / "one", found)
    runs, own = with_rules(of_data(every, protocol.DATA)), upper_bounds(every)
    share = closed(runs, own)["share"]
    # Errors of the two seeds are 0.01 N apart, so that the gap is 0.2 and 0.21 N.
    assert share["source-only"] == pytest.approx(0)
    assert share["adabn"] == pytest.approx(100 * 0.1 / 0.205)
    assert share["dsan"] == pytest.approx(100 * 0.15 / 0.205)
    near = [(run, own | {"baselines_mae_n": dict.fromkeys(BASELINES, (0.25,) * 3)}) for run, own in found]
    every = loaded(tmp_path / "two", near)
    runs, own = with_rules(of_data(every, protocol.DATA)), upper_bounds(every)
    share = closed(runs, own)["share"]
    assert share["adabn"] == pytest.approx(100 * (0.25 - 0.205) / 0.15)
    assert share[CONSTANT] == 0
    table = rows_of(method_table(runs, protocol.DATA, own))
    assert table["adabn"]["closed"] == "30 %"


def test_a_upper_bound_that_is_none_is_left_out(tmp_path):
    found = [*records({"source-only": 0.3, "dsan": 0.15}, data=protocol.DATA)]
    found += bounds_of(0.1, wmb2i2=(0.7, 0.95, 0.99))
    every = loaded(tmp_path, found)
    own = upper_bounds(every)
    assert "wmb2i2" not in usable(own)
    assert "wmb1i1" in usable(own)
    assert set(closed(with_rules(of_data(every, protocol.DATA)), own)["groups"]) == {6}
    verdicts = {row[0]: row[-1] for row in upper_bound_table(own).cells}
    assert verdicts["wmb2i2"] == "NO"
    assert verdicts["mb0i0"] == "yes"


def test_rules_are_rows_of_every_table(tmp_path):
    found = changed(
        records({"source-only": 0.3, "adabn": 0.2}, seeds=1),
        lambda run: run["method"] == "adabn",
        mae_n=(0.5, 0.6, 0.1),
        constant_mean_n=(0.3, 0.3, 0.9),
    )
    runs = with_rules(headline_of(tmp_path, found))
    assert set(runs["method"]) == {"source-only", "adabn", *BASELINES, SHRUNK}
    # AdaBN's Fz of 0.1 N, beside a mean shear of 0.3 N.
    assert counted(runs)[SHRUNK].tolist() == pytest.approx([0.7 / 3] * 9)
    rows = rows_of(method_table(runs, "paired", NO_UPPER_BOUNDS))
    assert rows["adabn"]["mean, N"] == "0.400"
    assert rows["adabn"]["no shear, N"] == "0.233"
    assert rows["adabn"]["rank Fz"] == "1–2"
    assert rows["adabn"]["rank shear"] == "6"
    for table in (group_table, control_table):
        assert CONSTANT in str(table(runs, "paired", NO_UPPER_BOUNDS)) or table is control_table


def test_a_collapsed_run_counts_with_what_it_became(tmp_path):
    found = changed(
        records({"source-only": 0.3, "dsan": 0.15}),
        lambda run: (run["source"], run["target"], run["method"], run["seed"]) == (*GROUPS[0], "dsan", 1),
        problem="the features collapsed",
        mae_n=(0.4,) * 3,
    )
    runs = headline_of(tmp_path, found)
    assert counted(runs)["dsan"].iloc[:2].tolist() == pytest.approx([0.15, 0.4])
    assert rows_of(method_table(runs, "paired", NO_UPPER_BOUNDS))["dsan"]["collapsed"] == "1"


def test_methods_are_compared_on_what_all_have_finished(tmp_path):
    found = records({"source-only": 0.3, "dsan": 0.15, "supervised": 0.05})
    left_out = (*GROUPS[0], "dsan", 1)
    partial = [
        one
        for one in found
        if (one[0]["source"], one[0]["target"], one[0]["method"], one[0]["seed"]) != left_out
    ]
    runs = headline_of(tmp_path, partial)
    errors = counted(runs)
    assert len(errors) == 17
    assert (GROUPS[0][0] + " → " + GROUPS[0][1], 1) not in errors.index
    assert errors["source-only"].iloc[0] == pytest.approx(0.3)
    assert "17 of 18" in method_table(runs, "paired", NO_UPPER_BOUNDS).note
    assert list(errors.columns) == ["source-only", "dsan", "supervised"]


def test_all_tables_of_two_data_sets(tmp_path):
    errors = {"source-only": 0.3, "adabn": 0.2, "dann": 0.16, "daregram": 0.15, "dsan": 0.14}
    both = [*records(errors, data=protocol.DATA), *records(errors, data="paired"), *bounds_of(0.05)]
    every = loaded(tmp_path, [*both, record(GROUPS[0], "jan", 0.1, data=protocol.DATA)])
    found = tables(every)
    titles = [table.title for table in found]
    assert len(titles) == len(set(titles)) == 7
    assert rows_of(found[0])["dsan"]["stage 2, s"] == "30.0"
    assert "took 60.0 s" in found[0].note
    order = ["source-only", "adabn", "jan", "dann", "daregram", "dsan"]
    assert list(counted(of_data(every, protocol.DATA)).columns) == order


def test_paired_differences_leave_pairs_of_sensors_out(tmp_path):
    rng = np.random.default_rng(0)
    base = 0.2 + 0.5 * rng.random((9, 3))
    worse = base + 0.02 + 0.001 * rng.random((9, 3))
    found = [
        record(group, method, errors[i, seed], seed)
        for method, errors in (("source-only", base), ("adabn", worse))
        for i, group in enumerate(GROUPS)
        for seed in range(3)
    ]
    table = control_table(headline_of(tmp_path, found), "paired", NO_UPPER_BOUNDS)
    ((_, _, mean, interval, p, better, leaving_out),) = table.cells
    assert float(mean) == pytest.approx(0.0205, abs=5e-4)
    assert float(interval.split("…")[0]) > 0.02
    assert float(p) < 0.01
    assert better == "0 of 9"
    assert float(leaving_out.split("…")[0]) > 0.02


def test_a_pair_of_sensors_is_one_in_either_direction_and_with_any_markers():
    assert sensor_pair("mb0i0 → wmb1i1") == sensor_pair("wmb1i1 → mb0i0") == ("b0i0", "b1i1")
    assert sensor_pair("mb0i0 → wmb0i0") == ("b0i0", "b0i0")


def errors_of(groups: list[str], seeds: int, **columns: float) -> pd.DataFrame:
    index = pd.MultiIndex.from_product([groups, range(seeds)], names=["group", "seed"])
    return pd.DataFrame(columns, index)


def test_draws_without_a_choice_have_no_meaning():
    one_pair = ["mb0i0 → wmb1i1", "wmb1i1 → mb0i0"]
    for errors in (errors_of(one_pair, 2, dan=1.0), errors_of([*one_pair, "mb0i0 → wmb2i2"], 1, dan=1.0)):
        assert np.isnan(draws_of(errors)).all()
        assert math.isnan(p_value(draws_of(errors)[:, 0]))
    errors = errors_of([*one_pair, "mb0i0 → wmb2i2"], 2, dan=1.0, dann=2.0)
    for kept in (errors, errors.iloc[1:]):  # a seed of a group that is not finished takes no interval away
        assert (draws_of(kept) == [1.0, 2.0]).all()


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
    stable = errors_of(["a", "b"], 4, x=1.0, y=2.0, z=3.0)
    assert "τ = 1.00" in halves(stable)
    turned = stable.mul([1 if seed % 2 == 0 else -1 for _, seed in stable.index], axis=0)
    assert "τ = -1.00" in halves(turned)
    assert halves(stable[:1]) == ""
