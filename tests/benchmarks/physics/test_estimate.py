"""What the benchmark of estimates measures with: random scenes, rows beside a truth, and how they are counted."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gelgap.benchmarks.physics import estimate
from gelgap.benchmarks.physics.cases import Truth
from gelgap.sim import MembraneState, Sphere
from gelgap.sim.estimate import CAUSES, ERRORS


def test_random_scenes_are_those_of_their_numbers_and_every_third_is_a_drag() -> None:
    cases = [estimate.random_case(number) for number in range(36)]
    assert cases == [estimate.random_case(number) for number in range(36)]
    assert len({case.elastomer.thickness_mm for case in cases}) == 36
    assert [len(case.poses) for case in cases] == [1, 1, 2] * 12
    on_small_pads = [
        number for number, case in enumerate(cases) if case.elastomer.pad_size_mm == (24.0, 20.0)
    ]
    assert on_small_pads == [8, 17, 26, 35]
    for case in cases:
        press, drag = case.poses[0], case.poses[-1]
        assert isinstance(case.indenter, Sphere)
        assert 0.01 <= press.depth_mm <= 0.4 * case.elastomer.thickness_mm + 1e-4
        assert drag.depth_mm == press.depth_mm
        assert drag.radius_mm <= case.indenter.penetration_radius_mm(press.depth_mm) + 1e-3


def test_the_truth_of_a_press_has_its_own_gel_and_elements_as_small_as_its_contact() -> None:
    case = estimate.random_case(2)
    press, depths_mm = estimate.descent_of(case)
    assert depths_mm == (case.poses[0].depth_mm,)
    assert press.energy == "stable"
    assert press.thickness_mm == case.elastomer.thickness_mm
    assert press.element_mm <= 0.1 * case.indenter.penetration_radius_mm(depths_mm[0])


def test_the_table_counts_what_it_says_and_the_plot_shows_it(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    converged, known = [True, True, True, False, True], [True] * 4 + [False]
    rows = pd.DataFrame({"quality": "draft", "converged": converged, "known": known, "coarse": False})
    for error in ERRORS:
        rows[error], rows[f"estimated {error}"] = [0.01, -0.03, 0.001, 0.2, 9.0], 0.01
    table = estimate.calibration_table(rows).set_index("error of")
    assert list(table.index) == list(ERRORS)
    fz = table.loc["Fz"]
    assert (fz["true < 2 estimates, %"], fz["estimate < 4 true, %"]) == (50, 75)
    assert (fz["flagged"], fz["worst unflagged %"]) == (1, 3)
    assert "Estimates of random scenes" in capsys.readouterr().out
    estimate.plot_estimates(rows, tmp_path / "estimates.png")
    assert (tmp_path / "estimates.png").read_bytes().startswith(b"\x89PNG")


def test_rows_of_a_state_beside_itself_have_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(estimate, "causes", lambda *_: np.ones(len(CAUSES)))
    case = estimate.random_case(1)
    state = MembraneState(
        np.linspace(-7, 7, 141),
        np.linspace(-5.5, 5.5, 111),
        np.zeros((111, 141, 3), np.float32),
        np.zeros((111, 141), bool),
        np.array([0.1, 0.0, -0.5]),
        contact_radius_mm=1.0,
    )

    class Found:
        states = (state,)

    flat = np.array([[0.0, 10.0], [0.0, 0.0], [0.0, 0.0]])
    truth = Truth(state.force_n[None], radius_mm=np.ones(1), profiles=(flat,))
    # A finer solve has errors of its own, a true solution has none.
    for known, finer, together in ((truth, None, 1.0), (None, Found, np.sqrt(2))):
        (row,) = estimate.rows_of(case, Found, known, finer)
        assert [row[error] for error in ERRORS] == [0, 0, 0, 0]
        assert [row[cause] for cause in CAUSES] == [together] * len(CAUSES)
