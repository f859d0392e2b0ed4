"""Networks on real sessions, on a clone in small: what they may train on, records, tables, and orders of methods."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from real_clones import write_wedge_clone

from gelgap.benchmarks.adaptation.board import GROUPS
from gelgap.benchmarks.adaptation.groups import SEEDS
from gelgap.benchmarks.adaptation.jobs import Bench
from gelgap.benchmarks.adaptation.leaderboard import Entry, EntryRun
from gelgap.benchmarks.common.records import read_records
from gelgap.benchmarks.real import network_runs, networks
from gelgap.benchmarks.real.clip_folds import FOLDS
from gelgap.benchmarks.real.network_runs import (
    FoldRecord,
    adapt_fold,
    fold_configuration,
    fold_jobs,
    frames_of,
)
from gelgap.benchmarks.real.networks import (
    DIRECTIONS,
    QUICK_METHODS,
    DirectionResults,
    direction_table,
    order_table,
)
from gelgap.benchmarks.real.orders import order_agreement
from gelgap.benchmarks.real.sessions import converted_sessions, read_sessions
from gelgap.cli.main import main


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """The bench of a small clone, converted."""
    folder = tmp_path_factory.mktemp("real")
    write_wedge_clone(folder / "clones/EstimateModulus")
    return Bench(converted_sessions(folder / "clones", folder), folder / "runs", "smoke", workers=1)


def clips(frames) -> set[str]:
    return set(frames.columns["clip"])


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_no_tested_clip_is_trained_on_and_all_are_tested(bench: Bench, direction):
    tested = []
    for job in fold_jobs([direction], ["dan"], [1], range(FOLDS)):
        frames = frames_of(bench, job)
        assert not clips(frames.target_train) & clips(frames.target_test)
        assert (frames.source_train.name, frames.target_test.name) == direction
        assert {len(clips(part)) for part in (frames.source_train, frames.target_train)} == {4}
        tested += clips(frames.target_test)
    assert len(tested) == len(set(tested)) == 6


def test_networks_learn_fz_of_pictures_in_contact_with_one_range(bench: Bench):
    (job,) = fold_jobs(DIRECTIONS[:1], ["dan"], [0], [0])
    frames = frames_of(bench, job)
    for part in vars(frames).values():
        assert part.labels.names == ("fz_n",)
        assert part.labels.ranges == (network_runs.FZ_RANGE_N,)
        assert part.label_values.max() < -0.3
        part.check_labels()
    assert set(frames.source_train.contact_class) == set(range(network_runs.CLASSES))
    assert not frames.target_train.has_classes


def test_a_run_that_stops_counts_with_the_mean_force_of_the_source(bench: Bench, monkeypatch):
    monkeypatch.setattr(network_runs, "train_stages", lambda *_: (None, "collapsed", 0.0, 1.0))
    (job,) = fold_jobs(DIRECTIONS[:1], ["dan"], [0], [2])
    record = adapt_fold(bench, job)
    fold = network_runs.fold_of(bench, job)
    assert record.problem == "collapsed"
    assert record.control == "no-transfer"
    assert record.clip_mae_n.keys() == set(fold.test.clip)
    for clip, error_n in record.clip_mae_n.items():
        fz_n = fold.test.fz_n[fold.test.clip == clip]
        assert error_n == pytest.approx(np.abs(fz_n - fold.source.fz_n.mean()).mean(), abs=1e-4)


def test_the_configuration_is_that_of_profile_and_sessions(bench: Bench, monkeypatch):
    job, other = fold_jobs(DIRECTIONS[:1], ["dan", "dsan"], [0], [0])
    found = fold_configuration(bench, job)
    assert found == fold_configuration(bench, other)
    assert found != fold_configuration(bench, replace(job, changes=(("source_epochs", 2),)))
    first, second = read_sessions(bench.data)
    stronger = replace(second, fz_n=1.1 * second.fz_n)
    monkeypatch.setattr("gelgap.benchmarks.real.sessions.read_sessions", lambda folder: (first, stronger))
    assert found != fold_configuration(bench, job)


def test_the_quick_form_runs_from_the_command_line_and_repeats_nothing(tmp_path: Path, capsys, monkeypatch):
    write_wedge_clone(tmp_path / "clones/EstimateModulus")
    command = ["benchmark", "real", "--what", "networks", "--quick"]
    command += ["--data", str(tmp_path / "clones"), "--out", str(tmp_path / "out")]
    main(command)
    printed = capsys.readouterr().out
    assert "2023-12-06 → 2023-12-16" in printed
    records = read_records(tmp_path / "out/real/smoke/runs.jsonl", FoldRecord)
    assert [record.job.method for record in records] == list(QUICK_METHODS)
    assert [record.stage1_s > 0 for record in records] == [True, False, False]
    assert all(len(record.clip_mae_n) == 2 and 0 < record.mean_mae_n < 20 for record in records)
    monkeypatch.setattr(networks, "adapt_fold", lambda bench, job: pytest.fail("measured again"))
    main(command)
    table = json.loads((tmp_path / "out/real-networks.json").read_text())[0]
    names = [row[0] for row in table["rows"]]
    assert names[0] == "constant mean"
    assert names[-3:] == list(QUICK_METHODS)


def made_up(
    bench: Bench, errors_n: dict[str, float], direction=DIRECTIONS[0], seeds=(0, 1)
) -> DirectionResults:
    """Return results in which a method's error is a number of its own, plus one for the clip and one for the seed."""
    sessions = {session.name: session for session in read_sessions(bench.data)}
    records = []
    for job in fold_jobs([direction], list(errors_n), seeds, range(FOLDS)):
        tested = np.unique(network_runs.fold_of(bench, job).test.clip)
        errors = {str(clip): errors_n[job.method] + 0.1 * int(clip[-1]) + 0.01 * job.seed for clip in tested}
        control = network_runs.control_of(job.method)
        records.append(FoldRecord(job, "smoke", "c", "v", {}, control, None, errors, 0.0, 1.0))
    return DirectionResults(*(sessions[name] for name in direction), records)


