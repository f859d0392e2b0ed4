"""The stability benchmark: its scenes stay in the declared box, and its machinery survives crashes and hangs."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from gelgap.benchmarks.physics import stability


def test_scenes_are_reproducible_and_in_the_box():
    drawn = [stability.numbered_case(number, "draft") for number in range(stability.CORNERS, 72)]
    assert drawn[0] == stability.numbered_case(stability.CORNERS, "draft")
    assert {case.indenter.shape for case in drawn} == set(stability.SHAPES)
    assert {len(case.poses) for case in drawn} == {2, 4}  # presses, and those with a slide
    for case in drawn:
        gel, (half, pressed, *slid) = case.elastomer, case.poses
        for value, (low, high) in (
            (gel.young_modulus_mpa, stability.YOUNG_MPA),
            (gel.poisson_ratio, stability.POISSON),
            (gel.friction, stability.FRICTION),
            (gel.thickness_mm, stability.DRAWN_THICKNESS_MM),
        ):
            assert low - 1e-3 <= value <= high + 1e-3
        assert 0 < 2 * half.depth_mm == pressed.depth_mm <= stability.DEEPEST_SHARE * gel.thickness_mm
        assert all(0 < pose.radius_mm <= stability.LONGEST_TRAVEL_MM + 1e-6 for pose in slid)
        assert abs(pressed.point_x_mm) <= 0.35 * gel.pad_size_mm[0] + 1e-3


def test_first_scenes_are_all_corners():
    chosen = [stability.numbered_case(number, "draft") for number in range(stability.CORNERS)]
    assert len({(case.elastomer, case.indenter) for case in chosen}) == stability.CORNERS


def test_forces_that_fall_and_pull_are_told():
    case = stability.numbered_case(0, "draft")  # far from the rim
    assert case.poses[-1].radius_mm > 0

    def told(force_n, converged=True):
        flat = np.zeros((2, 2, 3))
        states = [
            SimpleNamespace(force_n=np.array(force), displacement_mm=flat, converged=converged)
            for force in force_n
        ]
        return list(stability.violations(case, states))

    drags = sum(pose.radius_mm > 0 for pose in case.poses)
    rising = [(0.0, 0.0, -0.1 * (k + 1)) for k in range(len(case.poses) - drags)]
    last = [rising[-1]] * drags
    assert told([*rising, *last]) == []
    assert told([*reversed(rising), *last]) == ["force falls in a press"]
    assert told([*rising[:-1], (0.0, 0.0, 0.1), *last])[0] == "pulls"
    assert told([*reversed(rising), *last], converged=False) == []
    assert "not a number" in told([*rising[:-1], (0.0, 0.0, np.nan), *last], converged=False)


@pytest.mark.parametrize(
    ("module", "limit_s", "failure"),
    [
        (stability.MODULE, 1, "no end within 1 s"),
        ("gelgap.no_such_module", 60, "No module named gelgap.no_such_module"),
        ("json.tool", 60, "ended with code 2"),
    ],
)
def test_a_scene_that_cannot_be_solved_has_a_verdict(monkeypatch, module, limit_s, failure):
    monkeypatch.setitem(stability.TIME_LIMIT_S, "draft", limit_s)
    monkeypatch.setattr(stability, "MODULE", module)
    verdict = stability.judge_apart({"scene": 35, "quality": "draft"})
    assert verdict["status"] == "failed"
    assert failure in verdict["detail"]


def test_summary_counts_by_regime():
    rows = [
        ("converged", (), stability.PAPERS_REGIME, 1.0, 1.0),
        ("flagged", (), stability.BEYOND, 2.0, 1.0),
        ("converged", ("pulls",), stability.BEYOND, 3.0, 1.0),
    ]
    columns = ["status", "violations", "regime", "core_s", "expected_s"]
    scenes, _, violations = stability.tables(pd.DataFrame(rows, columns=columns))
    assert dict(zip(scenes.columns, scenes.cells[0], strict=True))["converged %"] == "100"
    name, *numbers = scenes.cells[-1]
    assert name == "all"
    assert list(map(float, numbers)) == pytest.approx([3, 66.7, 2, 1, 0, 1, 2.0, 2.8, 3.0], abs=0.1)
    assert violations.cells == [["pulls", "1"]]
