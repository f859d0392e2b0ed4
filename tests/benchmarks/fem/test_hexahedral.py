"""The hexahedral drag solver: its derivatives, and its no-slip drag against an independent table."""

import numpy as np
import pytest

from gelgap.benchmarks.fem.hexahedral import Drag, half_pad, solve_drag
from gelgap.benchmarks.fem.indentation import SphereContact
from gelgap.benchmarks.physics.references import drag_cases


@pytest.fixture(scope="module")
def pad():
    return half_pad(Drag(element_mm=0.6, sectors=8, pad_radius_mm=5.0), furthest_mm=0.3)


def test_stiffness_is_the_slope_of_the_internal_forces(pad):
    rng = np.random.default_rng(0)
    u, direction = 0.02 * rng.normal(size=pad.size), rng.normal(size=pad.size)
    _, stiffness = pad.assemble(u)
    slope = (pad.assemble(u + 1e-6 * direction)[0] - pad.assemble(u - 1e-6 * direction)[0]) / 2e-6
    assert np.abs(slope - stiffness @ direction).max() < 1e-7 * np.abs(slope).max()


def test_contact_tangent_is_the_slope_of_sticking_and_slipping_forces(pad):
    rng = np.random.default_rng(1)
    contact = SphereContact(radius_mm=1.5, friction=0.3, penalty=300.0, stick_stiffness=150.0)
    rest = pad.nodes[pad.surface]
    u, direction = (0.02 * rng.normal(size=pad.size), rng.normal(size=pad.size))
    displaced, direction = rest + u[pad.surface_dofs], direction[pad.surface_dofs]
    sphere = np.array([0.05, 0.0, -0.4])
    from_centre = rest - sphere - [0, 0, contact.radius_mm]
    stick = from_centre + 0.2 * rng.normal(size=rest.shape) * rng.uniform(size=(len(rest), 1)) ** 4

    def touch(step: float):
        return contact.touch(displaced + step * direction, pad.surface_area_mm2, sphere, stick)

    pushed = touch(0.0).pressure_mpa > 0
    assert 0 < touch(0.0).slipping.sum() < pushed.sum()
    slope = (touch(1e-7).force_n - touch(-1e-7).force_n) / 2e-7
    expected = -np.einsum("nij,nj->ni", touch(0.0).tangent, direction)
    assert np.abs(slope - expected).max() < 1e-5 * np.abs(expected).max()


def test_coarse_drag_without_slip_is_near_the_table():
    case = next(
        case for case in drag_cases() if case.truth.source == "table" and case.poses[0].depth_mm == 0.6
    )
    expected = case.truth.force_n[-1]
    (state,) = solve_drag(Drag(element_mm=0.4, sectors=12), (0.6,), step_mm=0.2)
    assert state.force_n[0] == pytest.approx(expected[0], rel=0.05)
    assert state.force_n[2] == pytest.approx(expected[2], rel=0.05)


def test_full_slip_keeps_to_coulombs_cone():
    (state,) = solve_drag(Drag(element_mm=0.5, sectors=8, friction=0.1, depth_mm=0.3), (0.3,), step_mm=0.1)
    assert state.sticking_fraction < 0.05
    # On a cap the ratio of the forces exceeds the coefficient, by far less than its own size when shallow.
    assert 0.1 <= state.force_n[0] / -state.force_n[2] < 0.13


def test_travels_must_rise():
    with pytest.raises(ValueError, match="travels_mm"):
        solve_drag(Drag(), (0.2, 0.1))
