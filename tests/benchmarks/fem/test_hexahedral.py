"""The hexahedral drag solver: its derivatives, and its no-slip drag against an independent table."""

import numpy as np
import pytest

from gelgap.benchmarks.fem import hexahedral
from gelgap.benchmarks.fem.hexahedral import Drag, solve_drag
from gelgap.benchmarks.physics.reference import shear_references


@pytest.fixture(scope="module")
def pad():
    return hexahedral._Pad(Drag(element_mm=0.6, sectors=8, pad_radius_mm=5.0, friction=0.3), furthest_mm=0.3)


def test_stiffness_is_the_slope_of_the_internal_forces(pad):
    rng = np.random.default_rng(0)
    u, way = 0.02 * rng.normal(size=pad.size), rng.normal(size=pad.size)
    _, stiffness = pad.assemble(u)
    slope = (pad.assemble(u + 1e-6 * way)[0] - pad.assemble(u - 1e-6 * way)[0]) / 2e-6
    assert np.abs(slope - stiffness @ way).max() < 1e-7 * np.abs(slope).max()


def test_contact_tangent_is_the_slope_of_sticking_and_slipping_forces(pad):
    rng = np.random.default_rng(1)
    u, way = 0.02 * rng.normal(size=pad.size), rng.normal(size=pad.size)
    sphere = np.array([0.05, 0.0, -0.4])
    reach = pad.nodes[pad.surface] - sphere - [0, 0, pad.problem.sphere_radius_mm]
    stick = reach + 0.2 * rng.normal(size=reach.shape) * rng.uniform(size=(len(reach), 1)) ** 4
    touch = hexahedral._touch(pad, u, sphere, stick)
    pushed = touch.push_n > 0
    assert 0 < touch.slipping.sum() < pushed.sum()
    ahead, behind = (hexahedral._touch(pad, u + step * way, sphere, stick).force_n for step in (1e-7, -1e-7))
    expected = -np.einsum("nij,nj->ni", touch.tangent, way[pad.surface_dofs])
    assert np.abs((ahead - behind) / 2e-7 - expected).max() < 1e-5 * np.abs(expected).max()


def test_coarse_drag_without_slip_is_near_the_table():
    reference = next(r for r in shear_references() if r.depth_mm == 0.6)
    (state,) = solve_drag(Drag(element_mm=0.4, sectors=12), (0.6,), step_mm=0.2)
    assert state.force_n[0] == pytest.approx(reference.fx_n[-1], rel=0.05)
    assert state.force_n[2] == pytest.approx(reference.fz_n[-1], rel=0.05)


def test_full_slip_keeps_to_coulombs_cone():
    (state,) = solve_drag(Drag(element_mm=0.5, sectors=8, friction=0.1, depth_mm=0.3), (0.3,), step_mm=0.1)
    # On a cap the ratio of the forces exceeds the coefficient, by far less than its own size when shallow.
    assert 0.1 <= state.force_n[0] / -state.force_n[2] < 0.13


def test_travels_must_rise():
    with pytest.raises(ValueError, match="travels_mm"):
        solve_drag(Drag(), (0.2, 0.1))
