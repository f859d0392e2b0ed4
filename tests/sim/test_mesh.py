"""Meshes: volume, conformity, order of the tetrahedra, pads cut at their edges, and how they follow the contact."""

import math
from dataclasses import replace

import numpy as np
import pymetis
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from gelgap.sim import Elastomer, Pose, PosePath, Sphere, plan_solves
from gelgap.sim.mesh import (
    DiscGrid,
    GelMesh,
    elimination_order,
    half_stadium,
    layer_heights_mm,
    mesh_for,
    ordered_for_elimination,
    pad_mesh,
    straightest_line,
    touchable,
    unordered_mesh,
)
from gelgap.sim.problem import ContactProblem, MeshSize
from gelgap.sim.scene import Moduli

LAYERS = layer_heights_mm(3.0, 0.3, 1.5, 0.36)
GRID = DiscGrid(9.9, 2.5, 0.4, 8)
STADIUM = DiscGrid(9.9, 2.5, 0.4, 8, axis_mm=(-0.3, 2.4), direction=(0.6, 0.8))
PADS = {
    "centred": (-5.0, 5.0, -4.0, 4.0),
    "beside a corner": (-8.75, 1.25, -6.6, 1.4),
    "on an edge": (-20.0, 0.0, -10.0, 10.0),
    "on a corner": (-20.0, 0.0, -20.0, 0.0),
    "a hair from a corner": (-20.0, 0.02, -20.0, 0.3),
}


def _volumes(mesh: GelMesh) -> np.ndarray:
    corners = mesh.vertices_mm[mesh.tetrahedra]
    return np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6


def _open_faces(mesh: GelMesh) -> np.ndarray:
    """Return the vertices (n, 3) of faces that belong to one tetrahedron alone."""
    faces = np.concatenate([np.delete(mesh.tetrahedra, k, axis=1) for k in range(4)])
    unique, count = np.unique(np.sort(faces, axis=1), axis=0, return_counts=True)
    assert count.max() == 2
    return unique[count == 1]


@pytest.mark.parametrize("name", PADS)
def test_a_pad_is_filled_without_gaps(name: str) -> None:
    x_min, x_max, y_min, y_max = PADS[name]
    mesh = pad_mesh(GRID, LAYERS, PADS[name], symmetric=False)
    volume = _volumes(mesh)
    assert volume.min() > 0
    whole = pad_mesh(GRID, LAYERS, (-30.0, 30.0, -30.0, 30.0), symmetric=False)
    disc = _volumes(whole).sum()
    if name == "centred":
        assert volume.sum() == pytest.approx(10 * 8 * 3)
    elif name == "on an edge":
        assert volume.sum() == pytest.approx(disc / 2)
    else:
        assert disc / 4 - 1e-6 < volume.sum() < disc
    for axis, low, high in ((0, x_min, x_max), (1, y_min, y_max)):
        assert mesh.vertices_mm[:, axis].min() >= low
        assert mesh.vertices_mm[:, axis].max() <= high
    centres = mesh.vertices_mm[_open_faces(mesh)].mean(axis=1)
    inside = (np.abs(centres[:, 0] - [[x_min], [x_max]]) > 1e-9).all(axis=0)
    inside &= (np.abs(centres[:, 1] - [[y_min], [y_max]]) > 1e-9).all(axis=0)
    inside &= (np.abs(centres[:, 2] - [[0.0], [-3.0]]) > 1e-9).all(axis=0)
    assert (np.hypot(*centres[inside, :2].T) > 0.9 * 9.9).all()


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.floats(0.0, 11.0), st.floats(0.0, 11.0), st.floats(0.0, math.pi))
@example(7.63, 6.44, 2.3)
def test_a_corner_of_the_pad_may_cut_the_mesh_anywhere(to_x_mm: float, to_y_mm: float, turn: float) -> None:
    """Two vertices near the corner may be moved onto it: they are one then, and no tetrahedron is flat."""
    direction = (math.cos(turn), math.sin(turn))
    grid = DiscGrid(29.6, 6.6, 1.39, 8, 2.2, 7.4, axis_mm=(0.0, 0.54), direction=direction)
    volume = _volumes(pad_mesh(grid, LAYERS, (-30.0, to_x_mm, -30.0, to_y_mm), symmetric=False))
    assert volume.min() > 1e-6 * np.median(volume)


def test_half_a_pad_is_half_of_it() -> None:
    halves, whole = (
        pad_mesh(GRID, LAYERS, (-4.0, 6.0, -5.0, 5.0), symmetric=symmetric) for symmetric in (True, False)
    )
    assert 2 * _volumes(halves).sum() == pytest.approx(_volumes(whole).sum())
    assert halves.vertices_mm[:, 1].min() == 0
    assert len(halves.symmetry_plane) > 0


def test_a_pad_with_far_edges_is_the_disc() -> None:
    disc = pad_mesh(GRID, LAYERS, None, symmetric=True)
    pad = pad_mesh(GRID, LAYERS, (-30.0, 30.0, -30.0, 30.0), symmetric=True)
    np.testing.assert_array_equal(pad.vertices_mm, disc.vertices_mm)
    np.testing.assert_array_equal(pad.tetrahedra, disc.tetrahedra)


