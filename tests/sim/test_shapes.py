"""Shapes: signed distances, cuts and turns of each, meshes from files, and what is pressed is what was asked for."""

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from gelgap.sim import (
    Box,
    Cone,
    ConvexMesh,
    Cylinder,
    Edge,
    Elastomer,
    Ellipsoid,
    Pose,
    Sharing,
    Sphere,
    load_indenter,
    solve_pose,
    solve_poses,
)
from gelgap.sim.grading import edge_radius_mm, sizes_along
from gelgap.sim.indenter import Symmetry
from gelgap.sim.objects import sum_surface
from gelgap.sim.plan import plan_visit
from gelgap.sim.rounded import Shape
from gelgap.sim.shapes import AnyIndenter

GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=10.0)
ALONE = Sharing(cache=False)
THICK_GEL = Elastomer(
    young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.5, thickness_mm=12.0, pad_size_mm=(40.0, 40.0)
)
LONG = Ellipsoid(diameters_mm=(12.0, 2.2, 6.0), yaw_deg=33.0)
TETRAHEDRON = ((0.0, 0.0, 0.0), (3.0, 0.0, 3.0), (-2.0, 2.0, 3.0), (-2.0, -2.0, 3.0))
BODIES = (
    Cylinder(edge_radius_mm=0.3),
    Cone(),
    Edge(),
    Box(),
    Ellipsoid(),
    ConvexMesh(hull_mm=TETRAHEDRON, edge_radius_mm=0.3),
)
turned = st.builds(
    lambda body, yaw, x, y: body.model_copy(update={"yaw_deg": yaw, "tilt_deg": (x, y)}),
    st.sampled_from(BODIES),
    st.floats(-180, 180),
    st.floats(-15, 15),
    st.floats(-15, 15),
)
directions = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)).filter(
    lambda v: np.linalg.norm(v) > 0.1
)


@settings(deadline=None, max_examples=60)
@given(body=turned, point=st.tuples(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3, 5)))
@example(body=Cylinder(), point=(0.0, 0.0, 3.0))
def test_a_distance_has_a_unit_gradient_and_leads_to_it(body: Shape, point: tuple[float, ...]) -> None:
    found = body.project(np.array([point]))
    assert np.linalg.norm(found.outward_normal[0]) == pytest.approx(1)
    assert abs(body.project(found.points_mm).distance_mm[0]) < 1e-9
    outside = found.points_mm + 0.01 * found.outward_normal
    assert body.project(outside).distance_mm[0] == pytest.approx(0.01, abs=1e-9)


@settings(deadline=None, max_examples=40)
@given(body=turned, direction=directions)
def test_no_point_of_the_surface_lies_beyond_its_reach(body: Shape, direction: tuple[float, ...]) -> None:
    unit = np.array([direction]) / np.linalg.norm(direction)
    reach_mm = body.reach_mm(unit)[0]
    around = 30 * trimesh.creation.icosphere(subdivisions=2).vertices
    assert (body.project(around).points_mm @ unit[0]).max() <= reach_mm + 1e-9
    # Far away in that direction, the distance is that from the plane that bounds the body there.
    assert body.project(1e5 * unit).distance_mm[0] == pytest.approx(1e5 - reach_mm, abs=1e-3)


@settings(deadline=None, max_examples=30)
@given(body=turned)
def test_the_lowest_point_touches_and_the_cut_lies_on_the_surface(body: Shape) -> None:
    assert body.origin_height_mm == pytest.approx(
        -body.project(np.array([[0, 0, -1e6]])).points_mm[0, 2], abs=1e-6
    )
    (x_min, x_max), (y_min, y_max) = body.cut_mm(0.3)
    assert x_min < x_max
    assert y_min < y_max
    assert body.penetration_radius_mm(0.3) <= np.hypot(max(-x_min, x_max), max(-y_min, y_max)) + 1e-9


@pytest.mark.parametrize(
    ("body", "symmetry"),
    [
        (Cylinder(yaw_deg=20), Symmetry.REVOLUTION),
        (Cylinder(tilt_deg=(2, 0)), Symmetry.MIRROR_X),
        (Cylinder(tilt_deg=(2, 2)), Symmetry.NONE),
        (Box(tilt_deg=(0, 2)), Symmetry.MIRROR_Y),
        (Box(), Symmetry.MIRROR),
        (Box(yaw_deg=90), Symmetry.MIRROR),
        (Box(yaw_deg=20), Symmetry.NONE),
        (Ellipsoid(diameters_mm=(3, 3, 2)), Symmetry.REVOLUTION),
    ],
)
def test_a_turn_or_a_tilt_takes_symmetries_away(body: Shape, symmetry: Symmetry) -> None:
    assert body.symmetry is symmetry


