"""What `make demo` says before it installs."""

import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from loaded_file import load_file

SCRIPT = Path(__file__).parents[1] / "scripts/set_up.py"


@pytest.fixture(scope="module")
def set_up() -> ModuleType:
    return load_file(SCRIPT)


def test_the_announcement_names_the_number_the_size_and_the_largest(set_up: ModuleType) -> None:
    packages = {f"p{number}": number * 10**6 for number in range(1, 9)}
    told = set_up.announcement(packages)
    assert told == "to install: 8 packages, 36 MB (p8 8 MB, p7 7 MB, p6 6 MB, p5 5 MB, p4 4 MB, …)"
    assert "at least 36 MB" in set_up.announcement(packages | {"other": None})
    assert set_up.announcement({}) == "to install: 0 packages, 0 MB"


def test_missing_packages_are_those_of_pips_report_with_the_sizes_of_their_files(
    set_up: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "wheel").write_bytes(b"12345")
    urls = {"there": (tmp_path / "wheel").as_uri(), "not-there": (tmp_path / "no wheel").as_uri()}
    entries = [{"metadata": {"name": name}, "download_info": {"url": url}} for name, url in urls.items()]
    program = f"import sys; open(sys.argv[-2], 'w').write({json.dumps({'install': entries})!r})"
    monkeypatch.setattr(set_up, "PIP", (sys.executable, "-c", program))
    assert set_up.missing_packages(["what"]) == {"there": 5, "not-there": None}


def test_a_pip_that_fails_has_the_last_word(
    set_up: ModuleType, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    program = "import sys; print('ERROR: no such version', file=sys.stderr); sys.exit(3)"
    monkeypatch.setattr(set_up, "PIP", (sys.executable, "-c", program))
    with pytest.raises(subprocess.CalledProcessError):
        set_up.main(".[test]")
    assert "ERROR: no such version" in capfd.readouterr().err
