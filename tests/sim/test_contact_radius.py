"""The contact radius from a fit to the normal forces of vertices."""

from dataclasses import replace

import numpy as np
import pytest

from gelgap.sim.contact_radius import contact_radius_mm
from gelgap.sim.elastomer import Elastomer
from gelgap.sim.indenters.sphere import Sphere
from gelgap.sim.membrane import Diagnostics
from gelgap.sim.scene import Scene, Sharing
from gelgap.sim.solution import Record, Solution

SPACING_MM = 0.02
GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.45, friction=0.5)


def _pressed(rest_mm: np.ndarray, normal_force_n: np.ndarray) -> float:
    problem = Scene(GEL, Sphere(), "draft", Sharing()).problem(None, ((0, 0, -0.1),), (-1,))
    # A whole gel, so that nothing is mirrored.
    problem = replace(problem, pad_mm=(-12.0, 12.0, -10.0, 9.0))
    record = Record(
        displacement_mm=np.zeros((len(rest_mm), 3), dtype=np.float32),
        normal_force_n=normal_force_n.astype(np.float32),
        indenter_mm=np.array([0.0, 0.0, -0.1]),
        force_n=np.array([0.0, 0.0, -1.0]),
        converged=True,
        diagnostics=Diagnostics(),
    )
    return contact_radius_mm(Solution(problem, rest_mm, (record,)), record)


def test_a_hertzian_pressure_gives_its_contact_radius() -> None:
    axis = np.arange(-1, 1, SPACING_MM) + SPACING_MM / 2
    rest = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    pressure = np.sqrt(np.maximum(0.5**2 - (rest**2).sum(axis=1), 0.0))
    assert _pressed(rest, pressure) == pytest.approx(0.5, rel=0.005)


@pytest.mark.filterwarnings("error")
def test_few_vertices_at_one_radius_do_not_break_the_fit() -> None:
    ring = 0.3 * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    assert _pressed(ring, np.ones(4)) == pytest.approx(0.3)
    with_centre = _pressed(np.vstack([[0, 0], ring]), np.array([2, 1, 1, 1, 1]))
    assert 0.3 <= with_centre < 0.6
