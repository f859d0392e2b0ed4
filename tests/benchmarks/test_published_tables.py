"""Tables of docs/results are what their commands print of the committed records; scripts have a --help."""

import re
import runpy
import sys
from pathlib import Path

import pytest

from gelgap.benchmarks.common import read_records

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs" / "results"
INDEX = "README.md"
"""Its table has the questions."""
COMMAND = re.compile(
    r"^python -m gelgap\.(benchmarks\.\S+) --table docs/results/(records/\S+\.jsonl)$", re.MULTILINE
)
TABLE = re.compile(r"(?:^\|.*\n)+", re.MULTILINE)
MOST_WORDS, MOST_OTHER_FILES = 6000, 25
PAGES = {page.name: page.read_text(encoding="utf-8") for page in sorted(RESULTS.glob("*.md"))}
WITH_TABLES = [name for name, text in PAGES.items() if TABLE.search(text) and name != INDEX]
SCRIPTS = [
    script
    for script in sorted((ROOT / "benchmarks").rglob("*.py"))
    if "--table" in (text := script.read_text(encoding="utf-8")) and '__name__ == "__main__"' in text
]


def run_script(script: Path, arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a file as `python -m` does, in this process."""
    monkeypatch.setattr(sys, "argv", [str(script), *arguments])
    runpy.run_path(str(script), run_name="__main__")


@pytest.mark.parametrize("name", WITH_TABLES)
def test_a_published_table_is_what_its_command_prints(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ((module, records),) = COMMAND.findall(PAGES[name])
    script = ROOT.joinpath(*module.split(".")).with_suffix(".py")
    run_script(script, ["--table", str(RESULTS / records)], monkeypatch)
    printed = TABLE.findall(capsys.readouterr().out)
    assert [table for table in TABLE.findall(PAGES[name]) if table not in printed] == []


def test_every_file_of_records_makes_a_table_and_can_be_read() -> None:
    named = {records for text in PAGES.values() for _, records in COMMAND.findall(text)}
    others = {str(file.relative_to(RESULTS)) for file in RESULTS.rglob("*") if file.is_file()} - set(PAGES)
    assert others == named
    assert len(others) <= MOST_OTHER_FILES
    for records in named:
        lines = (RESULTS / records).read_text(encoding="utf-8").splitlines()
        assert len(read_records(RESULTS / records)) == len(lines) > 0


def test_results_stay_short() -> None:
    assert sum(len(text.split()) for text in PAGES.values()) <= MOST_WORDS


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_script_says_what_it_takes(
    script: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        run_script(script, ["--help"], monkeypatch)
    assert end.value.code == 0
    assert "--table" in capsys.readouterr().out
