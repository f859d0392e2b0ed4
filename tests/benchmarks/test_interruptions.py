"""Stopping a real command: what was finished stays, and running it again ends as if nothing had been."""

from pathlib import Path

import pytest

from gelgap.benchmarks.data import interruptions

COMMAND = interruptions.COMMANDS["benchmark physics --quick"]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("interruptions") / "undisturbed"
    assert interruptions.begin(COMMAND, folder, folder).wait(timeout=120) == 0
    return folder


@pytest.mark.parametrize("stopped_by", ["kill -INT", "kill -9"])
def test_a_stopped_benchmark_ends_with_its_workers_and_goes_on(
    stopped_by: str, undisturbed: Path, tmp_path: Path
) -> None:
    place = (COMMAND, undisturbed, tmp_path / "stopped", tmp_path, 2.0)
    result = interruptions.measure(*place, stopped_by, interruptions.SIGNALS[stopped_by], 1)
    assert result.still_at_work == 1
    assert result.sentences == (stopped_by == "kill -INT")
    assert (result.tracebacks, result.left_running, result.failed, result.different) == (0, 0, 0, 0)
    assert result.parts_again == 0


def test_a_changed_byte_is_counted(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "frames-00000.parquet").write_bytes(b"one")
    (folder / "run.jsonl").write_text("a time")
    before = interruptions.digests(folder)
    assert list(before) == ["frames-00000.parquet"]
    (folder / "frames-00000.parquet").write_bytes(b"two")
    assert interruptions.digests(folder) != before
