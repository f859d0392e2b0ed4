"""The cost of data sets: the stages of a frame."""

from dataclasses import replace
from pathlib import Path

import pytest

from gelgap.benchmarks import throughput
from gelgap.benchmarks.throughput import STAGES, apart_recipes, stages_ms
from gelgap.domains import plan_generation


def test_each_stage_of_a_frame_is_found_in_its_profile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(throughput, "REPEATS", 1)
    plan = plan_generation(apart_recipes("draft"))
    (solve,) = plan.solves.values()
    solve.run()
    batch = plan.batches[0]
    ms = stages_ms(replace(batch, contacts=batch.contacts.part(0, 17)), tmp_path)
    assert ms.keys() == {*STAGES, "labels, rest"}
    assert all(value > 0 for value in ms.values())
    assert ms["labels, rest"] < 0.3 * sum(ms.values())
