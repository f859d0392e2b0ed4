"""The headline: what is run, how methods are compared with their controls, and the tables of all."""

import math

import numpy as np
import pandas as pd
import pytest
from run_records import Record, headline_of, record, write_benchmark

from gelgap.benchmarks.adaptation.board import AT_RANDOM, GROUPS, MAIN_METHODS, METHODS, PAPER_MAE_N
from gelgap.benchmarks.adaptation.groups import (
    PART,
    SEEDS,
    adabn_table,
    check_table,
    control_table,
    counted,
    critical_difference,
    group_table,
    headline_grid,
    load_headline,
    load_oracles,
    method_table,
    order_table,
    plot_critical_difference,
    ranks,
    split_table,
)
from gelgap.benchmarks.adaptation.study import control_of


def records(errors: dict[str, float], seeds: int = 2, **fields) -> list[Record]:
    return [
        record(group, method, error + 0.01 * seed, seed, **fields)
        for group in GROUPS
        for method, error in errors.items()
        for seed in range(seeds)
    ]


def rows_of(table) -> dict[str, dict[str, str]]:
    return {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.cells}


def changed(found: list[Record], chosen, **results) -> list[Record]:
    """Return records, those that are chosen with other results."""
    return [(run, own | results if chosen(run) else own) for run, own in found]


def test_the_papers_means():
    assert len(GROUPS) == 9
    means = {name: np.mean(values) for name, values in PAPER_MAE_N.items()}
    assert means["source-only"] == pytest.approx(0.290, abs=5e-4)
    assert means["dsan"] == pytest.approx(0.135, abs=5e-4)
    assert list(means) == sorted(means, key=means.get, reverse=True)


def test_a_stop_at_any_time_leaves_complete_seeds():
    runs = headline_grid()
    by_point, at_random = runs[: 5 * 2 * 9 * len(METHODS)], runs[5 * 2 * 9 * len(METHODS) :]
    assert [run["seed"] for run in by_point] == sorted(run["seed"] for run in by_point)
    first = {(run["data"], (run["source"], run["target"])) for run in by_point if run["seed"] == 0}
    assert first == {(design, group) for design in ("paired", "independent") for group in GROUPS}
    assert {run["changes"] for run in by_point} == {(("split_by", "point"),)}
    assert {run["changes"] for run in at_random} == {AT_RANDOM}
    assert len(at_random) == 5 * 9 * len(MAIN_METHODS)
    assert {run["seed"] for run in runs} == set(SEEDS)


def test_every_method_is_held_against_its_own_control():
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
    assert control_of("ssa") == control_of("tasfar") == "adabn"
    assert control_of("dsan-soft") == "no-transfer"


def test_records_of_two_configurations_are_not_compared(tmp_path):
    found = [record(GROUPS[0], "dan", 0.1), record(GROUPS[0], "dann", 0.1, configuration="d")]
    with pytest.raises(ValueError, match="only runs of one profile and of the same data can be compared"):
        load_headline(write_benchmark(tmp_path, found))


def test_methods_beside_their_controls(tmp_path):
    errors = {"source-only": 0.3, "no-transfer": 0.2, "classifier-only": 0.18, "dann": 0.19, "dsan": 0.15}
    runs = headline_of(tmp_path, records(errors))
    rows, against = (rows_of(table(runs, "paired")) for table in (method_table, control_table))
    assert against["dsan"]["control"] == "classifier-only"
    assert against["dsan"]["difference, N"] == "-0.0300"
    assert against["dsan"]["95 % interval"] == "-0.0300…-0.0300"
    assert against["dann"]["difference, N"] == "-0.0100"
    assert against["dsan"]["better in"] == "9 of 9"
    assert "no-transfer" not in against  # AdaBN was not run
    assert [rows[m]["rank"] for m in errors] == ["5.0", "4.0", "2.0", "3.0", "1.0"]
    assert [rows[m]["without source-only"] for m in errors] == ["–", "4.0", "2.0", "3.0", "1.0"]


def test_a_collapsed_run_counts_with_what_it_became(tmp_path):
    found = changed(
        records({"source-only": 0.3, "dsan": 0.15}),
        lambda run: (run["source"], run["target"], run["method"], run["seed"]) == (*GROUPS[0], "dsan", 1),
        problem="the features collapsed",
        mae_n=(0.4,) * 3,
    )
    runs = headline_of(tmp_path, found)
    assert counted(runs)["dsan"].iloc[:2].tolist() == pytest.approx([0.15, 0.4])
    assert rows_of(method_table(runs, "paired"))["dsan"]["collapsed"] == "1"


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
    assert errors.notna().all(axis=1).sum() == 17
    assert math.isnan(errors["source-only"].iloc[1])
    assert errors["source-only"].iloc[0] == pytest.approx(0.3)
    assert "17 of 18" in method_table(runs, "paired").note
    assert list(errors.columns) == ["source-only", "dsan", "supervised"]


def test_groups_in_which_source_only_is_worse_than_the_constant_mean_are_marked(tmp_path):
    found = changed(
        records({"source-only": 0.3, "dsan": 0.15}, seeds=1),
        lambda run: (run["source"], run["target"], run["method"]) == (*GROUPS[2], "source-only"),
        mae_n=(0.5,) * 3,
    )
    far = {"pose_n": (0.1, 0.1, 0.2), "geometry_n": (0.1,) * 3}
    folder = write_benchmark(tmp_path, found, **{" → ".join(GROUPS[1]): far})
    table = group_table(load_headline(folder), "paired", load_oracles(folder))
    assert [row[0].endswith(" †") for row in table.rows] == [i == 2 for i in range(10)]
    assert [row[0].endswith(" *") for row in table.rows] == [i == 1 for i in range(10)]
    assert "1 of 9 groups" in table.note


