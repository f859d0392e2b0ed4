"""Networks on real sessions, on a clone in small: what they may train on, records, tables, and orders of methods."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gelgap.adapt.runs import Adapted, Stage1
from gelgap.benchmarks.adaptation.board import DESIGNS, GROUPS
from gelgap.benchmarks.adaptation.groups import SEEDS
from gelgap.benchmarks.adaptation.study import control_of
from gelgap.benchmarks.common import read_records
from gelgap.benchmarks.real import networks
from gelgap.benchmarks.real.networks import (
    DIRECTIONS,
    QUICK_METHODS,
    FoldStudy,
    adapt_fold,
    direction_table,
    errors_of,
    fold_runs,
    former_errors,
    order_agreement,
    order_table,
)
from gelgap.benchmarks.real.sessions import FOLDS, FZ_RANGE_N, read_sessions
from gelgap.cli.main import main


@pytest.fixture(scope="module")
def study(wedge: Path, tmp_path_factory: pytest.TempPathFactory) -> FoldStudy:
    """The study of a small clone, converted."""
    return FoldStudy.of(True, tmp_path_factory.mktemp("real"), wedge.parent)


def clips(frames) -> set[str]:
    return set(frames.columns["clip"])


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_no_tested_clip_is_trained_on_and_all_are_tested(study: FoldStudy, direction):
    tested = []
    for run in fold_runs([direction], ["dan"], [1], range(FOLDS)):
        frames = study.frames_of(run)
        assert not clips(frames.target_train) & clips(frames.target_test)
        assert (frames.source_train.name, frames.target_test.name) == direction
        assert {len(clips(part)) for part in (frames.source_train, frames.target_train)} == {4}
        tested += clips(frames.target_test)
    assert len(tested) == len(set(tested)) == 6


def test_networks_learn_fz_of_pictures_in_contact_with_one_range(study: FoldStudy):
    (run,) = fold_runs(DIRECTIONS[:1], ["dan"], [0], [0])
    frames = study.frames_of(run)
    for part in frames:
        assert part.labels.names == ("fz_n",)
        assert part.labels.ranges == (FZ_RANGE_N,)
        assert part.label_values.max() < -0.3
        part.check_labels()
    assert set(frames.source_train.contact_class) == set(range(networks.CLASSES))
    assert not frames.target_train.has_classes


def test_a_run_that_stops_counts_with_the_mean_force_of_the_source(study: FoldStudy, monkeypatch):
    stopped = Adapted(None, "collapsed", (), {"stage1": 0.0, "stage2": 1.0})
    monkeypatch.setattr(Stage1, "adapt", lambda *_: stopped)
    (run,) = fold_runs(DIRECTIONS[:1], ["dan"], [0], [2])
    record = adapt_fold(study, run)
    source, _, test = study.fold_of(run)
    assert record["problem"] == "collapsed"
    assert record["control"] == "no-transfer"
    assert record["clip_mae_n"].keys() == set(test["clip"])
    for clip, error_n in record["clip_mae_n"].items():
        fz_n = test["fz_n"][test["clip"] == clip]
        assert error_n == pytest.approx(np.abs(fz_n - source["fz_n"].mean()).mean(), abs=1e-4)


def test_the_configuration_is_that_of_profile_and_sessions(study: FoldStudy, monkeypatch):
    def configuration(run):
        return study.stated_of(run)["configuration"]

    run, other = fold_runs(DIRECTIONS[:1], ["dan", "dsan"], [0], [0])
    found = configuration(run)
    assert found == configuration(other)
    assert found != configuration(run | {"changes": (("source_epochs", 2),)})
    first, second = read_sessions(study.data).items()
    stronger = second[1].assign(fz_n=1.1 * second[1]["fz_n"])
    monkeypatch.setattr(networks, "read_sessions", lambda folder: dict([first, (second[0], stronger)]))
    assert found != configuration(run)


def test_the_quick_form_runs_from_the_command_line_and_repeats_nothing(
    wedge: Path, tmp_path: Path, capsys, monkeypatch
):
    command = ["benchmark", "real", "--what", "networks", "--quick"]
    command += ["--data", str(wedge.parent), "--out", str(tmp_path / "out")]
    main(command)
    printed = capsys.readouterr().out
    assert "2023-12-06 → 2023-12-16" in printed
    records = read_records(tmp_path / "out/real/smoke/runs.jsonl")
    assert list(records["method"]) == list(QUICK_METHODS)
    assert list(records["stage1_s"] > 0) == [True, False, False]
    errors_n = records.filter(like="clip_mae_n.")
    assert errors_n.shape == (3, 2)
    assert errors_n.gt(0).all(axis=None)
    assert errors_n.mean(axis=1).lt(20).all()
    monkeypatch.setattr(networks, "adapt_fold", lambda study, run: pytest.fail("measured again"))
    main(command)
    table = json.loads((tmp_path / "out/real-networks.json").read_text())[0]
    names = [row[0] for row in table["rows"]]
    assert names[0] == "constant mean"
    assert names[-3:] == list(QUICK_METHODS)


def made_up(
    study: FoldStudy, errors_n: dict[str, float], direction=DIRECTIONS[0], seeds=(0, 1)
) -> pd.DataFrame:
    """Return runs in which a method's error is a number of its own, plus one for the clip and one for the seed."""
    rows = []
    for run in fold_runs([direction], list(errors_n), seeds, range(FOLDS)):
        row = {**run, "control": control_of(run["method"]), "problem": None, "stage1_s": 0.0, "stage2_s": 1.0}
        for clip in study.fold_of(run).target_test["clip"].unique():
            row[f"clip_mae_n.{clip}"] = errors_n[run["method"]] + 0.1 * int(clip[-1]) + 0.01 * run["seed"]
        rows.append(row)
    return pd.DataFrame(rows)


