"""Runs of the benchmark: what is missing, which records are refused, methods of one's own, and its scripts."""

import os
import re
import runpy
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from run_records import look_up_method, record, write_runs

from gelgap.adapt.trainer import untrained
from gelgap.benchmarks.adaptation import study
from gelgap.benchmarks.adaptation.protocol import BY_POINT, DATA, GROUPS, changes_of
from gelgap.benchmarks.adaptation.study import RUNS, Study, adapt_run, begun_by_touches, grid, train_once

CASES = [("paired", GROUPS[0])]
OWN_METHOD = """
from gelgap.adapt import Method

class Mine(Method):
    needs_stage_1 = False

class Other(Mine):
    pass
"""


@pytest.fixture
def same_data(monkeypatch, tmp_path):
    """A study in one process whose domains need not be there."""
    monkeypatch.setattr(Study, "domains_of", lambda self, run: [])
    return Study(tmp_path, tmp_path, "cpu", workers=1)


def test_work_comes_in_pieces_and_nothing_is_done_twice(same_data):
    did = []

    def work(own: Study, run: dict) -> dict:
        did.append(run["method"])
        return {"problem": None, "mae_n": [0.1] * 3, "r2": [0.5] * 3}

    runs = grid(CASES, ["dan", "dann", "dsan"], [0])
    assert len(replace(same_data, stop=time.time()).run(runs[:2], work)) == 0
    assert len(same_data.run(runs[:2], work)) == 2
    found = same_data.run(runs, work)
    assert list(found["method"]) == did == ["dan", "dann", "dsan"]
    assert set(found["profile"]) == {"cpu"}
    assert found["settings.transfer_weight"].iloc[1] == 0.003


@pytest.mark.parametrize("differs", [{"configuration": "d"}, {"settings": {"transfer_weight": 0.7}}])
def test_records_of_another_configuration_are_not_gone_on_from(same_data, differs):
    (run,) = grid(CASES, ["jan"], [0])
    stated = same_data.stated_of(run)
    _, results = record(GROUPS[0], "jan", 0.1)
    write_runs(same_data.out / RUNS, [(run, results | stated | differs)])
    with pytest.raises(ValueError, match=f"is of another {next(iter(differs))} than the same run has now"):
        same_data.run([run], lambda own, run: pytest.fail("measured"))


def test_other_pictures_of_the_same_recipe_are_another_configuration(monkeypatch, tmp_path):
    (run,) = grid(CASES, ["adabn"], [0])

    def configuration(recipe: str, digest: str) -> str:
        domain = SimpleNamespace(digest=digest)
        monkeypatch.setattr(Study, "domains_of", lambda self, run: [domain])
        monkeypatch.setattr(study, "recipe_of", lambda domain: SimpleNamespace(key=recipe))
        return Study(tmp_path, tmp_path, "cpu").stated_of(run)["configuration"]

    assert configuration("r", "d") == configuration("r", "d")
    assert len({configuration("r", "d"), configuration("r", "e"), configuration("s", "d")}) == 3


def test_of_the_settings_of_methods_a_run_has_its_own_alone(same_data):
    (run,) = grid(CASES, ["daregram"], [0], (("adapt_epochs", 3),))
    profile = same_data.profile_of(run)
    assert profile.settings == {"daregram": {"transfer_weight": 0.03}}
    assert profile.adapt_epochs == 3
    (plain,) = grid(CASES, ["source-only"], [0])
    assert same_data.profile_of(plain).settings == {}


def test_workers_know_a_method_of_ones_own(same_data, tmp_path):
    (tmp_path / "own.py").write_text(OWN_METHOD)
    places = tuple(f"{tmp_path / 'own.py'}:{name}" for name in ("Mine", "Other"))
    own = replace(same_data, methods=places, workers=2)
    found = own.run(grid(CASES, own.known_methods(), range(4)), look_up_method)
    assert set(found["method"]) > {"own.Mine", "own.Other"}
    assert set(found["found"]) > {"Mine", "Other"}
    assert os.getpid() not in set(found["pid"])
    assert found["pid"].nunique() == 2


