"""Few labels of a real session: what a draw labels and tests, the steps of a training, tables, and the quick form."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from real_clones import write_wedge_clone

from gelgap.adapt import Profile
from gelgap.adapt.data import steps_per_epoch
from gelgap.benchmarks.adaptation.jobs import Bench
from gelgap.benchmarks.common.records import read_records
from gelgap.benchmarks.real import few_label_runs, pretraining
from gelgap.benchmarks.real.few_label_draws import BUDGETS, Budget, few_labels
from gelgap.benchmarks.real.few_label_runs import (
    RATE,
    RUNS,
    STEPS,
    few_label_configuration,
    few_label_jobs,
    profile_of,
    train_on_few_labels,
)
from gelgap.benchmarks.real.network_runs import FoldRecord, frames_in_contact
from gelgap.benchmarks.real.pretraining import (
    BudgetResults,
    budget_results,
    chosen_rate,
    relative_difference,
    verdict,
)
from gelgap.benchmarks.real.sessions import Session, converted_sessions, read_sessions
from gelgap.benchmarks.real.starts import PRETRAINED, SCRATCH, checkpoint_of
from gelgap.cli.main import main

SESSION = "2023-12-06"


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """The bench of a small clone, converted."""
    folder = tmp_path_factory.mktemp("real")
    write_wedge_clone(folder / "clones/EstimateModulus")
    return Bench(converted_sessions(folder / "clones", folder), folder / "runs", "smoke", workers=1)


@pytest.fixture(scope="module")
def session(bench: Bench) -> Session:
    return read_sessions(bench.data)[0]


@pytest.mark.parametrize("budget", BUDGETS, ids=lambda budget: budget.name)
def test_nothing_of_a_tested_clip_is_known(session: Session, budget: Budget):
    for draw in range(6):
        drawn = few_labels(session, budget, draw)
        assert set(drawn.labelled) <= set(drawn.known)
        assert not set(session.clip[drawn.known]) & set(session.clip[drawn.tested])
        if budget.other_objects:
            assert not set(session.object[drawn.known]) & set(session.object[drawn.tested])
            assert len(set(session.clip[drawn.tested])) == 3
    assert Budget.of(budget.name) == budget


def test_a_budget_is_what_is_labelled(session: Session):
    drawn = few_labels(session, Budget(clips=2), 4)
    labelled = set(session.clip[drawn.labelled])
    assert len(labelled) == 2
    assert len(drawn.labelled) == np.isin(session.clip, list(labelled)).sum()
    assert len(few_labels(session, Budget(frames=8), 4).labelled) == 8
    one = few_labels(session, Budget(clips=1), 4)
    assert set(one.labelled) < set(drawn.labelled)


def test_three_draws_test_each_clip_once_and_others_label_others(session: Session):
    tested = [
        clip for draw in range(3) for clip in set(session.clip[few_labels(session, BUDGETS[0], draw).tested])
    ]
    assert sorted(tested) == sorted(set(session.clip))
    labelled = {tuple(few_labels(session, BUDGETS[0], draw).labelled) for draw in range(12)}
    assert len(labelled) > 3


def test_pictures_and_forces_are_in_the_same_order(bench: Bench, session: Session):
    frames = frames_in_contact(bench.data / SESSION, session)
    np.testing.assert_allclose(frames.label_values[:, 0], session.fz_n, rtol=1e-6)
    np.testing.assert_array_equal(frames.columns["clip"].astype(str), session.clip)


@pytest.mark.parametrize("labelled", [4, 33, 40, 400])
def test_every_training_takes_the_same_steps(bench: Bench, labelled: int):
    (job,) = few_label_jobs(SESSION, BUDGETS[:1], {SCRATCH: (0.1,)}, [0])
    profile = profile_of(replace(bench, profile="cpu"), job, labelled)
    per_epoch = steps_per_epoch(labelled, profile.batch_size)
    assert STEPS <= profile.adapt_epochs * per_epoch < STEPS + per_epoch
    assert profile.adapt_learning_rate == 0.1


def test_a_start_is_where_training_begins(bench: Bench, session: Session, monkeypatch):
    """From a network of the real forces themselves, a few small steps do less harm than from scratch."""
    from gelgap.adapt import train_source

    frames = frames_in_contact(bench.data / SESSION, session)
    checkpoint = checkpoint_of(bench, PRETRAINED)
    checkpoint.parent.mkdir(parents=True)
    profile = Profile.preset("smoke").replace(source_epochs=8, marker_hiding=0.0)
    train_source(frames, profile, seed=0).save(checkpoint)
    jobs = few_label_jobs(SESSION, [Budget(frames=8)], {SCRATCH: (0.001,), PRETRAINED: (0.001,)}, [0])
    scratch, pretrained = (train_on_few_labels(bench, job) for job in jobs)
    assert scratch.clip_mae_n.keys() == pretrained.clip_mae_n.keys()
    assert pretrained.mean_mae_n < 0.7 * scratch.mean_mae_n
    configurations = [few_label_configuration(bench, job) for job in jobs]
    assert configurations[0] != configurations[1]
    checkpoint.unlink()


def test_a_training_that_stops_counts_with_the_mean_of_the_labels(
    bench: Bench, session: Session, monkeypatch
):
    from gelgap import adapt

    def stops(*_, **__):
        raise adapt.TrainingDiverged("not finite")

    monkeypatch.setattr(adapt, "adapt", stops)
    (job,) = few_label_jobs(SESSION, [Budget(frames=8)], {SCRATCH: (0.1,)}, [0])
    record = few_label_runs.train_on_few_labels(bench, job)
    assert record.problem == "not finite"
    found = budget_results(bench, Budget(frames=8), [record])
    np.testing.assert_allclose(found.errors_n[SCRATCH], found.errors_n["constant mean"], atol=1e-4)


def test_a_relative_difference_is_paired():
    rng = np.random.default_rng(0)
    control = rng.uniform(1, 5, (12, 12))
    control[rng.random((12, 12)) < 0.5] = np.nan
    assert relative_difference(0.75 * control, control) == pytest.approx((-25, -25, -25))
    relative, low, high = relative_difference(control * rng.uniform(0.2, 1.8, (12, 1)), control)
    assert low < relative < high
    assert high - low > 15


def test_missed_targets_come_first():
    control = np.full((4, 3), 2.0)
    found = [
        BudgetResults(budget, {SCRATCH: control, PRETRAINED: share * control})
        for budget, share in ((Budget(clips=1), 0.7), (Budget(frames=4), 1.1), (BUDGETS[-1], 0.9))
    ]
    assert verdict(found) == (
        "Missed: 4 frames +10 % (+10…+10; at most +5); 4 clips of other objects -10 % (-10…-10; at most -15). "
        "Met: 1 clip -30 % (-30…-30; at most -25)."
    )


def test_the_rate_of_least_error_is_chosen():
    jobs = few_label_jobs(SESSION, BUDGETS[:2], {SCRATCH: (0.1, 0.2), PRETRAINED: (0.1,)}, [0])
    errors_n = {0.1: 2.0, 0.2: 1.0}
    records = [
        FoldRecord(job, "cpu", "c", "v", {}, None, None, {"a": errors_n[dict(job.changes)[RATE]]}, 1.0, 0.0)
        for job in jobs
    ]
    assert chosen_rate(records, SCRATCH) == 0.2
    assert chosen_rate(records, PRETRAINED) == 0.1


def test_the_quick_form_runs_from_the_command_line_and_repeats_nothing(tmp_path: Path, capsys, monkeypatch):
    write_wedge_clone(tmp_path / "clones/EstimateModulus")
    command = ["benchmark", "real", "--what", "pretraining", "--quick"]
    command += ["--data", str(tmp_path / "clones"), "--out", str(tmp_path / "out")]
    main(command)
    printed = capsys.readouterr().out
    assert "Few labels on real grasps, 2023-12-16" in printed
    records = read_records(tmp_path / "out/real/pretraining-smoke" / RUNS, FoldRecord)
    assert {record.job.source for record in records} == {SCRATCH, PRETRAINED}
    monkeypatch.setattr(pretraining, "train_on_few_labels", lambda bench, job: pytest.fail("trained again"))
    main(command)
    table, rates = json.loads((tmp_path / "out/real-pretraining.json").read_text())
    assert [row[0] for row in table["rows"]] == ["1 clip", "4 clips of other objects"]
    assert table["note"].startswith(("Missed:", "Met:"))
    assert [row[0] for row in rates["rows"]] == [SCRATCH, PRETRAINED]
