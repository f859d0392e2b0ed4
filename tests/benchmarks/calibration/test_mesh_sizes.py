"""The study of meshes solves a table's press on any mesh, and judges it."""

from gelgap.benchmarks.calibration.mesh_sizes import Trial, press
from gelgap.sim.problem import QUALITIES


def test_a_coarse_mesh_is_solved_and_compared_with_the_table():
    errors = press(Trial("draft", "nh49_no_slip", QUALITIES["draft"].disc))
    assert errors.unconverged == 0
    assert len(errors.fz_percent) == 5
    assert errors.fz_worst_percent < 6
    assert errors.surface.peak_um > 20
