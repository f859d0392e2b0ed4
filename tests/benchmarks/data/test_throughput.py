"""The throughput benchmark's bookkeeping: what an interrupted run has taken is not lost, and gels are kept apart."""

import json
from pathlib import Path

import pytest

from gelgap.benchmarks.data import throughput
from gelgap.benchmarks.data.throughput import RunLedger
from gelgap.domains import preset_recipes


def test_an_interrupted_run_is_noted_and_another_plan_starts_anew(tmp_path: Path, monkeypatch):
    path = tmp_path / "unfinished.json"
    recipes = preset_recipes("smoke", quality="draft")[:1]

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(throughput, "generate_recipes", interrupted)
    ledger = RunLedger(path, ["smoke"])
    assert not ledger.found
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            throughput._generation("mb0i0", recipes, tmp_path / "data", 1, ledger)
    again = RunLedger(path, ["smoke"])
    assert again.found
    assert again.taken("mb0i0").pieces == 2
    assert again.taken("mb0i0").wall_s > 0
    assert not RunLedger(path, ["paper"]).found
    again.close()
    assert not path.exists()


def test_domains_of_one_gel_are_made_together():
    groups = throughput._by_gel(preset_recipes("paper"))
    assert [[recipe.name for recipe in group] for group in groups] == [
        ["mb0i0", "wmb0i0"],
        ["wmb1i1"],
        ["wmb2i2"],
    ]


def test_a_damaged_ledger_starts_anew(tmp_path: Path):
    path = tmp_path / "unfinished.json"
    path.write_text(json.dumps({"plan": ["smoke"]})[:-3])
    assert not RunLedger(path, ["smoke"]).found
