"""The cost of data sets: its tables, the stages of a frame, and the model of how a data set scales."""

from pathlib import Path

import pandas as pd
import pytest

from gelgap.benchmarks import stages, throughput
from gelgap.benchmarks.stages import STAGES, recipes_of, scaling, stages_ms
from gelgap.domains import plan_generation


def test_domains_of_one_gel_are_made_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def run_missing(function, settings, *_, **__):
        asked.extend(settings)
        raise KeyboardInterrupt

    monkeypatch.setattr(throughput, "run_missing", run_missing)
    with pytest.raises(KeyboardInterrupt):
        throughput.run(False, tmp_path)
    assert [setting["domains"] for setting in asked] == [["mb0i0", "wmb0i0"], ["wmb1i1"], ["wmb2i2"]]


def test_each_stage_of_a_frame_is_found_in_its_profile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(stages, "REPEATS", 1)
    monkeypatch.setattr(stages, "POINTS", {"small": (1, 1)})
    plan = plan_generation(recipes_of("small", "draft"))
    for solve in plan.solves.values():
        solve.run()
    ms = stages_ms(plan.batches[0], tmp_path)
    assert ms.keys() == {*STAGES, "labels, rest"}
    assert all(value > 0 for value in ms.values())
    assert ms["labels, rest"] < 0.3 * sum(ms.values())


def test_the_model_of_scaling_is_found_again_from_two_generations():
    start_s, worker_s, client_s = 4.0, 0.012, 0.001
    rows = [(n, 1, start_s + (worker_s + client_s) * n, 2.0 + client_s * n) for n in (128, 1024)]
    times = pd.DataFrame([*rows, (1024, 2, 12.1, 3.0)], columns=["frames", "workers", "wall_s", "client_s"])
    table, _ = scaling(times, 0, pd.Series([30.0, 70.0]))
    modelled = table.set_index("workers")["by the model, s"]
    assert modelled[1] == pytest.approx(times["wall_s"][1])
    assert modelled[2] == pytest.approx(4.0 + 1024 * (0.012 / 2 + 0.001))
    assert modelled[64] == pytest.approx(4.0 + 1024 * (0.012 / 64 + 0.001)), "the client shares nothing"
    assert table["1024 frames measured, s"].dropna().tolist() == pytest.approx([times["wall_s"][1], 12.1])
    # The longest solve is not shared.
    of_paper = table.set_index("workers")["paper's data set by the model, s"]
    assert [of_paper[n] for n in (1, 2, 64)] == pytest.approx([104, 74, 74])


def test_the_frames_taken_apart_need_one_solve_and_the_larger_path_shards_to_share():
    small, large = (plan_generation(recipes_of(size, "draft")) for size in ("small", "large"))
    assert small.solves.keys() == large.solves.keys()
    assert len(large.solves) == 1
    assert len(large.batches) == 4 > len(small.batches)
