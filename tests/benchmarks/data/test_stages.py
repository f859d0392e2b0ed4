"""The table of cost: its stages, its floors, and the model of how a data set scales."""

from pathlib import Path

import pytest

from gelgap.benchmarks.data.stages import (
    STAGES,
    Generated,
    Scaling,
    fitted,
    floors_ms,
    recipes_of,
    small_solve,
    stages_ms,
)
from gelgap.domains import plan_generation


def test_each_stage_of_a_frame_is_found_in_its_profile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path / "cache"))
    plan = plan_generation(recipes_of("small", "draft"))
    small_solve(plan)
    ms = stages_ms(plan.batches[0], tmp_path)
    assert ms.keys() == {*STAGES, "labels, rest"}
    assert all(value > 0 for value in ms.values())
    assert ms["labels, rest"] < 0.3 * sum(ms.values())


def test_the_model_of_scaling_is_found_again_from_two_generations():
    start_s, worker_s, client_s = 4.0, 0.012, 0.001
    small, large = (
        Generated(n, 1, start_s + (worker_s + client_s) * n, 2.0 + client_s * n) for n in (128, 1024)
    )
    alone = fitted(small, large)
    assert alone.wall_s(1) == pytest.approx(large.wall_s)
    assert alone.wall_s(2) == pytest.approx(4.0 + 1024 * (0.012 / 2 + 0.001))
    assert alone.wall_s(10**6) == pytest.approx(4.0 + 1024 * 0.001, rel=1e-3), "the client shares nothing"


def test_the_longest_solve_is_not_shared():
    scaling = Scaling(start_s=1, frames_s=0, client_s=0, solves_s=100, longest_solve_s=30)
    assert [scaling.wall_s(workers) for workers in (1, 2, 4, 64)] == [101, 51, 31, 31]


def test_the_frames_taken_apart_need_one_solve_and_the_larger_path_shards_to_share():
    small, large = (plan_generation(recipes_of(size, "draft")) for size in ("small", "large"))
    assert small.solves.keys() == large.solves.keys()
    assert len(large.solves) == 1
    assert len(large.batches) == 4 > len(small.batches)


def test_floors_are_of_known_stages_and_take_time(tmp_path: Path):
    floors = floors_ms(recipes_of("small", "draft")[0], tmp_path)
    assert floors.keys() <= STAGES.keys()
    assert all(floor_ms > 0 for floor_ms, _ in floors.values())
