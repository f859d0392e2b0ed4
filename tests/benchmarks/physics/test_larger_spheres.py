"""A sphere larger than those that meshes are calibrated with, against an outside table."""

from pathlib import Path

import pytest

from gelgap.benchmarks.physics.cases import Workers
from gelgap.benchmarks.physics.larger_spheres import LESS_DEEP_MM, OWN, tabled_sphere
from gelgap.benchmarks.physics.presses import judge_press, press_case

REPOSITORY = Path(__file__).parents[3]


def test_table_of_a_larger_sphere_is_read():
    reference = tabled_sphere()
    assert (reference.indenter_radius_mm, reference.thickness_mm, reference.poisson_ratio) == (4.0, 3.0, 0.49)
    for depth, (r, _, u_z) in zip(reference.depths_mm, reference.profiles, strict=True):
        assert r[0] == 0
        assert u_z[0] == pytest.approx(-depth, abs=2e-3)
    assert reference.force_n[-1] == pytest.approx(-2.463381)


def test_force_and_membrane_of_a_larger_sphere_are_those_of_the_table(tmp_path):
    reference = tabled_sphere()
    (solved,) = Workers(1, tmp_path).solve([press_case(reference, "draft")])
    errors = judge_press(solved, reference)
    assert errors.unconverged == 0
    assert errors.fz_rms_percent < 2
    assert errors.surface.uz_rms_um < 5
    assert errors.surface.in_plane_rms_um < 5


def test_own_pads_reach_far_beyond_the_contact():
    for press, depths_mm in OWN:
        contact_mm = (2 * press.indenter_radius_mm * depths_mm[-1]) ** 0.5
        assert press.pad_radius_mm > 3 * press.thickness_mm + contact_mm


def test_the_guide_has_a_row_of_each_of_the_commands_spheres():
    guide = (REPOSITORY / "docs" / "physics.md").read_text(encoding="utf-8")
    table = guide.partition("### Larger spheres")[2].partition("The target is")[0]
    documented = [
        row.split("|")[3].strip() for row in table.splitlines() if "| table |" in row or "| own |" in row
    ]
    tabled = tabled_sphere().depths_mm
    depths = [tabled, [depth for depth in tabled if depth <= LESS_DEEP_MM], *(depths for _, depths in OWN)]
    assert documented == [f"{first:g}–{last:g}" for first, *_, last in depths if last != 1.33]
    assert "| 0.33 | 0.67 | 1.0 | 1.33 mm |" in guide