def test_a_disc_drawn_out_along_a_turned_line_is_filled_without_gaps() -> None:
    mesh = pad_mesh(STADIUM, LAYERS, None, symmetric=False)
    volumes = _volumes(mesh)
    assert volumes.min() > 0
    disc = _volumes(pad_mesh(GRID, LAYERS, None, symmetric=False)).sum()
    assert volumes.sum() == pytest.approx(disc + 2 * 9.9 * 2.7 * 3.0)
    along = mesh.vertices_mm[:, :2] @ [0.6, 0.8]
    assert (along.min(), along.max()) == pytest.approx((-10.2, 12.3))
    centres = mesh.vertices_mm[_open_faces(mesh)].mean(axis=1)
    inside = np.abs(centres[:, 2, None] - [0.0, -3.0]).min(axis=1) > 1e-9
    assert _distance_to_the_line(centres[inside]).min() > 0.9 * 9.9


@pytest.mark.parametrize("grid", [GRID, STADIUM])
def test_cells_around_the_axis_are_one_below(grid: DiscGrid) -> None:
    vertices = pad_mesh(replace(grid, spacing_mm=0.1), LAYERS, None, symmetric=False).vertices_mm
    at_top, below = (
        (np.hypot(*vertices[np.abs(vertices[:, 2] - z_mm) < 1e-9, :2].T) < 0.3).sum() for z_mm in (0.0, -3.0)
    )
    assert 0 < below < at_top / 4


def test_columns_along_a_drag_merge_far_from_it() -> None:
    plane, cells = half_stadium(replace(STADIUM, axis_mm=(0.0, 3.2)))
    corners = [len(cell) for cell in cells]
    assert set(corners) == {4, 5}
    areas = []
    for cell in cells:
        (x, y), (next_x, next_y) = plane[cell].T, np.roll(plane[cell], -1, axis=0).T
        areas.append((x * next_y - next_x * y).sum() / 2)
    assert min(areas) > 0
    five = np.concatenate([plane[cell] for cell in cells if len(cell) == 5])
    assert five[:, 1].min() > STADIUM.fine_radius_mm
    near = plane[(plane[:, 1] == 0) & (plane[:, 0] > 0) & (plane[:, 0] < 3.2), 0]
    np.testing.assert_allclose(np.diff(near), 0.4)


@pytest.mark.parametrize(("travels", "expected"), [
    ([(1.0, 0.0)], (0.0, 1.0, 0.0, (1.0, 0.0))),
    ([(-3.0, -4.0)], (0.0, 5.0, 0.0, (-0.6, -0.8))),
    ([(0.0, 0.0)], (0.0, 0.0, 0.0, (1.0, 0.0))),
    ([(2.0, 0.0), (-1.0, 0.0)], (-1.0, 2.0, 0.0, (1.0, 0.0))),
])  # fmt: skip
def test_the_straightest_line_of_a_path(travels, expected) -> None:
    *found, direction = straightest_line(np.array([[(0.0, 0.0), end] for end in travels]))
    assert found == pytest.approx(expected[:3])
    assert direction == pytest.approx(expected[3])


def test_layers_are_thin_at_both_ends() -> None:
    thick = -np.diff(layer_heights_mm(3.0, 0.05, 1.8, 0.2))
    assert thick.sum() == pytest.approx(3.0)
    assert thick[0] == pytest.approx(0.05, rel=0.05)
    assert thick[-1] == pytest.approx(0.2, rel=0.1)
    assert 0.5 < thick.max() <= 0.75
    assert (thick[1:] / thick[:-1]).max() < 1.9


def test_a_new_order_of_vertices_is_the_same_mesh() -> None:
    problem = _problem(3.0, 3.0, 0.5, travel_mm=0.6)
    mesh, reach_mm = unordered_mesh(problem), 1.3 * problem.penetration_radius_mm
    touched = touchable(mesh, problem)
    assert _distance_to_the_segment(mesh.vertices_mm[touched]).max() <= reach_mm
    untouched = np.setdiff1d(mesh.surface, touched)
    assert _distance_to_the_segment(mesh.vertices_mm[untouched]).min() > reach_mm
    ordered = ordered_for_elimination(mesh, touched)
    assert np.sort(_volumes(ordered)) == pytest.approx(np.sort(_volumes(mesh)))
    first, expected = ordered.vertices_mm[: len(touched)], mesh.vertices_mm[touched]
    np.testing.assert_array_equal(first[np.lexsort(first.T)], expected[np.lexsort(expected.T)])
    np.testing.assert_array_equal(
        ordered.bottom, len(ordered.vertices_mm) - 1 - np.arange(len(mesh.bottom))[::-1]
    )


def _distance_to_the_line(points_mm: np.ndarray) -> np.ndarray:
    turned = points_mm[:, :2] @ np.array([[0.6, -0.8], [0.8, 0.6]])
    return np.hypot(turned[:, 0] - np.clip(turned[:, 0], -0.3, 2.4), turned[:, 1])


