"""The benchmarks of data: what a stopped one has measured is not lost, and gels are kept apart."""

import json
from pathlib import Path

import pytest

from gelgap.benchmarks.common.records import Ledger
from gelgap.benchmarks.data import throughput
from gelgap.benchmarks.data.estimates import ToldTimeLeft
from gelgap.domains import preset_recipes


def test_an_interrupted_generation_is_noted_and_another_plan_starts_anew(tmp_path: Path, monkeypatch):
    path = tmp_path / "unfinished.jsonl"
    recipes = preset_recipes("smoke", quality="draft")[:1]

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(throughput, "generate_recipes", interrupted)
    ledger = Ledger(path, ["smoke"])
    assert not ledger.found
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            throughput.generation("mb0i0", recipes, tmp_path / "data", 1, ledger)
    again = Ledger(path, ["smoke"])
    assert again.found
    assert len(again.values("mb0i0", throughput.Piece)) == 2
    assert all(piece.wall_s > 0 for piece in again.values("mb0i0", throughput.Piece))
    again.close()
    assert not path.exists()
    Ledger(path, ["smoke"]).note("mb0i0", 1.0)
    assert not Ledger(path, ["paper"]).found
    assert not path.exists()


def test_domains_of_one_gel_are_made_together():
    groups = throughput.by_gel(preset_recipes("paper"))
    assert [[recipe.name for recipe in group] for group in groups] == [
        ["mb0i0", "wmb0i0"],
        ["wmb1i1"],
        ["wmb2i2"],
    ]


def test_a_damaged_ledger_starts_anew(tmp_path: Path):
    path = tmp_path / "unfinished.jsonl"
    path.write_text(json.dumps({"plan": ["smoke"]})[:-3])
    assert not Ledger(path, ["smoke"]).found


def test_a_measurement_is_done_once(tmp_path: Path):
    calls = []

    def measure() -> list[throughput.Rate]:
        calls.append(1)
        return [throughput.Rate("in order", 400.0, 150), throughput.Rate("at random", 300.0)]

    for _ in range(2):
        ledger = Ledger(tmp_path / "unfinished.jsonl", ["smoke"])
        found = ledger.once("reading", list[throughput.Rate], measure)
        assert found == [throughput.Rate("in order", 400.0, 150), throughput.Rate("at random", 300.0)]
    assert len(calls) == 1


def test_the_told_time_left_is_compared_with_what_was_left() -> None:
    told = ToldTimeLeft()
    told.told = [(1.0, 90.0), (30.0, 35.0), (50.0, 60.0), (100.0, 1.0)]
    assert told.worst_ratio() == pytest.approx(70 / 35)
