"""The leaderboard: what is trained beside an entry, what has a rank, and what was handed in."""

import json

import numpy as np
import pytest
from run_records import Record, record, rows_of, write_runs

from gelgap.adapt import split_for_training
from gelgap.adapt.evaluation import evaluate_constant_mean
from gelgap.adapt.result_table import ResultTable
from gelgap.benchmarks.adaptation import leaderboard, protocol
from gelgap.benchmarks.adaptation.leaderboard import (
    GROUPS,
    HANDED_IN,
    SEEDS,
    entry_grid,
    handed_in_tables,
    tables,
)
from gelgap.benchmarks.adaptation.protocol import changes_of
from gelgap.benchmarks.adaptation.study import RUNS, Study, grid, load_runs
from gelgap.benchmarks.adaptation.tables import RULES
from gelgap.data import ArrayFrames

TEN_LINES = """
from gelgap.adapt import Method

class MeanMatching(Method):
    def transfer_loss(self, source, target):
        return (source.features.mean(dim=0) - target.features.mean(dim=0)).square().sum()
"""


def domain(name: str, seed: int) -> ArrayFrames:
    rng = np.random.default_rng(seed)
    images = rng.integers(0, 255, (40, 48, 64, 3), dtype=np.uint8)
    force_n = rng.uniform((-1, -1, -4), (1, 1, -1), (40, 3))
    points = np.repeat(np.arange(10), 4)
    return ArrayFrames(name, images, images[0], force_n, point_id=points)


@pytest.fixture
def study(tmp_path, monkeypatch):
    """A study of the leaderboard's domains, in memory."""
    found = {name: domain(name, seed) for seed, name in enumerate(("wmb0i0", "wmb0i1", "wmb0i2"))}
    monkeypatch.setattr(
        Study,
        "frames_of",
        lambda self, run: split_for_training(
            found["wmb0i0"], found[run["target"]], self.profile_of(run), run["seed"]
        ),
    )
    return Study.at(tmp_path / "cpu")


def run_of(study: Study, method: str, seed: int, off_n: float, group=GROUPS[0], **results) -> Record:
    """Return a run that nobody trained, whose predictions are off by as much."""
    changes = results.pop("changes", protocol.BY_POINT)
    (run,) = grid([(protocol.DATA, group)], [method], [seed], changes)
    frames = study.frames_of(run)
    found = {
        "when": "2026-11-25",
        "predicted_n": (frames.target_test.force_n + off_n).astype(np.float32),
        "constant_mean_n": evaluate_constant_mean(frames.source_train, frames.target_test).mae_n,
        "r2": (0.95,) * 3,
    }
    setting, own = record(group, "dan" if "." in method else method, off_n, seed, data=protocol.DATA, **found)
    return setting | {"method": method, "changes": changes}, own | results


def places(study: Study, method: str, off_n: float, groups=GROUPS, seeds=SEEDS, **results) -> list[Record]:
    return [run_of(study, method, seed, off_n, group, **dict(results)) for group in groups for seed in seeds]


@pytest.fixture
def folder(study):
    """Runs of source-only, AdaBN and the upper bounds."""
    own = [(target, target) for _, target in GROUPS]
    for method, off_n, groups in (
        ("source-only", 0.5, GROUPS),
        ("adabn", 0.3, GROUPS),
        ("source-only", 0.05, own),
    ):
        write_runs(study.out / RUNS, places(study, method, off_n, groups))
    return study.out


def trained(folder) -> list[ResultTable]:
    return tables(load_runs(folder / RUNS))


def methods_of(table: ResultTable) -> dict[str, dict[str, str]]:
    """Return the rows of methods; rules without a network, which stand beside them, apart."""
    return {name: row for name, row in rows_of(table).items() if name not in RULES}


def send(folder, name: str, runs: list[Record]) -> None:
    write_runs(folder / HANDED_IN / f"{name}.jsonl", runs)


def test_entries_are_ranked_by_what_they_close(study, folder):
    write_runs(folder / RUNS, places(study, "mine.Mine", 0.2))
    calibrated = changes_of("calibrated")
    write_runs(folder / RUNS, places(study, "mine.Mine", 0.1, changes=calibrated))
    lit = [(protocol.LIKE + target, target) for _, target in GROUPS]
    write_runs(folder / RUNS, places(study, "adabn", 0.15, lit))
    (table,) = trained(folder)
    rows = methods_of(table)
    names = ["**mine.Mine / calibrated**", "adabn / like-target", "**mine.Mine**", "adabn", "source-only"]
    assert list(rows) == names
    # From the constant mean's 0.4 N to 0.05 N.
    assert [rows[name]["closed"] for name in names] == ["86 %", "71 %", "57 %", "29 %", "-29 %"]
    assert [rows[name]["rank mean"] for name in names[:4]] == ["1", "2", "3", "4"]


def test_what_two_equal_runs_differ_by_has_no_order(study, folder):
    write_runs(folder / RUNS, [*places(study, "mine.Mine", 0.2), *places(study, "mine.Twin", 0.201)])
    (table,) = trained(folder)
    rows = methods_of(table)
    assert rows["**mine.Mine**"]["rank mean"] == rows["**mine.Twin**"]["rank mean"] == "1–2"
    assert rows["adabn"]["rank mean"] == "3"


