"""Stopping a real command: what was finished stays, and running it again ends as if nothing had been."""

import json
import subprocess
import time
from dataclasses import astuple
from pathlib import Path

import pytest

from gelgap.assets.checksums import file_sha256, write_checksums
from gelgap.benchmarks.common.records import Ledger
from gelgap.benchmarks.data import interruptions

COMMAND = interruptions.COMMANDS["benchmark physics --quick"]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("interruptions") / "undisturbed"
    assert interruptions.begin(COMMAND, folder, folder).wait(timeout=400) == 0
    return folder


@pytest.mark.parametrize("stopped_by", ["kill -INT", "kill -9"])
def test_a_stopped_benchmark_ends_with_its_workers_and_goes_on(
    stopped_by: str, undisturbed: Path, tmp_path: Path
) -> None:
    place = (COMMAND, undisturbed, tmp_path / "stopped", tmp_path)
    stop = interruptions.stop(*place, interruptions.SIGNALS[stopped_by], until_it_works)
    interrupted = stopped_by == "kill -INT"
    assert stop.phase == "at work"
    assert stop.sentence == interrupted
    # Where its parent is killed while it starts, a worker has Python itself print that the pipe between them broke.
    assert not (interrupted and stop.traceback)
    assert (stop.left_running, stop.failed, stop.different) == (False, False, 0)
    assert stop.parts_again == 0


def until_it_works(child: subprocess.Popen) -> None:
    """Wait until the command has a second process."""
    import psutil

    while child.poll() is None and not psutil.Process(child.pid).children():
        time.sleep(0.01)


def test_what_python_prints_as_it_starts_or_ends_is_not_counted_as_the_commands() -> None:
    stops = [
        interruptions.Stop("starting", False, True, False, 0, 0, False, 0),
        interruptions.Stop("over", False, True, False, 2, 0, False, 0),
        interruptions.Stop("at work", True, False, False, 1, 1, False, 3),
        interruptions.Stop("at work", False, True, True, 0, 0, True, 0),
    ]
    expected = (4, 1, 2, 1, 1, 1, 1, 3, 1, 1, 3)
    assert astuple(interruptions.counted("adapt", "kill -INT", stops)) == ("adapt", "kill -INT", *expected)


def test_a_benchmark_that_was_stopped_goes_on_with_the_next_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(interruptions, "COMMANDS", {"it": interruptions.Stopped("it", lambda *_: [], "*")})
    monkeypatch.setattr(interruptions, "begin", lambda *_: subprocess.Popen(["true"]))
    made: list[int] = []

    def stop(*place: object) -> interruptions.Stop:
        if len(made) == 3:
            raise KeyboardInterrupt
        made.append(place[-2])
        return interruptions.Stop("at work", True, False, False, 1, 0, False, 0)

    monkeypatch.setattr(interruptions, "stop", stop)
    cells = [("it", "kill -INT"), ("it", "kill -9")]
    with pytest.raises(KeyboardInterrupt):
        interruptions.measure_all(tmp_path, cells, 2, Ledger(tmp_path / "notes.jsonl", "plan"))
    again = iter(range(9))
    monkeypatch.setattr(interruptions, "stop", lambda *_: made.append(next(again)) or made_again)
    made_again = interruptions.Stop("at work", False, False, False, 0, 1, False, 0)
    results = interruptions.measure_all(tmp_path, cells, 2, Ledger(tmp_path / "notes.jsonl", "plan"))
    assert [(r.times, r.sentences, r.parts_again) for r in results] == [(2, 2, 0), (2, 1, 1)]


def test_a_list_of_checksums_counts_by_whether_it_is_right(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    digests = []
    for wall_s in (1.0, 2.0):
        (folder / "run.json").write_text(json.dumps({"method": "coral", "wall_s": wall_s}))
        write_checksums(folder, {"run.json": file_sha256(folder / "run.json")})
        digests.append(interruptions.digests(folder))
    assert digests[0] == digests[1]
    (folder / "run.json").write_text(json.dumps({"method": "coral", "wall_s": 3.0}))
    assert interruptions.digests(folder)["SHA256SUMS"] != digests[0]["SHA256SUMS"]


def test_a_changed_byte_is_counted(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "frames-00000.parquet").write_bytes(b"one")
    (folder / "run.jsonl").write_text("a time")
    before = interruptions.digests(folder)
    assert list(before) == ["frames-00000.parquet"]
    (folder / "frames-00000.parquet").write_bytes(b"two")
    assert interruptions.digests(folder) != before
