"""The stability benchmark: its scenes stay in the declared box, and its machinery survives crashes and hangs."""

import json
import os
import time

import pytest

from gelgap.benchmarks.common.limited_process import run_limited
from gelgap.benchmarks.physics import scenes, stability


def test_scenes_are_reproducible_and_in_the_box():
    for number in range(120):
        scene = scenes.numbered_scene(number, "draft")
        assert scene == scenes.numbered_scene(number, "draft")
        gel, radius_mm = scene.elastomer, scene.indenter.radius_mm
        for value, (low, high) in (
            (gel.young_modulus_mpa, scenes.YOUNG_MPA),
            (gel.poisson_ratio, scenes.POISSON),
            (gel.friction, scenes.FRICTION),
            (radius_mm, scenes.RADIUS_MM),
            (gel.thickness_mm, scenes.THICKNESS_MM),
            (scene.step_down_mm, scenes.STEP_MM),
        ):
            assert low <= value <= high
        assert 0 < scene.depth_mm <= min(0.4 * gel.thickness_mm, 0.8 * radius_mm) + 1e-6
        assert scene.to_rim_mm >= 0
        depths = [pose.depth_mm for pose in scene.poses]
        assert depths == sorted(depths)
        assert depths[-1] == scene.depth_mm


def test_first_scenes_are_all_corners():
    chosen = [scenes.numbered_scene(number, "draft") for number in range(scenes.CORNERS)]
    corners = {(scene.elastomer, scene.indenter) for scene in chosen}
    assert len(corners) == scenes.CORNERS


def test_command_of_a_scene_is_understood_by_press(capsys):
    from gelgap.cli.main import main

    command = scenes.numbered_scene(40, "draft").command().split()
    assert command[:2] == ["gelgap", "press"]
    bad = [*command[1:], "--depth-mm", "-1"]
    with pytest.raises(SystemExit) as stop:
        main(bad)
    assert stop.value.code == 2
    assert "depth_mm" in capsys.readouterr().err


def _crash(_: object) -> None:
    os._exit(7)


def _hang(_: object) -> None:
    time.sleep(60)


def _spin(_: object) -> None:
    while True:
        pass


def _raise(_: object) -> None:
    raise ValueError("no good")


@pytest.mark.parametrize(
    ("function", "limit_s", "failure"),
    [
        (_crash, 60, "ended with code 7"),
        (_hang, 0.1, "no end"),
        (_spin, 1, "no end within 1 s"),
        (_raise, 60, "ValueError: no good"),
    ],
)
def test_crash_hang_and_error_become_an_attempt(function, limit_s, failure):
    assert failure in run_limited(function, None, limit_s).failure


def test_summary_counts_by_regime(tmp_path):
    verdicts = [
        stability.Verdict(0, "converged", (), True, 1.0, "", "gelgap press"),
        stability.Verdict(1, "flagged", (), False, 1.0, "", "gelgap press"),
        stability.Verdict(2, "converged", ("residual 0.5",), False, 1.0, "", "gelgap press"),
    ]
    stability.summarise(verdicts, "draft", tmp_path)
    summary = json.loads((tmp_path / "stability-physics-draft.json").read_text())
    assert summary["rows"][0][2] == 100
    assert summary["rows"][-1][1:] == [3, pytest.approx(66.7, abs=0.1), 2, 1, 0, 1]
    assert dict(summary["violations"]) == {"residual": 1}
