"""Real sessions, on a clone in small: splits by clip, rules, what networks may train on, records and tables."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gelgap.adapt.runs import Adapted, Stage1
from gelgap.benchmarks.adaptation.study import control_of
from gelgap.benchmarks.common import read_records
from gelgap.benchmarks.real import sessions
from gelgap.benchmarks.real.sessions import (
    CONSTANT,
    DIRECTIONS,
    FZ_RANGE_N,
    QUADRATIC,
    QUICK_METHODS,
    RULES,
    FoldStudy,
    Session,
    adapt_fold,
    clip_folds,
    clip_table,
    direction_table,
    fold_runs,
    read_sessions,
    rule_records,
)
from gelgap.cli.main import main


def session(name: str, gain: float = 1.0, offset: float = 0.0) -> Session:
    """Return a session of two objects with three clips each, whose force is a quadratic of the change."""
    rng = np.random.default_rng(3)
    clips = [f"{thing}_{k}" for thing in ("ball", "foam") for k in range(3)]
    change = rng.uniform(1, 8, (6, 20))
    fz_n = -(0.2 * change**2 + change)
    return pd.DataFrame(
        {
            "session": name,
            "clip": np.repeat(clips, 20),
            "object": np.repeat(["ball", "foam"], 60),
            "fz_n": fz_n.ravel(),
            "change": (gain * change + offset).ravel(),
        }
    )


def test_each_clip_is_tested_once_per_seed_and_never_trained_on_there():
    folds = list(clip_folds(session("a"), session("b"), 1))
    tested = [clip for fold in folds for clip in fold.target_test["clip"].unique()]
    assert sorted(tested) == sorted(session("b")["clip"].unique())
    for fold in folds:
        assert not set(fold.target_test["clip"]) & set(fold.target_train["clip"])
        assert {part["clip"].nunique() for part in (fold.source_train, fold.target_train)} == {4}
        assert set(fold.target_test["object"]) == {"ball", "foam"}


def test_seeds_deal_clips_anew():
    dealt = {
        tuple(
            tuple(fold.target_test["clip"].unique()) for fold in clip_folds(session("a"), session("b"), seed)
        )
        for seed in range(5)
    }
    assert len(dealt) > 1


def errors_n(source: Session, target: Session) -> dict[str, float]:
    runs = fold_runs(DIRECTIONS[:1], RULES, [0, 1])
    records = rule_records(
        runs, lambda run: list(clip_folds(source, target, run["seed"]))[int(run["data"][-1])]
    )
    by_rule = records.groupby("method")
    return {rule: clip_table(own).to_numpy().mean() for rule, own in by_rule}


def test_the_quadratic_is_exact_without_a_gap_and_standardising_undoes_gain_and_offset():
    standardised, of_target = list(RULES)[2:]
    found = errors_n(session("a"), session("b"))
    assert found[CONSTANT] > 2
    assert max(found[QUADRATIC], found[of_target]) < 1e-9
    found = errors_n(session("a"), session("b", gain=0.5, offset=2.0))
    assert found[QUADRATIC] > 1
    assert found[standardised] < 0.5
    assert found[of_target] < 1e-9


def test_a_missing_clone_comes_with_the_line_that_gets_it(tmp_path: Path, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["benchmark", "real", "--data", str(tmp_path), "--out", str(tmp_path / "out")])
    assert stopped.value.code == 2
    said = capsys.readouterr().err
    assert f"git clone https://github.com/GelSight-lab/EstimateModulus {tmp_path / 'EstimateModulus'}" in said


def test_the_rules_are_measured_from_the_command_line(wedge: Path, tmp_path: Path, capsys):
    main(["benchmark", "real", "--quick", "--data", str(wedge.parent), "--out", str(tmp_path)])
    assert "2023-12-16 → 2023-12-06" in capsys.readouterr().out
    for table in json.loads((tmp_path / "real-sessions.json").read_text()):
        error_n = {row[0]: float(row[1]) for row in table["rows"]}
        assert list(error_n) == list(RULES)
        assert error_n[QUADRATIC] < 0.5 * error_n[CONSTANT]


@pytest.fixture(scope="module")
def study(wedge: Path, tmp_path_factory: pytest.TempPathFactory) -> FoldStudy:
    """The study of a small clone, converted."""
    return FoldStudy.of(True, tmp_path_factory.mktemp("real"), wedge.parent)


def clips(frames) -> set[str]:
    return set(frames.columns["clip"])


def test_no_tested_clip_is_trained_on_and_all_are_tested(study: FoldStudy):
    direction, tested = DIRECTIONS[1], []
    for run in fold_runs([direction], ["dan"], [1]):
        frames = study.frames_of(run)
        assert not clips(frames.target_train) & clips(frames.target_test)
        assert (frames.source_train.name, frames.target_test.name) == direction
        assert {len(clips(part)) for part in (frames.source_train, frames.target_train)} == {4}
        tested += clips(frames.target_test)
    assert len(tested) == len(set(tested)) == 6


def test_networks_learn_fz_of_pictures_in_contact_with_one_range(study: FoldStudy):
    run, *_ = fold_runs(DIRECTIONS[:1], ["dan"], [0])
    frames = study.frames_of(run)
    for part in frames:
        assert part.labels.names == ("fz_n",)
        assert part.labels.ranges == (FZ_RANGE_N,)
        assert part.label_values.max() < -0.3
        part.check_labels()
    assert set(frames.source_train.contact_class) == set(range(sessions.CLASSES))
    assert not frames.target_train.has_classes


def test_a_run_that_stops_counts_with_the_mean_force_of_the_source(study: FoldStudy, monkeypatch):
    stopped = Adapted(None, "collapsed", (), {"stage1": 0.0, "stage2": 1.0})
    monkeypatch.setattr(Stage1, "adapt", lambda *_: stopped)
    run = fold_runs(DIRECTIONS[:1], ["dan"], [0])[2]
    record = adapt_fold(study, run)
    (constant,) = (
        rule_records([run | {"method": CONSTANT}], study.fold_of).filter(like="clip_mae_n").to_dict("records")
    )
    assert record["problem"] == "collapsed"
    assert record["control"] == "no-transfer"
    assert {f"clip_mae_n.{clip}" for clip in record["clip_mae_n"]} == constant.keys()
    for clip, error_n in record["clip_mae_n"].items():
        assert error_n == pytest.approx(constant[f"clip_mae_n.{clip}"], abs=1e-4)


def test_the_configuration_is_that_of_profile_and_sessions(study: FoldStudy, monkeypatch):
    def configuration(run):
        return study.stated_of(run)["configuration"]

    run, other, *_ = fold_runs(DIRECTIONS[:1], ["dan", "dsan"], [0])
    found = configuration(run)
    assert found == configuration(other)
    assert found != configuration(run | {"changes": (("source_epochs", 2),)})
    first, second = read_sessions(study.data).items()
    stronger = second[1].assign(fz_n=1.1 * second[1]["fz_n"])
    monkeypatch.setattr(sessions, "read_sessions", lambda folder: dict([first, (second[0], stronger)]))
    assert found != configuration(run)


def test_the_quick_form_of_networks_runs_from_the_command_line_and_repeats_nothing(
    wedge: Path, tmp_path: Path, capsys, monkeypatch
):
    command = ["benchmark", "real-networks", "--quick"]
    command += ["--data", str(wedge.parent), "--out", str(tmp_path / "out")]
    main(command)
    assert "2023-12-06 → 2023-12-16" in capsys.readouterr().out
    records = read_records(tmp_path / "out/real/smoke/runs.jsonl")
    assert list(records["method"]) == list(QUICK_METHODS)
    assert list(records["stage1_s"] > 0) == [True, False, False]
    errors_n = records.filter(like="clip_mae_n.")
    assert errors_n.shape == (3, 2)
    assert errors_n.gt(0).all(axis=None)
    assert errors_n.mean(axis=1).lt(20).all()
    monkeypatch.setattr(sessions, "adapt_fold", lambda study, run: pytest.fail("measured again"))
    main(command)
    (table,) = json.loads((tmp_path / "out/real-networks.json").read_text())
    assert [row[0] for row in table["rows"]] == [*RULES, *QUICK_METHODS]


def test_methods_stand_beside_their_controls(study: FoldStudy):
    """A method's error is made up: a number of its own, plus one for the clip and one for the seed."""
    own_n, rows = {"source-only": 4.0, "no-transfer": 3.0, "dan": 2.5, "supervised": 2.0}, []
    for run in fold_runs(DIRECTIONS[:1], own_n, (0, 1)):
        row = {**run, "control": control_of(run["method"]), "stage2_s": 1.0}
        for clip in study.fold_of(run).target_test["clip"].unique():
            row[f"clip_mae_n.{clip}"] = own_n[run["method"]] + 0.1 * int(clip[-1]) + 0.01 * run["seed"]
        rows.append(row)
    table = direction_table(pd.DataFrame(rows), "")
    found = {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}
    assert float(found["dan"]["MAE, N"]) == pytest.approx(2.6, abs=0.011)
    assert found["dan"]["control"] == "no-transfer"
    assert found["dan"]["difference, N"] == "-0.50"
    assert found["dan"]["of difference"] == "-0.50…-0.50"
    assert found["dan"]["difference, %"] == "-16"
    assert found["no-transfer"]["control"] is None, "AdaBN, its control, was not run"
    assert found["supervised"]["control"] is None
