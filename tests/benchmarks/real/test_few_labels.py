"""Few labels of a real session: what a draw labels and tests, the steps of a training, tables, and the quick form."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gelgap.adapt import Profile
from gelgap.adapt.data import steps_per_epoch
from gelgap.benchmarks.common import read_records
from gelgap.benchmarks.real import few_labels as study_of_few_labels
from gelgap.benchmarks.real.few_labels import (
    BUDGETS,
    PRETRAINED,
    RATE,
    RUNS,
    SCRATCH,
    STEPS,
    Budget,
    FewLabelStudy,
    errors_of,
    factor_table,
    few_label_runs,
    few_labels,
    mean_by_rate,
    profile_of,
    relative_difference,
    train_on_few_labels,
)
from gelgap.benchmarks.real.sessions import Session, frames_of_session, read_sessions
from gelgap.cli.main import main

SESSION = "2023-12-06"


@pytest.fixture(scope="module")
def study(wedge: Path, tmp_path_factory: pytest.TempPathFactory) -> FewLabelStudy:
    """The study of a small clone, converted."""
    return FewLabelStudy.of(True, tmp_path_factory.mktemp("real"), wedge.parent)


@pytest.fixture(scope="module")
def session(study: FewLabelStudy) -> Session:
    return read_sessions(study.data)[SESSION]


@pytest.mark.parametrize("budget", BUDGETS, ids=lambda budget: budget.name)
def test_nothing_of_a_tested_clip_is_known(session: Session, budget: Budget):
    for draw in range(6):
        labelled, known, tested = few_labels(session, budget, draw)
        assert set(labelled.index) <= set(known.index)
        assert not set(known["clip"]) & set(tested["clip"])
        if budget.other_objects:
            assert not set(known["object"]) & set(tested["object"])
            assert tested["clip"].nunique() == 3


def test_a_budget_is_what_is_labelled(session: Session):
    labelled, _, _ = few_labels(session, Budget(clips=2), 4)
    assert labelled["clip"].nunique() == 2
    assert len(labelled) == session["clip"].isin(labelled["clip"]).sum()
    assert len(few_labels(session, Budget(frames=8), 4)[0]) == 8
    one, _, _ = few_labels(session, Budget(clips=1), 4)
    assert set(one.index) < set(labelled.index)


def test_three_draws_test_each_clip_once_and_others_label_others(session: Session):
    tested = [clip for draw in range(3) for clip in few_labels(session, BUDGETS[0], draw)[2]["clip"].unique()]
    assert sorted(tested) == sorted(session["clip"].unique())
    labelled = {tuple(few_labels(session, BUDGETS[0], draw)[0].index) for draw in range(12)}
    assert len(labelled) > 3


def test_pictures_and_forces_are_in_the_same_order(study: FewLabelStudy, session: Session):
    some = session[session["object"] == "golf_ball"]
    for part in (session, some):
        frames = frames_of_session(study.data, part)
        np.testing.assert_allclose(frames.label_values[:, 0], part["fz_n"], rtol=1e-6)
        np.testing.assert_array_equal(frames.columns["clip"].astype(str), part["clip"])


@pytest.mark.parametrize("labelled", [4, 33, 40, 400])
def test_every_training_takes_the_same_steps(study: FewLabelStudy, labelled: int):
    (run,) = few_label_runs(SESSION, BUDGETS[:1], {SCRATCH: (0.1,)}, [0])
    profile = profile_of(replace(study, profile="cpu"), run, labelled)
    per_epoch = steps_per_epoch(labelled, profile.batch_size)
    assert STEPS <= profile.adapt_epochs * per_epoch < STEPS + per_epoch
    assert profile.adapt_learning_rate == 0.1


def test_a_start_is_where_training_begins(study: FewLabelStudy, session: Session, monkeypatch):
    """From a network of the real forces themselves, a few small steps do less harm than from scratch."""
    from gelgap.adapt import train_source

    frames = frames_of_session(study.data, session)
    checkpoint = study.checkpoint_of(PRETRAINED)
    checkpoint.parent.mkdir(parents=True)
    profile = Profile.preset("smoke").replace(source_epochs=8, marker_hiding=0.0)
    train_source(frames, profile, seed=0).save(checkpoint)
    runs = few_label_runs(SESSION, [Budget(frames=8)], {SCRATCH: (0.001,), PRETRAINED: (0.001,)}, [0])
    scratch, pretrained = (train_on_few_labels(study, run)["clip_mae_n"] for run in runs)
    assert scratch.keys() == pretrained.keys()
    assert np.mean(list(pretrained.values())) < 0.7 * np.mean(list(scratch.values()))
    configurations = [study.stated_of(run)["configuration"] for run in runs]
    assert configurations[0] != configurations[1]
    checkpoint.unlink()


def test_a_training_that_stops_counts_with_the_mean_of_the_labels(
    study: FewLabelStudy, session: Session, monkeypatch, tmp_path
):
    from gelgap import adapt

    def stops(*_, **__):
        raise adapt.TrainingDiverged("not finite")

    monkeypatch.setattr(adapt, "adapt", stops)
    runs = few_label_runs(SESSION, [Budget(frames=8)], {SCRATCH: (0.1,)}, [0])
    records = replace(study, out=tmp_path).run(train_on_few_labels, runs, RUNS)
    assert list(records["problem"]) == ["not finite"]
    found = errors_of(session, Budget(frames=8), records)
    np.testing.assert_allclose(found[SCRATCH], found["constant mean"], atol=1e-4)


def test_a_relative_difference_is_paired():
    rng = np.random.default_rng(0)
    control = rng.uniform(1, 5, (12, 12))
    control[rng.random((12, 12)) < 0.5] = np.nan
    assert relative_difference(0.75 * control, control)[0] == pytest.approx(-25)
    assert relative_difference(0.75 * control, control)[1] == pytest.approx((-25, -25))
    relative, (low, high) = relative_difference(control * rng.uniform(0.2, 1.8, (12, 1)), control)
    assert low < relative < high
    assert high - low > 15


def test_the_rate_of_least_error_is_chosen():
    runs = few_label_runs(SESSION, BUDGETS[:2], {SCRATCH: (0.1, 0.2), PRETRAINED: (0.1,)}, [0])
    records = pd.DataFrame(runs)
    records["clip_mae_n.a"] = [{0.1: 2.0, 0.2: 1.0}[dict(run["changes"])[RATE]] for run in runs]
    assert mean_by_rate(records)[SCRATCH].idxmin() == 0.2
    assert mean_by_rate(records)[PRETRAINED].idxmin() == 0.1


def test_a_factor_that_helps_has_a_positive_difference():
    errors_n = np.full((4, 3), 2.0)
    found = {Budget(frames=16): {PRETRAINED: errors_n, "without-light": 1.5 * errors_n}}
    assert factor_table(found, [PRETRAINED, "without-light"]).rows == [
        [PRETRAINED, "2.00", None, None],
        ["without-light", "3.00", "+50 %", "+50…+50"],
    ]


@pytest.mark.usefixtures("coarse")
def test_the_quick_form_runs_from_the_command_line_and_repeats_nothing(
    wedge: Path, tmp_path: Path, capsys, monkeypatch
):
    command = ["benchmark", "real", "--what", "pretraining", "--quick"]
    command += ["--data", str(wedge.parent), "--out", str(tmp_path / "out")]
    main(command)
    printed = capsys.readouterr().out
    assert "Few labels on real grasps, 2023-12-16" in printed
    folder = tmp_path / "out/real/pretraining-smoke"
    assert set(read_records(folder / RUNS)["source"]) == {SCRATCH, PRETRAINED}
    with monkeypatch.context() as patch:
        again = lambda study, run: pytest.fail("trained again")  # noqa: E731
        patch.setattr(study_of_few_labels, "train_on_few_labels", again)
        main(command)
    table, rates = json.loads((tmp_path / "out/real-pretraining.json").read_text())
    assert [row[0] for row in table["rows"]] == ["1 clip", "4 clips of other objects"]
    assert [row[0] for row in rates["rows"]] == [SCRATCH, PRETRAINED]
    command[command.index("pretraining")] = "randomisation"
    capsys.readouterr()
    main(command)
    assert "without-gel" in capsys.readouterr().out
    own, without = (folder / start / "pretrained.pt" for start in (PRETRAINED, "without-gel"))
    assert own.read_bytes() != without.read_bytes()
    assert set(read_records(folder / RUNS)["source"]) == {SCRATCH, PRETRAINED, "without-gel"}