def test_a_curve_is_as_sharp_as_it_is() -> None:
    _, radius = Cylinder(edge_radius_mm=0.2).curvature(0.3, 0, 0.05)
    assert radius.min() == pytest.approx(0.2, rel=0.02)
    places, radius = Cone(tip_radius_mm=0.3).curvature(0.4, 0, 0.05)
    assert radius.min() == pytest.approx(0.3, rel=0.02)
    assert np.abs(places[radius < 0.31]).max() < 0.2


@pytest.mark.parametrize("body", [Sphere(), *BODIES])
def test_a_shape_comes_back_from_json(body: AnyIndenter) -> None:
    from pydantic import TypeAdapter

    kind = TypeAdapter(AnyIndenter)
    back = kind.validate_json(kind.dump_json(body))
    assert type(back) is type(body)
    assert back == body


def test_presets_and_files_name_indenters(tmp_path: Path) -> None:
    assert load_indenter("box", size_mm=(5, 4)).size_mm == (5, 4)
    assert load_indenter("cylinder-3", edge_radius_mm=0.4) == Cylinder(edge_radius_mm=0.4)
    trimesh.creation.icosphere(radius=2).export(tmp_path / "ball.stl")
    ball = load_indenter(str(tmp_path / "ball.stl"), yaw_deg=10)
    assert ball.cut_mm(2.0)[0, 1] == pytest.approx(2.0, abs=0.02)
    (tmp_path / "ball.toml").write_text('mesh = "ball.stl"\nedge_radius_mm = 0.1\n')
    assert load_indenter(str(tmp_path / "ball.toml")).edge_radius_mm == 0.1


@pytest.mark.parametrize(
    ("name", "fields", "message"),
    [
        ("blob", {}, "blob"),
        ("cone", {"edge_radius_mm": 0.1}, "edge_radius_mm: a cone has none"),
        ("cylinder", {"edge_radius_mm": 2.0}, "at most 1.5 mm"),
        ("box", {"tilt_deg": (20, 0)}, r"\[-15, 15\]"),
        ("none.stl", {}, "does not exist"),
    ],
)
def test_what_is_not_served_is_refused(name: str, fields: dict, message: str) -> None:
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        load_indenter(name, **fields)


