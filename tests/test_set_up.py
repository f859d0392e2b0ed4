"""What `make demo` says before and while it installs."""

import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType

import pytest
from loaded_file import load_file

SCRIPT = Path(__file__).parents[1] / "scripts/set_up.py"


@pytest.fixture(scope="module")
def set_up() -> ModuleType:
    return load_file(SCRIPT)


def test_the_announcement_names_the_number_the_size_and_the_largest(set_up: ModuleType) -> None:
    packages = [set_up.Package(f"p{number}", "1", number * 10**6) for number in range(1, 9)]
    told = set_up.announcement(packages)
    assert told == "to install: 8 packages, 36 MB (p8 8 MB, p7 7 MB, p6 6 MB, p5 5 MB, p4 4 MB, …)"
    assert "at least 36 MB" in set_up.announcement([*packages, set_up.Package("other", "1", None)])
    assert set_up.announcement([]) == "to install: 0 packages, 0 MB"


def test_progress_counts_files_that_pip_fetches_and_then_those_that_lie_in_place(
    set_up: ModuleType, tmp_path: Path
) -> None:
    names = ("a-b", "c", "d")
    progress = set_up.Progress([set_up.Package(name, "1.0", None) for name in names], tmp_path)
    progress.hear("  Installing build dependencies: started\n")
    progress.hear("  Downloading a_b-1.0-py3-none-any.whl.metadata (5 kB)\n")
    assert str(progress).endswith("0 of 3 packages fetched")
    progress.hear("Downloading a_b-1.0-py3-none-any.whl (5 MB)\n")
    progress.hear("  Using cached c-1.0-py3-none-any.whl (5 MB)\n")
    assert str(progress).endswith("2 of 3 packages fetched")
    progress.hear("Installing collected packages: a-b, c, d\n")
    (tmp_path / "a_b-1.0.dist-info").mkdir()
    (tmp_path / "c-0.9.dist-info").mkdir()
    assert str(progress).endswith("1 of 3 packages installed")


def test_looking_up_packages_is_counted_and_told(
    set_up: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asking = set_up.Asking()
    for line in ("Collecting a>=1\n", "  Downloading a-1.whl\n", "Requirement already satisfied: b in /x\n"):
        asking.hear(line)
    monkeypatch.setattr(set_up, "SECONDS_BETWEEN_LINES", 0.001)
    with set_up.told(asking):
        for _ in range(1000):
            if said := capsys.readouterr().out:
                break
            time.sleep(0.01)
    assert said.splitlines()[0].endswith("2 packages looked up")


def test_sizes_are_those_of_the_files_and_unknown_where_there_is_none(
    set_up: ModuleType, tmp_path: Path
) -> None:
    (tmp_path / "wheel").write_bytes(b"12345")
    assert set_up.file_size((tmp_path / "wheel").as_uri()) == 5
    assert set_up.file_size((tmp_path / "no wheel").as_uri()) is None


def test_a_pip_that_fails_has_the_last_word(
    set_up: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program = "import sys; print('Downloading a-1.whl'); print('ERROR: no such version', file=sys.stderr); sys.exit(3)"
    monkeypatch.setattr(set_up, "PIP", (sys.executable, "-c", program))
    heard = []
    with pytest.raises(subprocess.CalledProcessError):
        set_up.run_pip([], heard.append)
    assert "Downloading a-1.whl\n" in heard
    assert "ERROR: no such version" in capsys.readouterr().err
