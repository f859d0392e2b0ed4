"""The leaderboard: entries from finished runs, the checks of foreign ones, the table."""

import json
from pathlib import Path

import pytest
from run_records import record, write_runs

from gelgap.benchmarks.adaptation.board import GROUPS
from gelgap.benchmarks.adaptation.groups import SEEDS
from gelgap.benchmarks.adaptation.leaderboard import main, read_entries
from gelgap.benchmarks.adaptation.study import RUNS


@pytest.fixture
def records(tmp_path: Path) -> Path:
    """The records of source-only and of a method of one's own, made from finished runs."""
    runs = tmp_path / "runs"
    places = [(group, seed) for group in GROUPS for seed in SEEDS]
    own = {"r2": (0.5, 0.6, 0.7), "settings": {"transfer_weight": 0.1}}
    found = [record(group, "source-only", 0.3 + 0.01 * seed, seed, r2=own["r2"]) for group, seed in places]
    found += [record(group, "mine.Mine", 0.2, seed, **own) for group, seed in places]
    write_runs(runs / RUNS, [*found, record(GROUPS[0], "dsan", 0.1)])
    main(
        [str(tmp_path / "records"), "--write", str(runs), "--who", "Ada", "--out", str(tmp_path / "board.md")]
    )
    return tmp_path / "records"


def changed(path: Path, **fields) -> None:
    content = json.loads(path.read_text())
    path.write_text(json.dumps({**content, **fields}))


def test_finished_methods_are_in_the_table_and_others_are_not(records, capsys):
    assert {path.name for path in records.iterdir()} == {"source-only-paired.json", "mine.Mine-paired.json"}
    text = (records.parent / "board.md").read_text(encoding="utf-8")
    first, second = (line for line in text.splitlines() if line.startswith("| ") and "Ada" in line)
    assert first.startswith(
        "| **mine.Mine** | 0.200 | 0.200…0.200 | 0.50 | 0.60 | 0.70 | 1.0 | transfer_weight"
    )
    assert second.startswith("| source-only | 0.320 | ")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda runs: {"speed": 3}, "speed: extra inputs are not permitted"),
        (lambda runs: {"runs": runs[1:]}, "runs: 1 of 45 are missing, the first is mb0i0 → wmb0i0, seed 0"),
        (lambda runs: {"runs": [*runs, runs[0]]}, "runs: there are 46, needed are 45"),
        (
            lambda runs: {"runs": [{**runs[0], "configuration": "d"}, *runs[1:]]},
            r"seed 0, is of configuration cpu d, source-only's is cpu c; only runs of one profile",
        ),
        (lambda runs: {"profile": "smoke"}, "is of configuration smoke c"),
        (
            lambda runs: {"runs": [{**runs[0], "mae_n": [-1, 0, 0]}, *runs[1:]]},
            "mae_n.0 = -1: input should be greater than or equal to 0",
        ),
        (lambda runs: {"method": "../x"}, "method = '../x' is no name"),
    ],
)
def test_a_wrong_record_is_one_sentence(records, capsys, change, sentence):
    path = records / "mine.Mine-paired.json"
    changed(path, **change(json.loads(path.read_text())["runs"]))
    with pytest.raises(ValueError, match=sentence):
        read_entries(records)
    with pytest.raises(SystemExit, match="2"):
        main([str(records), "--out", str(records.parent / "board.md")])
    said = capsys.readouterr().err
    assert "mine.Mine-paired.json" in said
    assert said.count("\n") == 1


def test_what_is_no_record_or_has_nothing_to_be_held_against(records, tmp_path):
    (records / "source-only-paired.json").unlink()
    with pytest.raises(ValueError, match="lacks the record of source-only, paired"):
        read_entries(records)
    (records / "mine.Mine-paired.json").write_text("[]")
    with pytest.raises(ValueError, match=r"mine.Mine-paired.json: "):
        read_entries(records)
    with pytest.raises(ValueError, match="holds no records of the leaderboard"):
        read_entries(tmp_path / "empty")