def test_the_share_of_batch_normalisation(tmp_path):
    errors = {"source-only": 0.3, "adabn": 0.2, "dsan": 0.1, "coral": 0.35}
    rows = rows_of(adabn_table({"paired": headline_of(tmp_path, records(errors, seeds=1))}))
    assert rows["dsan"]["paired: AdaBN's share"] == "50 %"
    assert rows["dsan"]["paired: change from source-only"] == "-67 %"
    assert rows["coral"]["paired: AdaBN's share"] == "–"


def test_the_papers_order(tmp_path):
    errors = {"source-only": 0.3, "dann": 0.15, "daregram": 0.2, "dsan": 0.1}
    row = order_table({"paired": headline_of(tmp_path, records(errors, seeds=1))}).cells[0]
    assert row == ["mb0i0 → wmb0i0", "source-only > daregram > dann > dsan", "+0.67", "no"]
    for values, tau in (((0.4, 0.3, 0.2, 0.1), "+1.00"), ((0.1, 0.2, 0.3, 0.4), "-1.00")):
        runs = records(dict(zip(PAPER_MAE_N, values, strict=True)), seeds=1)
        assert order_table({"paired": headline_of(tmp_path / tau, runs)}).cells[0][2] == tau


def test_splits_side_by_side(tmp_path):
    splits = (
        headline_of(tmp_path / str(error), records({"source-only": 0.3, "dsan": error}, seeds=1))
        for error in (0.1, 0.15)
    )
    assert split_table(*splits).rows[1] == ["dsan", "0.100", "0.150", "1.50", "1", "1"]


def test_all_tables_of_both_designs(tmp_path):
    errors = {
        "source-only": 0.3,
        "adabn": 0.2,
        "dann": 0.16,
        "daregram": 0.15,
        "dsan": 0.14,
        "supervised": 0.05,
    }
    both = [
        *records(errors),
        *records(errors, data="independent"),
        *records({"dsan": 0.1}, changes=AT_RANDOM),
    ]
    folder = write_benchmark(tmp_path, [*both, record(GROUPS[0], "jan", 0.1)])
    titles = [table.title for table in PART.tables(folder)]
    assert len(titles) == len(set(titles)) == 16
    order = ["source-only", "adabn", "jan", "dann", "daregram", "dsan", "supervised"]
    assert list(counted(load_headline(folder)).columns) == order


def test_the_profile_counts_only_with_enough_r2(tmp_path):
    errors = {"source-only": 0.3, "dsan": 0.2, "supervised": 0.1}
    rows = check_table(headline_of(tmp_path, records(errors, seeds=1)), "paired").rows
    verdicts = {(row[0], row[1]): row[-1] for row in rows}
    assert verdicts["supervised on target", "wmb2i2"] == "yes"
    assert verdicts["source-only on held-out source", "mb0i0"] == "NO"


def test_paired_differences_leave_domains_out(tmp_path):
    rng = np.random.default_rng(0)
    base = 0.2 + 0.5 * rng.random((9, 3))
    worse = base + 0.02 + 0.001 * rng.random((9, 3))
    found = [
        record(group, method, errors[i, seed], seed)
        for method, errors in (("source-only", base), ("adabn", worse))
        for i, group in enumerate(GROUPS)
        for seed in range(3)
    ]
    ((_, _, mean, interval, better, leaving_out),) = control_table(
        headline_of(tmp_path, found), "paired"
    ).rows
    assert float(mean) == pytest.approx(0.0205, abs=5e-4)
    assert float(interval.split("…")[0]) > 0.02
    assert better == "0 of 9"
    assert float(leaving_out.split("…")[0]) > 0.02


def test_ranks_and_critical_difference():
    errors = pd.DataFrame([[0.1, 0.2, 0.2], [math.nan, 0.3, 0.4]])
    assert ranks(errors).to_numpy().tolist() == [[1, 2.5, 2.5], [3, 1, 2]]
    # Demšar 2006, table 5: q = 2.343 for three methods, 2.569 for four.
    assert critical_difference(4, 14) == pytest.approx(2.569 * np.sqrt(4 * 5 / (6 * 14)), rel=1e-3)


def test_methods_that_the_test_does_not_tell_apart_are_joined():
    # Mean ranks 1, 2, 3.1 and 3.9 over ten cases; the critical difference is 1.48.
    errors = pd.DataFrame({"a": [0.1] * 10, "b": [0.2] * 10, "c": [0.3] * 9 + [0.4], "d": [0.4] * 9 + [0.3]})
    (axes,) = plot_critical_difference(errors, "ranks").axes
    texts = {text.get_text() for text in axes.texts}
    assert {"a  1.00", "b  2.00", "3.10  c", "3.90  d", "CD = 1.5"} <= texts
    bars = [line.get_xdata() for line in axes.lines if len(set(line.get_ydata())) == 1]
    joined = {(round(min(x), 1), round(max(x), 1)) for x in bars}
    assert joined == {(1.0, 2.0), (2.0, 3.1), (3.1, 3.9), (1.0, 2.5)}  # the last one is the difference itself
