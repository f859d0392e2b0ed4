"""The leaderboard: runs of anyone, what is refused and why, and the table."""

import shutil

import numpy as np
import pytest
from run_records import Record, record, write_runs

from gelgap.adapt import ResultTable, split_for_training
from gelgap.adapt.evaluation import evaluate_constant_mean
from gelgap.benchmarks.adaptation import board
from gelgap.benchmarks.adaptation.groups import RULES
from gelgap.benchmarks.adaptation.leaderboard import main, ranked, write_record
from gelgap.benchmarks.adaptation.study import RUNS, Study, grid
from gelgap.domains import ArrayFrames

GROUP = ("wmb0i0", "wmb0i1")


def domain(name: str, seed: int) -> ArrayFrames:
    rng = np.random.default_rng(seed)
    images = rng.integers(0, 255, (40, 48, 64, 3), dtype=np.uint8)
    force_n = rng.uniform((-1, -1, -4), (1, 1, -1), (40, 3))
    points = np.repeat(np.arange(10), 4)
    return ArrayFrames(name, images, images[0], force_n, point_id=points)


@pytest.fixture
def study(tmp_path, monkeypatch):
    """A study of one group and two seeds, in memory."""
    found = {name: domain(name, seed) for seed, name in enumerate(GROUP)}
    monkeypatch.setattr(Study, "domains_of", lambda self, run: [])
    monkeypatch.setattr(
        Study,
        "frames_of",
        lambda self, run: split_for_training(
            found[run["source"]], found[run["target"]], self.profile_of(run), run["seed"]
        ),
    )
    return Study.at(tmp_path / "cpu")


def run_of(study: Study, method: str, seed: int, off_n: float, group=GROUP, **results) -> Record:
    """Return a run that nobody trained, whose predictions are off by as much."""
    (run,) = grid([(board.DATA, group)], ["dan" if "." in method else method], [seed])
    frames = study.frames_of(run)
    found = {
        "when": "2026-11-25",
        "configuration": study.stated_of(run)["configuration"],
        "predicted_n": (frames.target_test.force_n + off_n).astype(np.float32),
        "frames_sha256": {name: part.digest for name, part in frames.parts.items()},
        "constant_mean_n": evaluate_constant_mean(frames.source_train, frames.target_test).mae_n,
        "stage1_sha256": f"weights {seed}",
        "r2": (0.95,) * 3,
    }
    setting, own = record(group, run["method"], off_n, seed, data=board.DATA, **found)
    return setting | {"method": method}, own | results


@pytest.fixture
def folder(study, tmp_path):
    """The records of one who ran source-only, AdaBN and the upper bounds."""
    runs = [
        run_of(study, method, seed, off_n, group)
        for method, off_n, group in (
            ("source-only", 0.5, GROUP),
            ("adabn", 0.3, GROUP),
            ("source-only", 0.05, (GROUP[1],) * 2),
        )
        for seed in (0, 1)
    ]
    write_runs(study.out / RUNS, runs)
    write_record(study, tmp_path / "records", "Ada")
    return tmp_path / "records"


def ranks(table: ResultTable) -> dict[str, dict[str, str]]:
    """Return the rows of methods by name; rules without a network, which stand beside them, apart."""
    rows = {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.cells}
    return {name: row for name, row in rows.items() if name not in RULES}


def mine(
    study: Study, off_n: float = 0.2, seeds=(0, 1), method: str = "mine.Mine", **results
) -> list[Record]:
    return [run_of(study, method, seed, off_n, **results) for seed in seeds]


def test_runs_are_ranked_by_what_they_close(study, folder):
    assert {path.name for path in folder.iterdir()} == {"Ada.jsonl", "Ada"}
    write_runs(folder / "Bob.jsonl", mine(study, settings={"weight": 3}))
    (table,), refused = ranked(folder, study)
    assert refused == {}
    rows = ranks(table)
    assert {row[0] for row in table.cells} == {*rows, *RULES}
    assert list(rows) == ["**mine.Mine**", "adabn", "source-only"]
    # From 0.5 N to 0.05 N.
    assert rows["**mine.Mine**"]["closed"] == "67 %"
    assert rows["**mine.Mine**"]["settings"] == "weight = 3"
    assert rows["source-only"]["closed"] == "0 %"
    assert [rows[name]["who"] for name in rows] == ["Bob", "Ada", "Ada"]
    assert rows["adabn"]["same stage 1"] == rows["adabn"]["same frames"] == "yes"


