"""The table of what the condensed equation is worth."""

from gelgap.benchmarks.physics.cases import Workers
from gelgap.benchmarks.physics.condensation import cases, measure


def test_the_condensed_solve_changes_nothing_but_time(tmp_path, capsys):
    (found,) = measure(cases(quick=True), Workers(1, tmp_path))
    assert found.iterations > 10
    assert found.core_s > 0
    assert found.ratio > 0
    assert found.force_change < 1e-9
    assert found.membrane_change_mm < 1e-9
    assert "on a condensed equation" in capsys.readouterr().out


def test_full_cases_have_every_shape_of_mesh_at_two_qualities():
    chosen = cases(quick=False)
    assert len({(case.name, case.quality) for case in chosen}) == len(chosen) == 8
