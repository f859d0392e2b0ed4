"""The leaderboard: records of finished runs, what is refused and why, and the table."""

import json
from pathlib import Path

import numpy as np
import pytest
from run_records import record, write_runs

from gelgap.adapt import split_for_training
from gelgap.assets.array_file import read_arrays
from gelgap.benchmarks.adaptation import designs
from gelgap.benchmarks.adaptation.leaderboard import OWN, main, ranked, write_records
from gelgap.benchmarks.adaptation.study import RUNS, Study, grid
from gelgap.domains import ArrayFrames

GROUP = ("wmb0i0", "wmb0i1")
FORMER = Path(__file__).parents[3] / "docs" / "results" / "records"


def domain(name: str, seed: int) -> ArrayFrames:
    rng = np.random.default_rng(seed)
    images = rng.integers(0, 255, (40, 48, 64, 3), dtype=np.uint8)
    force_n = rng.uniform((-1, -1, -4), (1, 1, -1), (40, 3))
    points = np.repeat(np.arange(10), 4)
    return ArrayFrames(name, images, images[0], force_n, point_id=points)


@pytest.fixture
def study(tmp_path, monkeypatch):
    """A study of one group and two seeds, in memory, with runs that nobody trained."""
    found = {name: domain(name, seed) for seed, name in enumerate(("wmb0i0", "wmb0i1"))}
    monkeypatch.setattr(Study, "domains_of", lambda self, run: [])
    monkeypatch.setattr(
        Study,
        "frames_of",
        lambda self, run: split_for_training(
            found[run["source"]], found[run["target"]], self.profile_of(run), run["seed"]
        ),
    )
    study = Study.at(tmp_path / "cpu")
    records = []
    for method, noise_n in (("source-only", 0.5), ("adabn", 0.3), ("mine.Mine", 0.2), (OWN, 0.05)):
        for seed in (0, 1):
            group = (GROUP[1],) * 2 if method == OWN else GROUP
            (run,) = grid(
                [(designs.DATA, group)],
                ["source-only" if method == OWN else method.replace("mine.Mine", "coral")],
                [seed],
            )
            frames = study.frames_of(run)
            true_n = frames.target_test.force_n
            predicted = (true_n + noise_n).astype(np.float32)
            setting, results = record(
                group,
                run["method"],
                noise_n,
                seed,
                data=designs.DATA,
                configuration=study.stated_of(run)["configuration"],
            )
            results |= {
                "predicted_n": predicted,
                "frames_sha256": {name: part.digest for name, part in frames.parts.items()},
                "stage1_sha256": f"weights {seed}",
                "r2": (0.95,) * 3,
            }
            records.append(
                (setting | {"method": "mine.Mine" if method == "mine.Mine" else run["method"]}, results)
            )
    write_runs(study.out / RUNS, records)
    return study


@pytest.fixture
def folder(study, tmp_path):
    write_records(study, tmp_path / "records", "Ada")
    return tmp_path / "records"


def rewrite(path: Path, arrays: dict | None = None, **fields) -> None:
    """Change a record's statements, or its predictions."""
    found = read_arrays(path)
    stated = json.loads(found["record"].tobytes())
    stated |= {name: value(stated) if callable(value) else value for name, value in fields.items()}
    found["record"] = np.frombuffer(json.dumps(stated).encode(), np.uint8)
    np.savez_compressed(path, **(found | (arrays or {})))


def test_records_are_ranked_by_what_they_close(study, folder):
    assert {path.name for path in folder.iterdir()} == {
        f"{name}-disjoint.npz" for name in ("source-only", "adabn", "mine.Mine", OWN)
    }
    (table,), refused = ranked(folder, study)
    assert refused == {}
    rows = {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.cells}
    assert list(rows) == ["**mine.Mine**", "adabn", "source-only"]
    # From 0.5 N to 0.05 N.
    assert rows["**mine.Mine**"]["closed"] == "67 %"
    assert rows["source-only"]["closed"] == "0 %"
    assert rows["adabn"]["who"] == "Ada"
    assert rows["adabn"]["same stage 1"] == "yes"


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (
            {"runs": lambda record: [{**run, "mae_n": [0.001] * 3} for run in record["runs"]]},
            "it states a mean MAE of 0.0010 N, its predictions have 0.2000 N",
        ),
        ({"runs": lambda record: record["runs"][:1]}, "1 runs of the board are missing, 0 are none of it"),
        ({"runs": lambda record: [record["runs"][0]] * 2}, "has a run twice"),
        (
            {"runs": lambda record: [{**run, "configuration": "d"} for run in record["runs"]]},
            "is of configuration d, the board's is",
        ),
        (
            {"runs": lambda record: [{**run, "frames_sha256": {}} for run in record["runs"]]},
            "its source train frames are not those of the board's data",
        ),
        ({"profile": "smoke"}, "is of profile smoke, the board's is cpu"),
        ({"method": "../x"}, "method = '../x' is no name"),
        ({"speed": 3}, "is no record: speed: extra inputs are not permitted"),
        ({"arrays": {"predicted_n_0": np.zeros((1, 3))}}, "no finite prediction for each of the"),
        ({"arrays": {"predicted_n_1": np.full((8, 3), np.nan)}}, "no finite prediction for each of the"),
    ],
)
def test_what_does_not_hold_is_not_ranked(study, folder, change, reason):
    rewrite(folder / "mine.Mine-disjoint.npz", **change)
    (table,), refused = ranked(folder, study)
    assert reason in refused["mine.Mine-disjoint.npz"]
    assert [row[0] for row in table.cells] == ["adabn", "source-only"]


def test_an_invented_record_is_not_ranked(study, folder):
    """Errors alone, or predictions better than the target's own labels give."""
    (folder / "best.json").write_text(json.dumps({"method": "best", "mae_n": 0.001}))
    path = folder / "mine.Mine-disjoint.npz"
    stated = json.loads(read_arrays(path)["record"].tobytes())
    arrays = {}
    for k, run in enumerate(stated["runs"]):
        (setting,) = grid([(designs.DATA, GROUP)], ["coral"], [run["seed"]])
        arrays[f"predicted_n_{k}"] = (study.frames_of(setting).target_test.force_n + 0.001).astype(np.float32)
    runs = [{**run, "mae_n": [0.001] * 3} for run in stated["runs"]]
    rewrite(path, arrays, runs=runs)
    _, refused = ranked(folder, study)
    assert "has no predictions" in refused["best.json"]
    assert "is below 0.0500 N, the ceiling's" in refused[path.name]


def test_without_source_only_nothing_is_ranked(study, folder, capsys):
    (folder / "source-only-disjoint.npz").unlink()
    tables, refused = ranked(folder, study)
    assert tables == []
    assert "no record of source-only" in refused["adabn-disjoint.npz"]
    with pytest.raises(SystemExit, match="2"):
        main([str(folder), "--runs", str(study.out), "--out", str(folder / "board.md")])
    assert "holds no record that can be ranked" in capsys.readouterr().err


def test_the_page_names_what_is_not_ranked(study, folder, capsys):
    rewrite(folder / "adabn-disjoint.npz", profile="smoke")
    main([str(folder), "--runs", str(study.out), "--out", str(folder / "board.md")])
    text = (folder / "board.md").read_text(encoding="utf-8")
    assert "| **mine.Mine** | 67 % |" in text
    assert "- `adabn-disjoint.npz` is of profile smoke" in text
    assert "not ranked: adabn-disjoint.npz" in capsys.readouterr().err