def test_a_seed_more_is_left_out_and_one_less_is_named(study, folder):
    write_runs(folder / RUNS, places(study, "source-only", 0.5, seeds=(2,)))
    write_runs(folder / RUNS, places(study, "mine.Mine", 0.2, seeds=(0, 1, 2)))
    write_runs(folder / RUNS, places(study, "mine.Short", 0.2, seeds=(0,)))
    (table,) = trained(folder)
    assert methods_of(table)["**mine.Mine**"]["closed"] == "57 %"
    assert "Not all runs are finished of mine.Short." in table.note
    assert len(methods_of(table)) == 3


def test_runs_of_other_pictures_are_not_compared(study, folder):
    write_runs(folder / RUNS, places(study, "mine.Mine", 0.2, configuration="of other pictures"))
    with pytest.raises(ValueError, match="wmb0i0 wmb0i1 disjoint pictures, are of more than one"):
        trained(folder)


def test_inputs_that_were_tested_on_other_frames_are_not_compared(study, folder):
    for sha256, changes in (("a", protocol.BY_POINT), ("b", changes_of("calibrated"))):
        tested = {"frames_sha256": {"target_test": sha256}}
        write_runs(folder / RUNS, places(study, "mine.Mine", 0.2, changes=changes, **tested))
    with pytest.raises(ValueError, match="one group and seed were tested on different frames"):
        trained(folder)


def test_what_is_handed_in_has_no_rank_and_displaces_nothing(study, folder):
    """Labels and a little noise would come first; a record of AdaBN would be the published one."""
    write_runs(folder / RUNS, places(study, "mine.Mine", 0.2))
    send(folder, "Bob", places(study, "mine.Mine", 0.06))
    send(folder, "Aaron", [*places(study, "adabn", 0.07), *places(study, "adabn", 0.07, seeds=(7,))])
    (own,), (given,) = trained(folder), handed_in_tables(study)
    assert list(methods_of(own)) == ["**mine.Mine**", "adabn", "source-only"]
    assert methods_of(own)["adabn"]["mean, N"] == "0.300"
    rows = methods_of(given)
    assert {name: row["mean, N"] for name, row in rows.items()} == {
        "mine.Mine (Bob)": "0.060",
        "adabn (Aaron)": "0.070",
    }
    assert "not verified" in given.title
    assert not any(column.startswith("rank") for column in given.columns)


def test_errors_of_what_is_handed_in_are_those_of_its_predictions(study, folder):
    send(folder, "Bob", places(study, "mine.Mine", 0.2, mae_n=(0.001,) * 3))
    (given,) = handed_in_tables(study)
    assert methods_of(given)["mine.Mine (Bob)"]["mean, N"] == "0.200"


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"seeds": (0,)}, "mine.Mine (Bob) lacks 2 of 4 runs"),
        ({"method": "../x.y"}, "Bob holds no predictions of a method"),
        ({"predicted_n": np.zeros((1, 3))}, "no finite prediction for each of the"),
        ({"predicted_n": np.full((8, 3), np.nan)}, "no finite prediction for each of the"),
        ({"predicted_n": None}, "no finite prediction for each of the"),
    ],
)
def test_what_cannot_be_judged_is_named(study, folder, change, reason):
    send(folder, "Bob", places(study, **{"method": "mine.Mine", "off_n": 0.2} | change))
    (given,) = handed_in_tables(study)
    assert reason in given.note
    assert methods_of(given) == {}


def test_a_run_that_stands_twice_is_not_judged(study, folder):
    runs = places(study, "mine.Mine", 0.2)
    send(folder, "Bob", [(setting | {"copy": copy}, own) for copy in (0, 1) for setting, own in runs])
    (given,) = handed_in_tables(study)
    assert "mine.Mine (Bob) has a run twice" in given.note


def test_an_entry_is_trained_beside_its_controls(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(TEN_LINES)
    study = Study.at(tmp_path / "cpu", methods=(f"{tmp_path / 'mine.py'}:MeanMatching",))
    assert study.known_methods() == ("source-only", "adabn", "no-transfer", "mine.MeanMatching")
    did = []
    monkeypatch.setattr(Study, "generate_for", lambda self, runs: None)
    monkeypatch.setattr(Study, "run", lambda self, runs: did.extend(runs))
    leaderboard.measure(
        Study.at(tmp_path / "cpu", methods=study.methods, inputs=("calibrated", "like-target"))
    )
    found: dict[str, set[str]] = {}
    for run in did:
        found.setdefault(protocol.shown_in(run["source"], run["changes"]), set()).add(run["method"])
    every = {*study.known_methods()}
    assert found == {"pictures": {"source-only", "adabn"}, "calibrated": every, "like-target": every}
    bounds = [run for run in did if run["source"] == run["target"]]
    assert len(bounds) == len(GROUPS) * len(SEEDS)
    assert json.loads(json.dumps(bounds[0]))["data"] == protocol.DATA
    (tmp_path / "seer.py").write_text(TEN_LINES + "    uses_target_labels = True\n")
    with pytest.raises(ValueError, match=r"seer\.MeanMatching: it learns from the target's labels"):
        leaderboard.measure(Study.at(tmp_path / "cpu", methods=(f"{tmp_path / 'seer.py'}:MeanMatching",)))
    with pytest.raises(ValueError, match="the leaderboard's sensors have no markers"):
        entry_grid(("adabn",), ("markers",))
