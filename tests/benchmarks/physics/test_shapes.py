"""The benchmark of shapes: what it compares a press with, and that its rows say what is off."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gelgap.benchmarks.physics.cases import Case
from gelgap.benchmarks.physics.errors import errors, middle_errors, middle_force_n
from gelgap.benchmarks.physics.references import across_cases, shape_cases, solid_cases, surface_cases
from gelgap.sim import Cone, Cylinder, Edge, MembraneState
from gelgap.sim.traction import Traction


def solved_errors(case: Case) -> dict[str, Any]:
    """Solve a case in this process, and return how far it is off its table; every pose converges."""
    solution = case.solve.run()
    solved = SimpleNamespace(states=case.states(solution), solution=solution, core_s=1.0, peak_mib=1.0)
    found = errors(case, solved)
    assert found["unconverged"] == 0
    return found | {"states": solved.states}


def test_the_tables_bodies_are_as_the_tables_say() -> None:
    *round_bodies, lying = shape_cases()
    flat, _, cone = (case.indenter for case in round_bodies)
    assert flat == Cylinder(diameter_mm=3.0, edge_radius_mm=0.2)
    assert cone == Cone(diameter_mm=6.0, half_angle_deg=60.0, tip_radius_mm=0.3)
    assert [case.elastomer.friction for case in round_bodies] == [10.0, 0.0, 10.0]
    assert isinstance(lying.indenter, Edge)
    assert len(lying.truth.profiles) == len(lying.poses) == 4


def test_a_box_that_slides_drags_as_its_table_says() -> None:
    for case in across_cases():
        fx, _, fz = case.truth.force_n.T
        assert (fz < 0).all()
        assert (np.abs(fx) <= case.elastomer.friction * -fz).all()
        assert (np.diff(fx[1:]) > 0).all()
        for pose, (x, _, u_z) in zip(case.poses, case.truth.profiles, strict=True):
            assert u_z[np.abs(x - pose.shear_x_mm).argmin()] == pytest.approx(-pose.depth_mm, abs=2e-3)


def test_a_short_box_and_a_dragged_cylinder_are_near_their_tables(coarse: None) -> None:
    box, cylinder = (replace(case, quality="draft") for case in solid_cases())
    assert 0 < box.truth.uncertainty_percent < 0.5
    for case in (box, cylinder):
        found = solved_errors(case)
        assert found["Fz worst %"] < 8
        assert max(found["u_z rms µm"], found["in-plane rms µm"]) < 10
    assert found["Fx rms %"] < 12


def test_a_press_is_near_its_table() -> None:
    flat = shape_cases()[1]
    found = solved_errors(replace(flat.down_to(flat.poses[0].depth_mm), quality="draft"))
    assert found["Fz worst %"] < 5
    assert found["u_z rms µm"] < 5


def test_the_middle_of_a_long_body_is_measured_per_length() -> None:
    x_mm, y_mm = np.linspace(-3, 3, 61), np.linspace(-2, 2, 41)
    displacement = np.zeros((41, 61, 3), np.float32)
    displacement[..., 2] = -0.01
    state = MembraneState(x_mm, y_mm, displacement, np.zeros((41, 61), bool), np.zeros(3))
    stress = np.zeros((41, 61, 3))
    stress[18:23, :, 2] = -0.2
    found = Traction(state, (0.0, 0.0), stress, np.full((41, 61), 0.01), 0.0)
    assert middle_force_n(found)[2] == pytest.approx(-0.2 * 5 * 0.1)
    profile = np.array([[0.0, 5.0], [0.0, 0.0], [-0.01, -0.01]])
    assert middle_errors(state, profile)["u_z rms µm"] == pytest.approx(0.0, abs=1e-3)


def test_a_ring_shaped_punch_is_near_its_table(coarse: None) -> None:
    ring = next(case for case in surface_cases() if case.name == "ring, frictionless")
    assert 0 < ring.truth.uncertainty_percent < 0.5
    found = solved_errors(replace(ring.down_to(0.3), quality="draft"))
    assert found["Fz worst %"] < 5
    [state] = found["states"]
    share = state.diagnostics.fz_error_n / -state.force_n[2]
    assert found["Fz worst %"] / 200 < share < 0.04
    # A mesh half as fine as `draft`, which has 8 µm.
    assert max(found["u_z rms µm"], found["in-plane rms µm"]) < 14