def test_methods_stand_beside_plain_ones_and_their_controls(bench: Bench):
    results = made_up(bench, {"source-only": 4.0, "no-transfer": 3.0, "dan": 2.5, "supervised": 2.0})
    assert not np.isnan(results.errors_n).any()
    table = direction_table(results)
    rows = {(row[0], row[1]): row[2:] for row in table.rows}
    assert float(rows["constant mean", "source"][0]) > 2
    assert float(rows["dan", "source"][0]) == pytest.approx(2.6, abs=0.011)
    assert rows["dan", "source"][2:5] == ["no-transfer", "-0.50", "-0.50…-0.50"]
    assert rows["no-transfer", "source"][2:5] == ["–", "–", "–"], "AdaBN, its control, was not run"
    assert rows["supervised", "both"][2] == "–"
    assert "dan, the best in hindsight, closes 75 % of the way" in table.note


def test_the_order_of_methods_is_compared_both_ways_and_with_the_nine_groups(bench: Bench, tmp_path: Path):
    errors_n = {"source-only": 4.0, "no-transfer": 3.0, "dan": 2.5, "dsan": 2.2, "supervised": 1.0}
    there = made_up(bench, errors_n)
    back = made_up(bench, {**errors_n, "supervised": 9.0}, DIRECTIONS[1])
    alone = order_table([there, back], [])
    assert [row[1:] for row in alone.rows] == [["4", "+1.00", "+1.00…+1.00"]]
    assert "paired contacts are in" in alone.note
    entries = [
        Entry(
            method=method,
            design="paired",
            profile="cpu",
            settings={},
            who="a test",
            when="2026-11-22",
            versions="",
            runs=[
                EntryRun(
                    source=source,
                    target=target,
                    seed=seed,
                    configuration="c",
                    mae_n=(0.1 / error_n if (source, target) in networks.ALIKE else error_n,) * 3,
                    r2=(0.0,) * 3,
                )
                for source, target in GROUPS
                for seed in SEEDS
            ],
        )
        for method, error_n in errors_n.items()
    ]
    table = order_table([there, back], entries)
    assert [row[2] for row in table.rows] == ["+1.00", "+1.00", "+1.00", "-1.00", "-1.00"]
    assert "with paired contacts" not in table.note
    assert "with independent contacts are in" in table.note


def test_an_order_that_cases_disagree_on_has_a_wide_interval():
    rng = np.random.default_rng(0)
    order = np.arange(6.0)[:, None, None]
    sure = order + 0.01 * rng.normal(size=(6, 9, 5))
    unsure = order + 10 * rng.normal(size=(6, 9, 1)) + np.zeros((6, 9, 5))
    assert order_agreement(sure, sure).interval == pytest.approx((1.0, 1.0))
    low, high = order_agreement(sure, unsure).interval
    assert high - low > 0.4
    assert order_agreement(sure, -sure).tau == pytest.approx(-1.0)
