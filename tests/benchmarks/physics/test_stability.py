"""The stability benchmark: its scenes stay in the declared box, and its machinery survives crashes and hangs."""

import json

import pandas as pd
import pytest

from gelgap.benchmarks.physics import stability


def test_scenes_are_reproducible_and_in_the_box():
    for number in range(120):
        scene = stability.numbered_scene(number, "draft")
        assert scene == stability.numbered_scene(number, "draft")
        gel, radius_mm = scene.elastomer, scene.indenter.radius_mm
        for value, (low, high) in (
            (gel.young_modulus_mpa, stability.YOUNG_MPA),
            (gel.poisson_ratio, stability.POISSON),
            (gel.friction, stability.FRICTION),
            (radius_mm, stability.RADIUS_MM),
            (gel.thickness_mm, stability.THICKNESS_MM),
            (scene.step_down_mm, stability.STEP_MM),
        ):
            assert low <= value <= high
        assert 0 < scene.depth_mm <= min(0.4 * gel.thickness_mm, 0.8 * radius_mm) + 1e-6
        assert all(
            abs(at) <= size / 2 for at, size in zip(scene.point_mm, stability.PAD_SIZE_MM, strict=True)
        )
        depths = [pose.depth_mm for pose in scene.poses]
        assert depths == sorted(depths)
        assert depths[-1] == scene.depth_mm


def test_first_scenes_are_all_corners():
    chosen = [stability.numbered_scene(number, "draft") for number in range(stability.CORNERS)]
    corners = {(scene.elastomer, scene.indenter) for scene in chosen}
    assert len(corners) == stability.CORNERS


@pytest.mark.parametrize(
    ("code", "limit_s", "failure"),
    [
        ("import os; os._exit(7)", 60, "ended with code 7"),
        ("import time; time.sleep(60)", 0.1, "no end"),
        ("while True: pass", 1, "no end within 1 s"),
        ("raise ValueError('no good')", 60, "ValueError: no good"),
    ],
)
def test_crash_hang_and_error_become_a_failure(code, limit_s, failure):
    assert failure in stability.run_limited(["-c", code], limit_s)[1]


def test_a_scene_that_cannot_be_solved_has_a_verdict(monkeypatch):
    monkeypatch.setitem(stability.TIME_LIMIT_S, "draft", 0.5)
    verdict = stability.judge_apart({"scene": 35, "quality": "draft"})
    assert verdict["status"] == "failed"
    assert "no end" in verdict["detail"]


def test_summary_counts_by_regime(tmp_path):
    rows = [
        ("converged", (), True, 1.0),
        ("flagged", (), False, 1.0),
        ("converged", ("pulls",), False, 1.0),
    ]
    columns = ["status", "violations", "in_papers_regime", "core_s"]
    stability.summarise(pd.DataFrame(rows, columns=columns), "draft", tmp_path)
    summary = json.loads((tmp_path / "stability-physics-draft.json").read_text())
    assert summary["scenes"][0]["converged %"] == 100
    everything = list(summary["scenes"][-1].values())
    assert everything[1:] == [3, pytest.approx(66.7, abs=0.1), 2, 1, 0, 1]
    assert dict(summary["violations"]) == {"pulls": 1}