@pytest.mark.parametrize(
    ("body", "depth_mm", "message"),
    [
        (Cylinder(edge_radius_mm=0.02), 0.3, "smallest radius that it serves"),
        (Box(edge_radius_mm=0.1), 0.3, "0.15 mm: quality standard serves it"),
        (ConvexMesh(hull_mm=TETRAHEDRON), 0.3, "sharper"),
        (Box(tilt_deg=(10, 0)), 0.2, "lifts the far side"),
        (Cylinder(), 6.0, "depth_mm"),
    ],
)
def test_a_pose_that_a_body_does_not_allow_is_refused(body: Shape, depth_mm: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        plan_visit(GEL, body, (Pose(depth_mm=depth_mm),), "draft")


def test_rings_follow_a_sharper_edge_than_lines_and_finer_for_it() -> None:
    problems = [
        plan_visit(GEL, Cylinder(edge_radius_mm=radius), (Pose(depth_mm=0.3),), "draft").solves[0].problem
        for radius in (0.2, 0.1)
    ]
    blunt, sharp = (sizes_along(problem, 0, 2.5, (0.0, 0.0)).size_mm.min() for problem in problems)
    assert sharp < 0.7 * blunt
    assert edge_radius_mm(problems[1], 0.1) == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize(("thickness_mm", "cells"), [(3.0, 1.5), (2.0, 2.25), (1.0, 3.0)])
def test_cells_in_the_middle_widen_with_a_contacts_width(thickness_mm: float, cells: float) -> None:
    gel = GEL.model_copy(update={"thickness_mm": thickness_mm})
    body = Box(size_mm=(6.0, 6.0), edge_radius_mm=0.5)
    problem = plan_visit(gel, body, (Pose(depth_mm=0.2),), "draft").solves[0].problem
    widest_mm = sizes_along(problem, 0, 2.5, (0.0, 0.0)).size_mm.max()
    assert widest_mm / problem.widest_cell_mm == pytest.approx(cells, rel=0.05)


def test_a_mesh_that_is_its_own_mirror_image_shares_as_a_box_does() -> None:
    assert _ball_of_triangles().symmetry is Symmetry.MIRROR
    assert ConvexMesh(hull_mm=TETRAHEDRON).symmetry is Symmetry.MIRROR_Y
    assert _ball_of_triangles().yawed(30.0).symmetry is Symmetry.NONE


def _ball_of_triangles() -> ConvexMesh:
    corners = trimesh.creation.icosphere(subdivisions=4, radius=1.5).vertices + np.array([0, 0, 1.5])
    return ConvexMesh(hull_mm=tuple(map(tuple, corners.round(6).tolist())))


@pytest.mark.parametrize("body", [Ellipsoid(diameters_mm=(3.002, 3.0, 3.0)), _ball_of_triangles()])
def test_a_body_that_is_nearly_a_sphere_presses_like_one(body: Shape) -> None:
    poses = (Pose(depth_mm=0.3), Pose(depth_mm=0.3, shear_x_mm=0.1))
    other, sphere = (solve_poses(GEL, one, poses, "draft", ALONE) for one in (body, Sphere()))
    for one, two in zip(other, sphere, strict=True):
        assert one.converged
        np.testing.assert_allclose(one.force_n, two.force_n, rtol=0.01, atol=1e-3)
        assert np.sqrt(((one.displacement_mm - two.displacement_mm) ** 2).sum(axis=-1).mean()) < 3e-3


def test_a_cylinder_presses_as_finite_elements_say() -> None:
    """The table's force at 0.3 mm is 0.608557 N (assets/reference/shapes)."""
    state = solve_pose(GEL, Cylinder(edge_radius_mm=0.2), Pose(depth_mm=0.3), "draft", ALONE)
    assert state.converged
    assert -state.force_n[2] == pytest.approx(0.608557, rel=0.05)
    inside = np.hypot(*np.meshgrid(state.x_mm, state.y_mm)) < 1.2
    assert state.contact[inside].all()
    np.testing.assert_allclose(state.displacement_mm[inside, 2], -0.3, atol=2e-3)


@pytest.mark.usefixtures("coarse")
def test_a_turned_body_is_solved_once_and_its_answer_is_turned() -> None:
    body, pose = Ellipsoid(diameters_mm=(5.0, 3.0, 3.0)), Pose(depth_mm=0.3, shear_y_mm=0.05)
    straight = plan_visit(GEL, body, (pose,), "draft", ALONE)
    turned = plan_visit(GEL, body.yawed(90.0), (Pose(depth_mm=0.3, shear_x_mm=-0.05),), "draft", ALONE)
    assert straight.solves[0].key == turned.solves[0].key
    solutions = {straight.solves[0].key: straight.solves[0].run()}
    one, two = straight.state(0, solutions), turned.state(0, solutions)
    np.testing.assert_allclose(two.force_n, [-one.force_n[1], one.force_n[0], one.force_n[2]], atol=1e-9)
    np.testing.assert_allclose(
        two.torque_n_mm, [-one.torque_n_mm[1], one.torque_n_mm[0], one.torque_n_mm[2]], atol=1e-9
    )
    long, wide = (np.ptp(np.argwhere(one.contact), axis=0) for one in (one, two))
    assert long[1] > long[0]
    assert wide[0] > wide[1]


def test_the_middle_of_an_ellipsoid_is_as_far_from_its_surface_as_points_beside_it() -> None:
    """The membrane's vertex there was taken for one that a press by half of the height cannot touch."""
    body = Ellipsoid(diameters_mm=(5.0, 3.0, 2.0))
    middle, beside = (
        body.project(
            np.array([[x, y, 1.0] for x, y in ((0.0, 0.0), (0.5, 0.0), (0.5, 0.2), (0.0, 0.3))]) + off
        )
        for off in (0.0, 1e-6)
    )
    np.testing.assert_allclose(middle.distance_mm, beside.distance_mm, atol=1e-5)
    assert middle.distance_mm[0] == pytest.approx(-1.0)


@pytest.mark.usefixtures("coarse")
def test_half_of_a_body_that_leans_is_solved_and_takes_its_force() -> None:
    """The frame is turned so that it leans along x; with the pad's edges it is not."""
    leaning = Cylinder(edge_radius_mm=0.3, tilt_deg=(3.0, 2.0))
    pose = Pose(depth_mm=0.3)
    problem = plan_visit(GEL, leaning, (pose,), "draft").solves[0].problem
    assert problem.symmetric
    assert problem.indenter.tilt_deg == (0.0, pytest.approx(np.hypot(3, 2)))
    half = solve_pose(GEL, leaning, pose, "draft", ALONE)
    whole = solve_pose(GEL, leaning, pose, "draft", Sharing(cache=False, translation=False))
    assert not whole.contact_solve.solution.problem.symmetric
    np.testing.assert_allclose(half.force_n, whole.force_n, atol=0.03 * abs(whole.force_n[2]))


def test_a_contact_whose_rim_is_near_the_pads_edge_has_that_edge() -> None:
    pose = Pose(depth_mm=0.2)
    for diameter_mm, is_near in ((8.0, False), (14.0, True)):
        problem = plan_visit(GEL, Cylinder(diameter_mm=diameter_mm), (pose,), "draft").solves[0].problem
        assert (problem.pad_mm is not None) == is_near


@pytest.mark.parametrize(("friction", "force_n"), [(0.0, 1.413), (10.0, 2.085)])
def test_a_flat_that_is_wider_than_the_pad_presses_all_of_it(friction: float, force_n: float) -> None:
    """Forces are those of felupe's mean-dilatation hexahedra, three meshes extrapolated."""
    gel = GEL.model_copy(update={"friction": friction, "pad_size_mm": (9.0, 7.5)})
    state = solve_pose(gel, Box(size_mm=(20, 20)), Pose(depth_mm=0.15), "draft", ALONE)
    assert state.converged
    assert abs(-state.force_n[2] - force_n) < 2 * state.diagnostics.fz_error_n
    assert state.contact[np.ix_(np.abs(state.y_mm) < 3.7, np.abs(state.x_mm) < 4.4)].all()
    gel = gel.model_copy(update={"poisson_ratio": 0.495})
    with pytest.raises(ValueError, match=r"poisson_ratio = 0\.495: .* at most 0\.49"):
        plan_visit(gel, Box(size_mm=(20, 20)), (Pose(depth_mm=0.1),))


def test_a_long_contact_that_lies_across_the_mesh_has_cells_for_its_own_width() -> None:
    problem = plan_visit(THICK_GEL, LONG, (Pose(0.06, point_x_mm=3.0),), "draft").solves[0].problem
    assert problem.is_oblique
    along = LONG.turned((0, 0, -33))
    assert problem.meshed_radius_mm == pytest.approx(along.contact_radius_mm(0.06), rel=0.01)
    assert problem.cell_mm < problem.meshed_radius_mm < 0.5 * min(problem.half_cut_mm)


def test_a_square_that_stands_on_its_corner_is_not_round() -> None:
    square = Box(size_mm=(3, 3), yaw_deg=45.0)
    assert not plan_visit(THICK_GEL, square, (Pose(0.4),), "draft").solves[0].problem.is_round


@pytest.mark.slow
@pytest.mark.parametrize("by_surface", [False, True])
def test_a_long_contact_across_the_mesh_has_the_force_of_hertz_or_is_coarse(by_surface: bool) -> None:
    body = sum_surface([(LONG, (0.0, 0.0, 0.0))]) if by_surface else LONG
    depths_mm = (0.0075, 0.015, 0.03, 0.06)
    poses = [Pose(depth_mm, point_x_mm=3.0, trajectory=0) for depth_mm in depths_mm]
    states = solve_poses(THICK_GEL, body, poses, quality="draft", sharing=ALONE)
    modulus_mpa = THICK_GEL.young_modulus_mpa / (1 - THICK_GEL.poisson_ratio**2)
    force_n = [hertz_force_n(1.1**2 / 3, 6.0**2 / 3, modulus_mpa, depth_mm) for depth_mm in depths_mm]
    for state, expected_n in zip(states, force_n, strict=True):
        assert state.diagnostics.coarse or -state.force_n[2] == pytest.approx(expected_n, rel=0.05)
        assert -state.force_n[2] == pytest.approx(expected_n, abs=4 * state.diagnostics.fz_error_n)


def hertz_force_n(narrow_mm: float, long_mm: float, modulus_mpa: float, depth_mm: float) -> float:
    """By two radii of curvature and the plane-strain modulus (Johnson 1985, eq. 4.26 to 4.32, with m = e²)."""
    ratio = long_mm / narrow_mm

    def unequal(m: float) -> float:
        return (ellipe(m) / (1 - m) - ellipk(m)) / (ellipk(m) - ellipe(m)) - ratio

    m = brentq(unequal, 1e-6, 1 - 1e-12)
    half_length_mm = math.sqrt(2 * long_mm * depth_mm * (ellipk(m) - ellipe(m)) / (m * ellipk(m)))
    return 2 / 3 * math.pi * half_length_mm * depth_mm * modulus_mpa / ellipk(m)
