"""Few labels of a real session: what a draw labels and tests, the steps of a training, tables, and the quick form."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gelgap.adapt import Profile, TrainingDiverged
from gelgap.adapt.data import steps_per_epoch
from gelgap.benchmarks.common import read_records
from gelgap.benchmarks.real import few_labels as study_of_few_labels
from gelgap.benchmarks.real.few_labels import (
    BUDGETS,
    ONE_CLIP,
    OTHER_OBJECTS,
    PRETRAINED,
    RUNS,
    SCRATCH,
    SESSION,
    STEPS,
    STREAMED,
    Budget,
    FewLabelStudy,
    few_label_runs,
    few_labels,
    profile_of,
    train_on_few_labels,
)
from gelgap.benchmarks.real.sessions import (
    CONSTANT,
    QUADRATIC,
    Session,
    error_rows,
    frames_of_session,
    read_sessions,
    rule_records,
)
from gelgap.cli.main import main


@pytest.fixture(scope="module")
def study(wedge: Path, tmp_path_factory: pytest.TempPathFactory) -> FewLabelStudy:
    """The study of a small clone, converted."""
    return FewLabelStudy.of(True, tmp_path_factory.mktemp("real"), wedge.parent)


@pytest.fixture(scope="module")
def session(study: FewLabelStudy) -> Session:
    return read_sessions(study.data)[SESSION]


@pytest.mark.parametrize("budget", BUDGETS.values(), ids=BUDGETS)
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
    tested = [
        clip for draw in range(3) for clip in few_labels(session, BUDGETS[ONE_CLIP], draw)[2]["clip"].unique()
    ]
    assert sorted(tested) == sorted(session["clip"].unique())
    labelled = {tuple(few_labels(session, BUDGETS[ONE_CLIP], draw)[0].index) for draw in range(12)}
    assert len(labelled) > 3


def test_pictures_and_forces_are_in_the_same_order(study: FewLabelStudy, session: Session):
    some = session[session["object"] == "golf_ball"]
    for part in (session, some):
        frames = frames_of_session(study.data, part)
        np.testing.assert_allclose(frames.label_values[:, 0], part["fz_n"], rtol=1e-6)
        np.testing.assert_array_equal(frames.columns["clip"].astype(str), part["clip"])


@pytest.mark.parametrize("labelled", [4, 33, 40, 400])
def test_every_training_takes_the_same_steps(study: FewLabelStudy, labelled: int):
    (run,) = few_label_runs([ONE_CLIP], [SCRATCH], [0])
    profile = profile_of(replace(study, profile="cpu"), run, labelled)
    per_epoch = steps_per_epoch(labelled, profile.batch_size)
    assert STEPS <= profile.adapt_epochs * per_epoch < STEPS + per_epoch
    assert profile.adapt_learning_rate == study_of_few_labels.SCRATCH_RATE


def test_a_start_is_where_training_begins(study: FewLabelStudy, session: Session, monkeypatch):
    """From a network of the real forces themselves, a few small steps do less harm than from scratch."""
    from gelgap.adapt import train_source

    frames = frames_of_session(study.data, session)
    checkpoint = study.checkpoint_of(PRETRAINED)
    checkpoint.parent.mkdir(parents=True)
    profile = Profile.preset("smoke").replace(source_epochs=8, marker_hiding=0.0)
    train_source(frames, profile, seed=0).save(checkpoint)
    for rate in ("SCRATCH_RATE", "PRETRAINED_RATE"):
        monkeypatch.setattr(study_of_few_labels, rate, 0.001)
    runs = few_label_runs(["8 frames"], [SCRATCH, PRETRAINED], [0])
    scratch, pretrained = (train_on_few_labels(study, run)["clip_mae_n"] for run in runs)
    assert scratch.keys() == pretrained.keys()
    assert np.mean(list(pretrained.values())) < 0.7 * np.mean(list(scratch.values()))
    configurations = [study.stated_of(run)["configuration"] for run in runs]
    assert configurations[0] != configurations[1]
    checkpoint.unlink()


def test_a_training_that_stops_counts_with_the_mean_of_the_labels(
    study: FewLabelStudy, session: Session, monkeypatch, tmp_path
):
    def stops(*_, **__):
        raise TrainingDiverged("not finite")

    monkeypatch.setattr(study_of_few_labels, "adapt", stops)
    (run,) = few_label_runs(["8 frames"], [SCRATCH], [0])
    records = replace(study, out=tmp_path).run(train_on_few_labels, [run], RUNS)
    assert list(records["problem"]) == ["not finite"]
    constant = rule_records([run | {"method": CONSTANT}], study.fold_of)
    found = {row["method"]: row["MAE, N"] for row in error_rows(pd.concat([records, constant]), "method", {})}
    assert found["no-transfer"] == pytest.approx(found[CONSTANT], abs=1e-4)


def test_a_difference_is_paired_and_above_0_where_the_control_is_better():
    """A start makes half as many errors again, whatever the clip and the draw; draws test half of the clips."""
    rng, rows = np.random.default_rng(0), []
    for draw in range(12):
        for start, factor in ((PRETRAINED, 1.0), ("without-light", 1.5)):
            clips_n = {f"clip_mae_n.{k}": factor * (1 + k) for k in range(12) if (k + draw) % 2}
            rows.append({"source": start, "seed": draw, "stage2_s": rng.random(), **clips_n})
    starts = [PRETRAINED, "without-light"]
    own, without = error_rows(pd.DataFrame(rows), "source", dict.fromkeys(starts, PRETRAINED))
    assert own["MAE, N"] == pytest.approx(6.5)
    assert "control" not in own
    assert without["difference, N"] == pytest.approx(3.25)
    assert without["difference, %"] == pytest.approx(50)
    low, high = without["of difference"]
    assert 1.5 < low < 3.25 < high < 5


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
    assert set(read_records(folder / RUNS)["source"]) == {SCRATCH, PRETRAINED, STREAMED}
    with monkeypatch.context() as patch:
        again = lambda study, run: pytest.fail("trained again")  # noqa: E731
        patch.setattr(study_of_few_labels, "train_on_few_labels", again)
        main(command)
    table = json.loads((tmp_path / "out/real-pretraining.json").read_text())
    starts = [CONSTANT, QUADRATIC, SCRATCH, PRETRAINED, STREAMED]
    assert [row[:2] for row in table["rows"]] == [[b, s] for b in (ONE_CLIP, OTHER_OBJECTS) for s in starts]
    command[command.index("pretraining")] = "randomisation"
    capsys.readouterr()
    main(command)
    assert "without-gel" in capsys.readouterr().out
    own, without = (folder / start / "pretrained.pt" for start in (PRETRAINED, "without-gel"))
    assert own.read_bytes() != without.read_bytes()
    assert set(read_records(folder / RUNS)["source"]) == {SCRATCH, PRETRAINED, STREAMED, "without-gel"}
