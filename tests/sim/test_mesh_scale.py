"""How a mesh follows the size of a contact, and which contacts count as wide."""

import math

import numpy as np
import pytest

from gelgap.sim import Elastomer, Pose, PosePath, Sphere, plan_solves
from gelgap.sim.material import Moduli, mesh_moduli
from gelgap.sim.mesh.for_problem import mesh_for
from gelgap.sim.mesh.scale import contact_width, mesh_scale
from gelgap.sim.problem import ContactProblem


def _problem(diameter_mm: float, thickness_mm: float, depth_mm: float) -> ContactProblem:
    gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=0.5, thickness_mm=thickness_mm)
    path = PosePath("press", (Pose(depth_mm=depth_mm),))
    return plan_solves(gel, Sphere(diameter_mm=diameter_mm), path, "draft").solves[0].problem


@pytest.mark.parametrize("depth_mm", [0.2, 1.0, 1.5])
def test_no_contact_of_the_default_sphere_is_wide(depth_mm):
    assert contact_width(Sphere(), 3.0, depth_mm) == 1.0
    mesh = mesh_for(_problem(3.0, 3.0, depth_mm))
    assert np.hypot(*mesh.vertices_mm[:, :2].T).max() == pytest.approx(9.9)


def test_a_wide_contact_is_meshed_by_the_thickness_and_far_beyond_its_rim():
    sphere = Sphere(diameter_mm=12.0)
    assert contact_width(sphere, 2.0, 0.6) == pytest.approx(2 * math.sqrt(6.0**2 - 5.4**2) / 2.0)
    assert mesh_scale(sphere, 2.0, 0.6) == pytest.approx(0.8)
    problem = _problem(12.0, 2.0, 0.6)
    rim_mm = np.hypot(*mesh_for(problem).vertices_mm[:, :2].T).max()
    assert rim_mm == pytest.approx(problem.penetration_radius_mm + 4 * 2.0)


def test_a_mesh_is_less_too_stiff_under_a_wide_contact():
    gel, stiffness = Moduli(0.3, 0.48), (0.01, 0.001)
    narrow, wide = (mesh_moduli(gel, stiffness, width).young_modulus_mpa for width in (1.0, 4.0))
    assert 0.3 / narrow - 1 == pytest.approx(2 * (0.3 / wide - 1))
    assert mesh_moduli(gel, stiffness) == mesh_moduli(gel, stiffness, 1.0)
