"""The short form of the fuzz: no damage to a file passes unseen, and none ends in anything but a sentence."""

import logging
import shutil
from pathlib import Path

import numpy as np
import pytest

from gelgap.benchmarks.data.file_faults import Question, is_one_sentence, try_kind
from gelgap.benchmarks.data.file_kinds import KINDS, FileKind, content_digest
from gelgap.benchmarks.data.mutations import MUTATIONS, mutated

TRIES = 20


@pytest.fixture
def quiet():
    """Leave the logger as it was."""
    logger = logging.getLogger("gelgap")
    level = logger.level
    yield
    logger.setLevel(level)


@pytest.mark.parametrize("kind", KINDS)
def test_no_damage_passes_unseen(kind: str, sound_files: Path, tmp_path: Path, quiet, monkeypatch) -> None:
    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path))
    shutil.copytree(sound_files, tmp_path / "sound")
    result = try_kind(Question(kind, tmp_path, TRIES))
    assert sum(result.outcomes.values()) == TRIES
    assert result.failures == [], result.examples


def test_every_mutation_changes_the_bytes_and_is_drawn_by_its_number() -> None:
    data = np.random.default_rng(0).bytes(1000)
    found = [mutated(data, number, 0) for number in range(40)]
    assert found == [mutated(data, number, 0) for number in range(40)]
    assert {name for name, _ in found} == set(MUTATIONS)
    assert all(changed != data for _, changed in found)


@pytest.mark.parametrize("outcome", ["not noticed", "unnamed", "wrong exception"])
def test_what_may_not_happen_is_told(
    outcome: str, sound_files: Path, tmp_path: Path, quiet, monkeypatch
) -> None:
    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path))
    shutil.copytree(sound_files, tmp_path / "sound")
    sound = (sound_files / "membrane" / "state.npz").read_bytes()

    def read(part: Path) -> str:
        if (part / "state.npz").read_bytes() == sound:
            return "the content"
        if outcome == "not noticed":
            return "other content"
        raise {"unnamed": ValueError, "wrong exception": KeyError}[outcome]("no name")

    monkeypatch.setitem(KINDS, "membrane (npz)", FileKind("membrane", "state.npz", read))
    result = try_kind(Question("membrane (npz)", tmp_path, 10))
    assert result.outcomes == {outcome: 10}
    assert result.failures == [f"10 × {outcome}"]


def test_digests_tell_arrays_and_texts_apart() -> None:
    values = [np.zeros(3), np.zeros((3, 1)), np.zeros(3, np.float32), (0, 0, 0), [[0], 0, 0], "0", {"0": 0}]
    assert len({content_digest(value) for value in values}) == len(values)


@pytest.mark.parametrize(
    ("said", "is_one"),
    [
        ("gelgap: run.json is damaged: delete it\n", True),
        ("gelgap: drawing the report of runs\ngelgap: run.json is damaged: delete it\n", True),
        ("gelgap: run.json is damaged\ngelgap: run.json is damaged: delete it\n", False),
        ("Traceback (most recent call last):\ngelgap: run.json is damaged: delete it\n", False),
        ("gelgap: something is damaged\n", False),
        ("", False),
    ],
)
def test_a_command_on_a_slow_machine_may_say_what_it_does_before_its_sentence(
    said: str, is_one: bool
) -> None:
    assert is_one_sentence(said, "run.json") == is_one