def test_pictures_of_another_processor_are_ranked_and_said_to_be_others(study, folder):
    """They differ by a code value here and there, so that no byte-wise hash can be asked for."""
    ((_, results), _) = mine(study)
    other = results["frames_sha256"] | {"target_train": "differs"}
    write_runs(folder / "Bob.jsonl", mine(study, frames_sha256=other))
    (table,), refused = ranked(folder, study)
    assert refused == {}
    same = {name: row["same frames"] for name, row in ranks(table).items()}
    assert same == {"**mine.Mine**": "no", "adabn": "yes", "source-only": "yes"}


def test_a_guests_short_source_only_puts_nobody_out(study, folder):
    short = [run_of(study, "source-only", 0, 0.5), *mine(study)]
    write_runs(folder / "Aaron.jsonl", short)
    (folder / "Zoe.jsonl").write_text("")
    (table,), refused = ranked(folder, study)
    assert list(ranks(table)) == ["**mine.Mine**", "adabn", "source-only"]
    assert refused["Zoe.jsonl"] == "holds no run of the groups that are compared"
    assert "has more runs" in refused["Aaron.jsonl: source-only on disjoint contacts"]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"mae_n": (0.001,) * 3}, "it states a mean MAE of 0.0010 N, its predictions have 0.2000 N"),
        ({"mae_n": (float("nan"),) * 3}, "it states a mean MAE of nan N"),
        ({"seeds": (0,)}, "1 runs of the board are missing, 0 are none of it"),
        ({"configuration": "d"}, "is of configuration d, the board's is"),
        (
            {"constant_mean_n": (0.4, 0.4, 0.7)},
            "its frames are others: the source's mean force has a mean MAE of 0.5",
        ),
        ({"frames_sha256": {}}, "lacks 'frames_sha256.source_train'"),
        ({"profile": "smoke"}, "is of profile smoke, the board's is cpu"),
        ({"method": "../x.y"}, "method = '../x.y' is no name"),
        ({"predicted_n": np.zeros((1, 3))}, "no finite prediction for each of the"),
        ({"predicted_n": np.full((8, 3), np.nan)}, "no finite prediction for each of the"),
        ({"predicted_n": None}, "no finite prediction for each of the"),
        ({"off_n": 0.001}, "is below 0.0500 N, the upper bound's"),
        ({"method": "adabn"}, "another record of it has more runs, or was read first"),
    ],
)
def test_what_does_not_hold_is_not_ranked(study, folder, change, reason):
    write_runs(folder / "Bob.jsonl", mine(study, **change))
    (table,), refused = ranked(folder, study)
    method = change.get("method", "mine.Mine")
    assert reason in refused[f"Bob.jsonl: {method} on disjoint contacts"]
    assert list(ranks(table)) == ["adabn", "source-only"]


def test_a_run_that_stands_twice_is_not_ranked(study, folder):
    runs = [(setting | {"copy": copy}, results) for copy in (0, 1) for setting, results in mine(study)]
    write_runs(folder / "Bob.jsonl", runs)
    (table,), refused = ranked(folder, study)
    assert refused == {"Bob.jsonl: mine.Mine on disjoint contacts": "has a run twice"}
    assert len(ranks(table)) == 2


def test_predictions_that_are_gone_are_not_ranked(study, folder):
    shutil.rmtree(folder / "Ada")
    assert ranked(folder, study) == ([], {"Ada.jsonl": "holds no run of the groups that are compared"})


def test_without_source_only_nothing_is_ranked(study, folder, capsys):
    shutil.rmtree(folder)
    write_runs(folder / "Bob.jsonl", mine(study))
    tables, refused = ranked(folder, study)
    assert tables == []
    assert "no record of source-only" in refused["Bob.jsonl: mine.Mine on disjoint contacts"]
    with pytest.raises(SystemExit, match="2"):
        main([str(folder), "--runs", str(study.out), "--out", str(folder / "board.md")])
    assert "holds no record that can be ranked" in capsys.readouterr().err


def test_the_page_names_what_is_not_ranked(study, folder, capsys):
    write_runs(folder / "Bob.jsonl", [*mine(study), *mine(study, method="bad.Bad", profile="smoke")])
    arguments = [str(folder), "--runs", str(study.out), "--out", str(folder / "board.md"), "--write", "--who"]
    main([*arguments, "Ada"])
    text = (folder / "board.md").read_text(encoding="utf-8")
    assert "| **mine.Mine** | 67 % |" in text
    assert "- Bob.jsonl: bad.Bad on disjoint contacts is of profile smoke" in text
    assert (
        "not ranked: Bob.jsonl: bad.Bad on disjoint contacts is of profile smoke" in capsys.readouterr().err
    )
    with pytest.raises(SystemExit, match="2"):
        main([*arguments, "../Ada"])
    assert "--who '../Ada' is no name of a file" in capsys.readouterr().err
