"""The stability benchmark: its scenes stay in the declared box, and its machinery survives crashes and hangs."""

import json
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from gelgap.benchmarks.physics import stability


def test_scenes_are_reproducible_and_in_the_box():
    for number in range(120):
        case = stability.numbered_case(number, "draft")
        assert case == stability.numbered_case(number, "draft")
        gel, radius_mm, last = case.elastomer, case.indenter.radius_mm, case.poses[-1]
        for value, (low, high) in (
            (gel.young_modulus_mpa, stability.YOUNG_MPA),
            (gel.poisson_ratio, stability.POISSON),
            (gel.friction, stability.FRICTION),
            (radius_mm, stability.RADIUS_MM),
            (gel.thickness_mm, stability.THICKNESS_MM),
        ):
            assert low <= value <= high
        assert 0 < last.depth_mm <= min(0.4 * gel.thickness_mm, 0.8 * radius_mm) + 1e-6
        assert 0 < last.radius_mm <= min(gel.thickness_mm, radius_mm) + 1e-6
        assert abs(last.point_x_mm) <= stability.PAD_SIZE_MM[0] / 2
        assert abs(last.point_y_mm) <= stability.PAD_SIZE_MM[1] / 2
        depths = [pose.depth_mm for pose in case.poses]
        assert depths == sorted(depths)


def test_first_scenes_are_all_corners():
    chosen = [stability.numbered_case(number, "draft") for number in range(stability.CORNERS)]
    assert len({(case.elastomer, case.indenter) for case in chosen}) == stability.CORNERS


def test_forces_that_fall_and_pull_are_told():
    case = stability.numbered_case(0, "draft")  # far from the rim
    assert case.poses[-1].radius_mm > 0

    def told(force_n, converged=True):
        states = [SimpleNamespace(force_n=np.array(force), converged=converged) for force in force_n]
        return list(stability.violations(case, states))

    drags = sum(pose.radius_mm > 0 for pose in case.poses)
    rising = [(0.0, 0.0, -0.1 * (k + 1)) for k in range(len(case.poses) - drags)]
    last = [rising[-1]] * drags
    assert told([*rising, *last]) == []
    assert told([*reversed(rising), *last]) == ["force falls in a press"]
    assert told([*rising[:-1], (0.0, 0.0, 0.1), *last])[0] == "pulls"
    assert told([*reversed(rising), *last], converged=False) == []


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


def test_summary_counts_by_regime(tmp_path):
    rows = [
        ("converged", (), stability.PAPERS_REGIME, 1.0),
        ("flagged", (), stability.BEYOND, 1.0),
        ("converged", ("pulls",), stability.BEYOND, 1.0),
    ]
    columns = ["status", "violations", "regime", "core_s"]
    stability.summarise(pd.DataFrame(rows, columns=columns), tmp_path / "summary.json")
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["scenes"][0]["converged %"] == 100
    everything = list(summary["scenes"][-1].values())
    assert everything == ["all", 3, pytest.approx(66.7, abs=0.1), 2, 1, 0, 1]
    assert dict(summary["violations"]) == {"pulls": 1}
