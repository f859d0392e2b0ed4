"""A membrane's grid brought onto lattices that have the same points, and that have others."""

import numpy as np
import pytest

from gelgap.render.surface import Lattice, Membrane


def membrane() -> Membrane:
    x_mm, y_mm = np.arange(-40, 41) * 0.1, np.arange(-30, 31) * 0.1
    x, y = np.meshgrid(x_mm, y_mm)
    return Membrane(x_mm, y_mm, np.stack([x * y, np.sin(x), np.cos(y)], axis=-1).astype(np.float32))


def test_a_lattice_within_the_grid_is_cut_out_of_it():
    lattice = Lattice(-2.0, -1.5, 0.1, 31, 21)
    expected = membrane().displacement_mm[15:36, 20:51]
    np.testing.assert_array_equal(membrane().displacement_on(lattice), expected)


@pytest.mark.parametrize("lattice", [Lattice(-2.03, -1.5, 0.1, 31, 21), Lattice(-2.0, -1.5, 0.05, 61, 41)])
def test_between_the_points_of_the_grid_it_is_interpolated(lattice):
    x, y = np.meshgrid(lattice.x_mm, lattice.y_mm)
    expected = np.stack([x * y, np.sin(x), np.cos(y)], axis=-1)
    np.testing.assert_allclose(membrane().displacement_on(lattice), expected, atol=1e-4)


def test_beyond_the_grid_it_fades():
    on_lattice = membrane().displacement_on(Lattice(-8.0, -3.0, 0.1, 161, 61))
    assert not on_lattice[:, 0].any()
    np.testing.assert_allclose(on_lattice[:, 40:121], membrane().displacement_mm, atol=1e-6)
