"""Pairs of equal runs: what differs between them, and how far apart they are."""

from pathlib import Path

import pytest
from run_records import loaded, record, rows_of

from gelgap.benchmarks.adaptation.equal_runs import GROUPS, nudged, tables
from gelgap.benchmarks.adaptation.protocol import BY_POINT, DATA
from gelgap.benchmarks.adaptation.study import Study, grid


def test_the_second_run_of_a_pair_differs_by_a_ten_millionth():
    study = Study(Path(), Path(), "benchmark")
    pair = [study.profile_of(*grid([(DATA, GROUPS[0])], ["dann"], [0], own)) for own in (BY_POINT, nudged())]
    assert pair[0].source_learning_rate != pair[1].source_learning_rate
    assert pair[0].source_learning_rate == pytest.approx(pair[1].source_learning_rate, rel=2e-7)
    assert pair[0].replace(source_learning_rate=pair[1].source_learning_rate) == pair[1]


def test_distances_are_of_pairs_that_are_whole(tmp_path):
    found = [record(GROUPS[k], "adabn", 0.1, 0, DATA) for k in range(3)]
    found += [
        record(GROUPS[0], "adabn", 0.12, 0, DATA, nudged()),
        record(GROUPS[1], "adabn", 0.09, 0, DATA, nudged()),
    ]
    (table,) = tables(loaded(tmp_path, found))
    row = rows_of(table)["adabn"]
    assert row["pairs"] == "2"
    assert row["mean apart, mean, N"] == "0.015"
    assert row["Fz apart, most, N"] == "0.020"