def test_methods_stand_beside_plain_ones_and_their_controls(study: FoldStudy):
    runs = made_up(study, {"source-only": 4.0, "no-transfer": 3.0, "dan": 2.5, "supervised": 2.0})
    assert not any(errors_n.isna().any(axis=None) for errors_n in errors_of(runs).values())
    sessions = read_sessions(study.data)
    table = direction_table(runs, *(sessions[name] for name in DIRECTIONS[0]))
    rows = {(row[0], row[1]): row[2:] for row in table.rows}
    assert float(rows["constant mean", "source"][0]) > 2
    assert float(rows["dan", "source"][0]) == pytest.approx(2.6, abs=0.011)
    assert rows["dan", "source"][2:5] == ["no-transfer", "-0.50", "-0.50…-0.50"]
    assert rows["no-transfer", "source"][2:5] == [None] * 3, "AdaBN, its control, was not run"
    assert rows["supervised", "both"][2] is None


def test_the_order_of_methods_is_compared_both_ways_and_with_the_nine_groups(
    study: FoldStudy, tmp_path: Path
):
    errors_n = {"source-only": 4.0, "no-transfer": 3.0, "dan": 2.5, "dsan": 2.2, "supervised": 1.0}
    there = made_up(study, errors_n)
    back = made_up(study, {**errors_n, "supervised": 9.0}, DIRECTIONS[1])
    alone = order_table([there, back], former_errors(tmp_path))
    assert [row[1:] for row in alone.rows] == [["4", "+1.00", "+1.00…+1.00"]]
    assert "paired contacts are in" in alone.note
    for method, error_n in errors_n.items():
        runs = [
            {
                **{"source": group[0], "target": group[1], "seed": seed},
                "mae_n": [0.1 / error_n if group in networks.ALIKE else error_n] * 3,
            }
            for group in GROUPS
            for seed in SEEDS
        ]
        record = {"format": 1, "method": method, "design": "paired", "runs": runs}
        (tmp_path / f"{method}-paired.json").write_text(json.dumps(record))
    table = order_table([there, back], former_errors(tmp_path))
    assert [row[2] for row in table.rows] == ["+1.00", "+1.00", "+1.00", "-1.00", "-1.00"]
    assert "with paired contacts" not in table.note
    assert "with independent contacts are in" in table.note


def test_an_order_that_cases_disagree_on_has_a_wide_interval():
    rng = np.random.default_rng(0)
    order = np.arange(6.0)[:, None, None]
    sure = order + 0.01 * rng.normal(size=(6, 9, 5))
    unsure = order + 10 * rng.normal(size=(6, 9, 1)) + np.zeros((6, 9, 5))
    assert order_agreement(sure, sure)[1] == pytest.approx((1.0, 1.0))
    low, high = order_agreement(sure, unsure)[1]
    assert high - low > 0.4
    assert order_agreement(sure, -sure)[0] == pytest.approx(-1.0)


def test_former_records_are_still_read():
    former = former_errors(networks.SYNTHETIC_RECORDS)
    assert set(former.index.levels[0]) == set(DESIGNS)
    assert former.loc["paired", "dsan"].shape == (9, 5)
    assert not former.isna().any(axis=None)
