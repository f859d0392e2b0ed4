"""The benchmark of real sessions, on a clone in small: splits by clip, plain methods, and a missing clone."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from real_clones import write_wedge_clone

from gelgap.benchmarks.common import bootstrap
from gelgap.benchmarks.real.sessions import FOLDS, PLAIN_METHODS, Session, clip_folds, plain_errors
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


@pytest.mark.parametrize("seed", [0, 1])
def test_each_clip_is_tested_once_per_seed_and_never_trained_on_there(seed: int):
    folds = list(clip_folds(session("a"), session("b"), seed))
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


def errors_n(source: Session, target: Session) -> list[float]:
    folds = {seed: list(clip_folds(source, target, seed)) for seed in (0, 1)}
    found = (plain_errors(predict, folds)[0] for _, _, predict in PLAIN_METHODS)
    return [float(mae_n.to_numpy().mean()) for mae_n in found]


def test_the_quadratic_is_exact_without_a_gap_and_standardising_undoes_gain_and_offset():
    constant, quadratic, standardised, bound = errors_n(session("a"), session("b"))
    assert constant > 2
    assert max(quadratic, bound) < 1e-9
    constant, quadratic, standardised, bound = errors_n(session("a"), session("b", gain=0.5, offset=2.0))
    assert quadratic > 1
    assert standardised < 0.5
    assert bound < 1e-9


def test_errors_are_those_of_each_clip_and_seed():
    target = session("b")
    off_n = {clip: number for number, clip in enumerate(target["clip"].unique())}

    def too_much(fold):
        return fold.target_test["fz_n"] + fold.target_test["clip"].map(off_n)

    folds = {seed: list(clip_folds(session("a"), target, seed)) for seed in (0, 1)}
    mae_n = plain_errors(too_much, folds)[0].to_numpy()
    assert mae_n == pytest.approx(np.repeat(np.arange(6.0)[:, None], 2, axis=1))
    low, high = bootstrap(mae_n)
    assert low < mae_n.mean() < high


def test_a_missing_clone_comes_with_the_line_that_gets_it(tmp_path: Path, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["benchmark", "real", "--data", str(tmp_path), "--out", str(tmp_path / "out")])
    assert stopped.value.code == 2
    said = capsys.readouterr().err
    assert f"git clone https://github.com/GelSight-lab/EstimateModulus {tmp_path / 'EstimateModulus'}" in said


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["real"], "--data is missing"),
        (["physics", "--data", "."], "--data is for benchmarks of real data alone"),
    ],
)
def test_data_are_named_where_they_are_needed(arguments, message, tmp_path: Path, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["benchmark", *arguments, "--out", str(tmp_path)])
    assert stopped.value.code == 2
    assert message in capsys.readouterr().err


def test_the_benchmark_runs_from_the_command_line(tmp_path: Path, capsys):
    write_wedge_clone(tmp_path / "clones/EstimateModulus")
    main(["benchmark", "real", "--quick", "--data", str(tmp_path / "clones"), "--out", str(tmp_path / "out")])
    printed = capsys.readouterr().out
    assert "2023-12-06 → 2023-12-16" in printed
    found = json.loads((tmp_path / "out/real-sessions.json").read_text())
    assert len(found) == 2 * len(PLAIN_METHODS)
    assert {len(one["mae_n"]) for one in found} == {6}
    by_name = {(one["source"], one["method"], one["labels"]): np.mean(one["mae_n"]) for one in found}
    constant = by_name["2023-12-06", "constant mean", "source"]
    assert by_name["2023-12-06", "quadratic in the mean difference", "target"] < 0.5 * constant
    assert FOLDS == 3