def test_runs_wait_for_the_first_stage_that_they_share(source, target, monkeypatch, tmp_path):
    own = Study(tmp_path, tmp_path, "smoke")
    monkeypatch.setattr(Study, "domains_of", lambda self, run: [source, target])
    one, two, other, _ = grid(CASES, ["dsan", "dann"], [0, 1], (("image_size_px", (40, 32)),))
    first, second = (own.stage1(run, own.frames_of(run).source_train) for run in (one, two))
    assert first.checkpoint == second.checkpoint
    assert first.checkpoint != own.stage1(other, own.frames_of(other).source_train).checkpoint
    trained = []

    def train(*_, **__):
        trained.append(time.sleep(0.3))
        return untrained(source, own.profile_of(one), 0)

    monkeypatch.setattr("gelgap.adapt.runs.train_source", train)
    with ThreadPoolExecutor() as pool:
        seconds = list(pool.map(lambda stage1: train_once(stage1, "dsan"), (first, second)))
    assert len(trained) == 1
    assert min(seconds) == 0 < max(seconds)


def test_touches_are_shown_and_not_judged(source, target, monkeypatch, tmp_path):
    small = (("image_size_px", (40, 32)), ("colour_mixing", 0.0), ("source_epochs", 1))
    (run,) = grid([(DATA, GROUPS[0])], ["source-only"], [0], (*changes_of("touch"), *small))
    touches = [frames.take(np.unique(frames.point_id, return_index=True)[1]) for frames in (source, target)]
    monkeypatch.setattr(Study, "domains_of", lambda self, run: [source, target])
    monkeypatch.setattr(Study, "touches_of", lambda self, run: [(frames.name, frames) for frames in touches])
    monkeypatch.setattr(study, "_domain", lambda touches: touches)
    own = Study(tmp_path, tmp_path, "smoke")
    found, judged = adapt_run(own, run), own.frames_of(run | {"changes": BY_POINT}).target_test
    assert found["frames_sha256"]["target_test"] == judged.digest
    error_n = np.abs(found["predicted_n"] - judged.force_n)
    assert found["mae_n"] == pytest.approx(error_n.mean(axis=0), rel=1e-3)
    assert len(begun_by_touches(own.frames_of(run), *touches).target_test) > len(judged)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["groups", "--inputs", "grey"], "it takes --seeds, --methods, --groups"),
        (["equal_runs", "--inputs", "grey"], "it takes --seeds, --methods, --groups"),
        (["leaderboard", "--seeds", "1"], "it takes --methods, --inputs"),
        (
            ["inputs", "--groups", "wmb0i0:wmb0i1", "--inputs", "markers"],
            "no chosen group has markers on both",
        ),
        (["inputs", "--table", "nowhere.jsonl"], "nowhere.jsonl: no such file"),
    ],
)
def test_what_a_script_cannot_do_is_one_sentence(arguments, said, tmp_path, monkeypatch, capsys):
    name, *options = arguments
    monkeypatch.setattr(sys, "argv", [name, *options, "--out", str(tmp_path / "benchmark")])
    with pytest.raises(SystemExit, match="2"):
        runpy.run_path(str(Path(study.__file__).with_name(f"{name}.py")), run_name="__main__")
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_ctrl_c_ends_with_a_sentence(tmp_path):
    command = [sys.executable, "-m", "gelgap.benchmarks.adaptation.groups", "--out", tmp_path / "smoke"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not list(tmp_path.glob("data-smoke/paired/*")):
        time.sleep(0.05)
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=300)
    # What an import that was broken off has half made may complain as the process ends, after the sentence.
    progress, sentence, _ = error.partition(
        "interrupted; finished runs are kept, run the same command again to go on\n"
    )
    assert (process.returncode, bool(sentence)) == (130, True), error
    # However late the signal comes on a busy machine: some frames may be made by then.
    assert all(re.search(r": \d+ of \d+", line) for line in progress.splitlines()), error
