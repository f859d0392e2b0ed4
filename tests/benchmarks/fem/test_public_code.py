"""The check against a public code, as far as it goes without that code."""

import numpy as np
import pytest

from gelgap.benchmarks.fem import public_code


def test_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(public_code, "find_spec", lambda name: None)
    with pytest.raises(SystemExit, match="pip install felupe"):
        public_code.main()


def test_elements_grow_in_a_series_that_fills_the_length() -> None:
    lengths_mm = np.diff(public_code._graded(3.0, 0.05))
    assert lengths_mm.sum() == pytest.approx(3.0)
    assert 0.04 < lengths_mm[0] <= 0.05
    np.testing.assert_allclose(lengths_mm[1:] / lengths_mm[:-1], public_code.GROWTH)


def test_felupe_and_the_projects_solver_agree() -> None:
    pytest.importorskip("felupe")
    press = public_code.Press(poisson_ratio=0.48)
    pad = public_code.PublicPad(press, 0.2)
    force_n = [pad.equilibrium(depth_mm) for depth_mm in (0.05, 0.1, 0.15, 0.2)][-1]
    assert force_n == pytest.approx(public_code.solve_press(press, (0.2,))[0].force_n, rel=0.01)
