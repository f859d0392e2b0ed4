"""Membrane states: grid, saving and loading."""

from pathlib import Path

import numpy as np
import pytest

from gelgap.sim.membrane import MembraneState, flat_state, grid_axes


def test_the_grid_covers_the_footprint_and_its_margin() -> None:
    x_mm, y_mm = grid_axes()
    assert (len(x_mm), len(y_mm)) == (141, 111)
    assert (x_mm[0], x_mm[-1], y_mm[0], y_mm[-1]) == (-7.0, 7.0, -5.5, 5.5)
    np.testing.assert_allclose(np.diff(x_mm), 0.1, atol=1e-12)


def test_the_grid_reaches_as_far_as_it_must_on_the_same_points() -> None:
    x_mm, y_mm = grid_axes((9.0, 0.0))
    assert (x_mm[0], x_mm[-1], y_mm[-1]) == (-9.0, 9.0, 5.5)
    assert set(grid_axes()[0]) < set(x_mm)
    assert grid_axes((7.03, 5.5))[0][-1] == pytest.approx(7.1)


def test_a_saved_state_comes_back(tmp_path: Path) -> None:
    flat = flat_state()
    displacement = np.random.default_rng(0).normal(size=flat.displacement_mm.shape).astype(np.float32)
    state = MembraneState(
        flat.x_mm, flat.y_mm, displacement, displacement[..., 0] > 1, np.array([0.1, 0.2, -1.0]), 0.7, False
    )
    state.save(tmp_path / "state.npz")
    loaded = MembraneState.load(tmp_path / "state.npz")
    for name in ("x_mm", "y_mm", "displacement_mm", "contact", "force_n"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(state, name))
    assert (loaded.contact_radius_mm, loaded.converged) == (0.7, False)


def test_a_saved_state_has_the_documented_keys(tmp_path: Path) -> None:
    flat_state().save(tmp_path / "state.npz")
    with np.load(tmp_path / "state.npz") as file:
        assert {"x_mm", "y_mm", "displacement_mm", "contact", "force_n"} <= set(file)


def test_missing_and_malformed_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nothing\.npz"):
        MembraneState.load(tmp_path / "nothing.npz")
    np.savez(tmp_path / "part.npz", x_mm=np.zeros(3))
    with pytest.raises(ValueError, match="displacement_mm"):
        MembraneState.load(tmp_path / "part.npz")
    np.savez(tmp_path / "shape.npz", x_mm=np.zeros(3), y_mm=np.zeros(2), displacement_mm=np.zeros((3, 3, 3)))
    with pytest.raises(ValueError, match="shape"):
        MembraneState.load(tmp_path / "shape.npz")
