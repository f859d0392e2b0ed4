"""Membrane states: grid, saving, loading, and the contact radius from a fit to the normal forces of vertices."""

from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from gelgap.sim.indenter import Indenter, Sphere
from gelgap.sim.membrane import MembraneCubic, MembraneState, PolarTable, grid_axes, membrane_between
from gelgap.sim.plan import plan_visit
from gelgap.sim.problem import ContactProblem
from gelgap.sim.rim import contact_radius_mm
from gelgap.sim.scene import Elastomer, Pose, Scene, Sharing
from gelgap.sim.shapes import Box
from gelgap.sim.solution import Record, Solution, SolveDiagnostics


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


def test_a_saved_state_outlives_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flat = MembraneState.untouched(*grid_axes())
    displacement = np.random.default_rng(0).normal(size=flat.displacement_mm.shape).astype(np.float32)
    state = MembraneState(
        flat.x_mm, flat.y_mm, displacement, displacement[..., 0] > 1, np.array([0.1, 0.2, -1.0]), 0.7, False
    )
    state.save(tmp_path / "state.npz")
    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", mock.Mock(side_effect=OSError("a full disk")))
        with pytest.raises(RuntimeError, match=r"cannot write .*: a full disk"):
            replace(state, force_n=np.ones(3)).save(tmp_path / "state.npz")
    loaded = MembraneState.load(tmp_path / "state.npz")
    for name in ("x_mm", "y_mm", "displacement_mm", "contact", "force_n"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(state, name))
    assert (loaded.contact_radius_mm, loaded.converged) == (0.7, False)


def test_missing_and_malformed_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nothing\.npz"):
        MembraneState.load(tmp_path / "nothing.npz")
    np.savez(tmp_path / "part.npz", x_mm=np.zeros(3))
    with pytest.raises(ValueError, match="displacement_mm"):
        MembraneState.load(tmp_path / "part.npz")
    np.savez(tmp_path / "shape.npz", x_mm=np.zeros(3), y_mm=np.zeros(2), displacement_mm=np.zeros((3, 3, 3)))
    with pytest.raises(ValueError, match="shape"):
        MembraneState.load(tmp_path / "shape.npz")


SPACING_MM = 0.02
GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.45, friction=0.5)


def _solution(
    rest_mm: np.ndarray, normal_force_n: np.ndarray, displacement_mm: np.ndarray, indenter: Indenter
) -> Solution:
    problem = ContactProblem.of(Scene(GEL, indenter, "draft", Sharing()), None, ((0, 0, -0.1),), (-1,))
    # A whole gel, so that nothing is mirrored.
    problem = replace(problem, pad_mm=(-12.0, 12.0, -10.0, 9.0))
    record = Record(
        displacement_mm=displacement_mm.astype(np.float32),
        normal_force_n=normal_force_n.astype(np.float32),
        contact_force_n=np.zeros((len(rest_mm), 3), dtype=np.float32),
        indenter_mm=np.array([0.0, 0.0, -0.1]),
        torque_n_mm=np.zeros(3),
        # Dragged, so that the contact counts as no round one.
        force_n=np.array([0.1, 0.0, -1.0]),
        converged=True,
        diagnostics=SolveDiagnostics(),
    )
    return Solution(problem, (rest_mm,), (record,))


def _pressed(rest_mm: np.ndarray, normal_force_n: np.ndarray) -> float:
    solution = _solution(rest_mm, normal_force_n, np.zeros((len(rest_mm), 3)), Sphere())
    return contact_radius_mm(solution, solution.records[0])


def test_the_edge_of_a_box_is_as_sharp_as_its_vertices_make_it() -> None:
    # Lines of vertices with a wall at x = 2.5 and y = 3.5 mm; at its corner the rows of a table are far apart.
    x_mm = np.array([-11.0, -6.0, -4.0, -3.0, -2.6, -2.5, -2.0, 0.0, 2.0, 2.5, 2.6, 3.0, 4.0, 6.0, 11.0])
    rest_mm = np.stack(np.meshgrid(x_mm, np.where(abs(x_mm) < 6, 1.4, 0.8) * x_mm), -1).reshape(-1, 2)
    beyond = np.maximum(abs(rest_mm[:, 0]) / 2.5, abs(rest_mm[:, 1]) / 3.5) - 1
    moved_mm = np.stack([0 * beyond, 0 * beyond, -0.5 * np.exp(-10 * np.maximum(beyond, 0))], 1)
    box, ball = (_solution(rest_mm, 0 * beyond, moved_mm, body) for body in (Box(), Sphere()))
    between = membrane_between(box, box.records[0])
    assert isinstance(between, MembraneCubic)
    assert isinstance(membrane_between(ball, ball.records[0]), PolarTable)
    np.testing.assert_allclose(between.at(rest_mm)[:, 2], moved_mm[:, 2], atol=1e-2)
    corner = np.flatnonzero((rest_mm == [2.5, 3.5]).all(axis=1))
    np.testing.assert_allclose(between.at(rest_mm[corner]), moved_mm[corner], atol=1e-6)
    # Further than the vertices the membrane moves as at their rim.
    np.testing.assert_allclose(
        between.at(np.array([[40.0, 0.0]])), between.at(np.array([[10.99, 0.0]])), atol=1e-6
    )


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


def test_staggered_long_cells_do_not_show_along_an_edge() -> None:
    plan = plan_visit(GEL, Box(size_mm=(4.0, 3.0), edge_radius_mm=0.3), (Pose(depth_mm=0.3),), "draft")
    solution = plan.solves[0].run()
    in_cells = membrane_between(solution, solution.records[-1])
    along = np.linspace(-1.0, 1.0, 101)

    def ripple(membrane: MembraneCubic) -> float:
        """Return how much the slope across the box's edge differs along it, rms at some distances."""
        heights = [
            [
                membrane.at(np.stack([np.full(101, 2.0 + off + side), along], axis=-1))[:, 2]
                for side in (0, 0.02)
            ]
            for off in (-0.3, -0.2, -0.1, 0.0, 0.1)
        ]
        slopes = np.diff(heights, axis=1)[:, 0] / 0.02
        smooth = [np.polyval(np.polyfit(along, slope, 4), along) for slope in slopes]
        return float(np.sqrt(np.mean((slopes - smooth) ** 2)))

    assert ripple(in_cells) < 0.5 * ripple(MembraneCubic(in_cells.rest_mm, in_cells.displacement_mm))


def test_beyond_an_edge_through_the_contact_point_the_membrane_is_that_of_the_edge() -> None:
    rest_mm = np.stack(np.meshgrid(np.linspace(-2, 2, 9), np.linspace(0, 2, 5)), axis=-1).reshape(-1, 2)
    rest_mm += np.random.default_rng(0).uniform(-3e-13, 3e-13, rest_mm.shape)
    beyond_mm = np.stack([np.linspace(-2, 2, 100), np.full(100, -1.0)], axis=1)
    values = MembraneCubic(rest_mm, np.pad(rest_mm, ((0, 0), (0, 1)))).at(beyond_mm)
    np.testing.assert_allclose(values[:, :2], [1, 0] * beyond_mm, atol=5e-3)
