"""The audit's forces against the derivative of its energy, and its verdicts on states that are known."""

import numpy as np
import pytest

from gelgap.sim.audit import audit_contact, elastic_state
from gelgap.sim.indenter import Sphere
from gelgap.sim.mesh import DiscGrid, pad_mesh
from gelgap.sim.scene import Moduli

MODULI = Moduli(0.3, 0.45)


@pytest.fixture(scope="module")
def mesh():
    grid = DiscGrid(2.0, 1.0, 0.9, 4)
    return pad_mesh(grid, np.array([0.0, -0.5, -1.0]), (-1.0, 1.0, -1.0, 1.0), symmetric=False)


def test_forces_are_the_derivative_of_the_energy(mesh):
    rng = np.random.default_rng(1)
    positions = mesh.vertices_mm + 0.03 * rng.standard_normal(mesh.vertices_mm.shape)
    way = rng.standard_normal(positions.shape)
    step = 1e-6
    energies = (
        elastic_state(mesh.vertices_mm, mesh.tetrahedra, positions + sign * step * way, MODULI).energy_mj
        for sign in (1, -1)
    )
    slope = np.subtract(*energies) / (2 * step)
    force = elastic_state(mesh.vertices_mm, mesh.tetrahedra, positions, MODULI).holding_force_n
    assert (force * way).sum() == pytest.approx(slope, rel=1e-6)


def test_uniform_stretch_has_the_stress_of_linear_elasticity(mesh):
    strain = 1e-6
    state = elastic_state(mesh.vertices_mm, mesh.tetrahedra, mesh.vertices_mm * [1, 1, 1 + strain], MODULI)
    young, poisson = MODULI.young_modulus_mpa, MODULI.poisson_ratio
    confined = young * (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson))
    assert state.holding_force_n[mesh.surface, 2].sum() == pytest.approx(4 * confined * strain, rel=1e-4)
    np.testing.assert_allclose(state.volume_ratio, 1 + strain)


def test_pushing_one_vertex_is_a_force_that_the_backing_returns(mesh):
    positions = mesh.vertices_mm.copy()
    middle = np.flatnonzero((np.abs(positions[:, :2]).max(1) < 1e-9) & (positions[:, 2] > -1e-9))
    positions[middle, 2] -= 0.1
    held = elastic_state(mesh.vertices_mm, mesh.tetrahedra, positions, MODULI).holding_force_n
    assert held[middle, 2].sum() < 0
    audit = audit_contact(mesh, positions, MODULI, 0.5, Sphere(diameter_mm=1.0), np.array([0.0, 0.0, 0.4]))
    assert audit.residual > 0.1  # the vertices around it have not been let go
    assert audit.tension == 0
    assert audit.min_volume_ratio < 1
    assert audit.elastic_energy_mj > 0