def _distance_to_the_segment(vertices_mm: np.ndarray) -> np.ndarray:
    x, y = vertices_mm[:, 0], vertices_mm[:, 1]
    return np.hypot(x - np.clip(x, 0.0, 0.6), y)


def _no_metis(_: object) -> None:
    raise RuntimeError("Caught an unknown exception!")


def test_the_order_of_elimination_is_cheaper_than_minimum_degree(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = pad_mesh(
        DiscGrid(9.9, 2.7, 0.25, 8), layer_heights_mm(3.0, 0.15, 1.25, 0.15), None, symmetric=True
    )
    count = len(mesh.vertices_mm)
    graph = mesh.neighbours
    last = np.flatnonzero((mesh.vertices_mm[:, 2] == 0) & (np.hypot(*mesh.vertices_mm[:, :2].T) < 2))
    order = elimination_order(graph, last)
    np.testing.assert_array_equal(np.sort(order), np.arange(count))
    np.testing.assert_array_equal(order[-len(last) :], last)
    inner = np.setdiff1d(np.arange(count), last)
    by_degree = np.concatenate([inner[_minimum_degree(graph[inner][:, inner])], last])
    work_by_degree = _factor_work(graph[by_degree][:, by_degree])
    assert _factor_work(graph[order][:, order]) < 0.7 * work_by_degree
    monkeypatch.setattr(pymetis, "nested_dissection", _no_metis)
    order = elimination_order(graph, last)
    np.testing.assert_array_equal(order[-len(last) :], last)
    np.testing.assert_array_equal(np.sort(order), np.arange(count))
    assert _factor_work(graph[order][:, order]) < 1.1 * work_by_degree


def _factor_work(graph: sparse.csr_array) -> float:
    """Return what eliminating the vertices of a graph in their order costs: the sum of its columns' squared lengths."""
    return float((np.diff(_factors(graph, "NATURAL").L.indptr).astype(float) ** 2).sum())


def _minimum_degree(graph: sparse.csr_array) -> np.ndarray:
    return np.argsort(_factors(graph, "MMD_AT_PLUS_A").perm_c)


def _factors(graph: sparse.csr_array, ordering: str) -> SuperLU:
    dominant = graph.astype(float) + sparse.diags_array(graph.sum(axis=0).astype(float))
    options = {"SymmetricMode": True}
    return splu(dominant.tocsc(), permc_spec=ordering, diag_pivot_thresh=0.0, options=options)


def _problem(
    diameter_mm: float, thickness_mm: float, depth_mm: float, travel_mm: float = 0.0
) -> ContactProblem:
    pad = {"thickness_mm": thickness_mm, "pad_size_mm": (100.0, 100.0)}
    gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=0.5, **pad)
    path = PosePath("press", (Pose(depth_mm=depth_mm, shear_x_mm=travel_mm),))
    return plan_solves(gel, Sphere(diameter_mm=diameter_mm), path, "draft").solves[0].problem


@pytest.mark.parametrize("scene", [(3.0, 3.0, 1.0), (3.0, 3.0, 0.01), (10.0, 20.0, 0.05), (1.0, 6.0, 0.3)])
def test_cells_have_the_contact_s_own_size(scene):
    problem = _problem(*scene)
    mesh, radius_mm = mesh_for(problem), problem.penetration_radius_mm
    assert problem.cell_mm == pytest.approx(radius_mm / problem.quality.disc.across)
    on_axis = mesh.vertices_mm[mesh.surface]
    on_axis = np.sort(on_axis[(on_axis[:, 1] == 0) & (np.abs(on_axis[:, 0]) < radius_mm), 0])
    assert np.diff(on_axis).max() < 1.25 * problem.cell_mm
    assert np.hypot(*mesh.vertices_mm[:, :2].T).max() == pytest.approx(3.3 * scene[1])


def test_a_wide_contact_is_meshed_by_the_thickness_and_far_beyond_its_rim():
    problem = _problem(12.0, 2.0, 0.6)
    assert problem.contact_width == pytest.approx(2 * math.sqrt(6.0**2 - 5.4**2) / 2.0)
    assert problem.cell_mm == pytest.approx(0.566 * 2.0 / problem.quality.disc.across)
    rim_mm = np.hypot(*mesh_for(problem).vertices_mm[:, :2].T).max()
    assert rim_mm == pytest.approx(problem.penetration_radius_mm + 4 * 2.0)


def test_a_mesh_is_stiffest_around_a_small_contact():
    gel, size = Moduli(0.3, 0.48), MeshSize(4.0, 8, 2.0, 2.0, stiffness=(0.01, 0.001, 0.5))
    assert size.stiffness_excess(gel, 1.0) == pytest.approx(0.01 + 0.001 / 0.04)
    narrow, wide = (size.stiffness_excess(gel, width) for width in (0.1, 2.0))
    assert narrow == pytest.approx(0.035 * (1 + 0.5 * math.log(10)))
    assert wide == pytest.approx(0.035 * (1 - 0.5 * math.log(2)))
    assert size.stiffness_excess(gel, 100.0) == 0.0
