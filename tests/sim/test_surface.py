"""Bodies by their surface: any underside is pressed at its size, and what is none is refused in a sentence."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from pydantic import TypeAdapter

from gelgap.sim import Cylinder, Elastomer, Pose, Sharing, Sphere, Surface, load_indenter, solve_pose
from gelgap.sim.grading import sizes_along
from gelgap.sim.height_grid import lower_side_mm, rolled_mm
from gelgap.sim.indenter import Symmetry
from gelgap.sim.objects import OBJECTS
from gelgap.sim.plan import plan_visit
from gelgap.sim.shapes import AnyIndenter


def over_a_square(half_mm: float, spacing_mm: float) -> tuple[np.ndarray, np.ndarray]:
    count = round(half_mm / spacing_mm)
    place = np.arange(-count, count + 1) * spacing_mm
    return np.meshgrid(place, place)


def ball_mm(x: np.ndarray, y: np.ndarray, radius_mm: float) -> np.ndarray:
    square = x**2 + y**2
    height = radius_mm - np.sqrt(np.maximum(radius_mm**2 - square, 0.0))
    return np.where(square <= radius_mm**2, height, np.inf)


GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=0.5)
BALL = Surface.of(ball_mm(*over_a_square(1.52, 0.04), 1.5), 0.04, height_mm=3.0)
X, Y = over_a_square(3.0, 0.05)
TWO = Surface.of(np.minimum(ball_mm(X - 1.5, Y, 1.2), ball_mm(X + 1.5, Y, 1.2)), 0.05, height_mm=2.4)


def test_the_surface_of_a_ball_is_the_sphere() -> None:
    rng = np.random.default_rng(0)
    outwards = rng.normal(size=(500, 3))
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    outwards[:, 2] = -np.abs(outwards[:, 2])
    points = np.array([0.0, 0.0, 1.5]) + outwards * rng.uniform(1.4, 1.7, (500, 1))
    points = points[points[:, 2] < 0.9]
    sphere, found = Sphere().project(points - [0.0, 0.0, 1.5]), BALL.project(points)
    np.testing.assert_allclose(found.distance_mm, sphere.distance_mm, atol=3e-3)
    assert (found.outward_normal * sphere.outward_normal).sum(axis=1).min() > np.cos(np.radians(2))
    assert BALL.symmetry is Symmetry.REVOLUTION
    assert BALL.penetration_radius_mm(0.4) == pytest.approx(Sphere().penetration_radius_mm(0.4), abs=2e-3)
    assert BALL.curvature(0.4, 0, 0.1)[1].min() == pytest.approx(1.5, abs=0.15)


def test_the_gradient_is_continuous_where_two_bodies_meet() -> None:
    x = np.linspace(-0.2, 0.2, 401)
    normal = TWO.project(np.stack([x, 0 * x, 0 * x + 0.9], 1)).outward_normal
    assert np.linalg.norm(np.diff(normal, axis=0), axis=1).max() < 0.4


def test_a_cut_of_several_patches_has_the_width_of_one() -> None:
    radius_mm = np.sqrt(2 * 1.2 * 0.2 - 0.2**2)
    rim_mm = [[-1.5 - radius_mm, 1.5 + radius_mm], [-radius_mm, radius_mm]]
    np.testing.assert_allclose(TWO.cut_mm(0.2), rim_mm, atol=0.01)
    assert TWO.contact_radius_mm(0.2) == pytest.approx(radius_mm, abs=0.03)
    assert TWO.symmetry is Symmetry.MIRROR
    assert TWO.yawed(30.0).symmetry is Symmetry.NONE
    assert TWO.yawed(90.0).cut_mm(0.2)[1, 1] == pytest.approx(1.5 + radius_mm, abs=0.01)
    tilted = TWO.model_copy(update={"tilt_deg": (0.0, 10.0)})
    assert tilted.origin_height_mm > 1.5 * np.sin(np.radians(10)) - 0.05


def test_a_ball_rounds_edges_and_fills_creases() -> None:
    inside = np.abs(X) < 1.5
    face = rolled_mm(np.where(inside, 0.0, np.inf), 0.5, 0.05)
    np.testing.assert_allclose(face[30, np.abs(X[0]) < 0.99], 0.0, atol=1e-12)
    at = np.abs(X[0] - 1.2).argmin()
    assert face[30, at] == pytest.approx(0.5 - np.sqrt(0.5**2 - 0.25**2), abs=0.03)
    groove = rolled_mm(np.where(np.abs(X) < 0.3, 1.0, 0.0), 0.5, 0.05)
    # It enters until it touches both rounded lips, 1.6 mm apart.
    assert groove[30, 60] == pytest.approx(0.4, abs=0.03)


def test_the_lowest_of_what_crosses_itself_counts() -> None:
    plate, ball = trimesh.creation.box((4, 4, 1)), trimesh.creation.icosphere(subdivisions=4, radius=1)
    both = trimesh.util.concatenate([plate, ball])
    heights = lower_side_mm(np.array(both.triangles), (2.5, 2.5), 0.05)
    middle = heights.shape[0] // 2
    assert heights[middle, middle] == pytest.approx(-1.0, abs=2e-3)
    assert heights[middle, middle + 30] == pytest.approx(-0.5)
    assert heights[middle, 0] == np.inf


def test_a_mesh_that_is_not_convex_is_pressed_by_its_surface(tmp_path: Path) -> None:
    trimesh.creation.torus(2, 0.6).export(tmp_path / "ring.stl")
    ring = load_indenter(str(tmp_path / "ring.stl"))
    assert isinstance(ring, Surface)
    assert ring.height_mm == pytest.approx(1.2, abs=0.01)
    assert ring.contact_radius_mm(0.2) == pytest.approx(np.sqrt(2 * 0.6 * 0.2 - 0.04), abs=0.03)
    kind = TypeAdapter(AnyIndenter)
    assert kind.validate_json(kind.dump_json(ring)) == ring


def test_a_height_map_is_pressed_at_its_scale(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    values = np.zeros((60, 80), np.uint16)
    values[20:40, 30:50] = 20_000
    cv2.imwrite(str(tmp_path / "relief.png"), values)
    (tmp_path / "relief.toml").write_text('map = "relief.png"\nspacing_mm = 0.1\nstep_mm = 5e-5\n')
    relief = load_indenter(str(tmp_path / "relief.toml"))
    assert relief.deepest_mm == pytest.approx(1.0)
    np.testing.assert_allclose(relief.cut_mm(0.5), [[-1, 1], [-1, 1]], atol=0.1)
    np.save(tmp_path / "relief.npy", values * 5e-5)
    same = load_indenter(str(tmp_path / "relief.npy"), spacing_mm=0.1)
    np.testing.assert_array_equal(same.cut_mm(0.5), relief.cut_mm(0.5))
    np.save(tmp_path / "metres.npy", values * 5e-8)
    metres = load_indenter(str(tmp_path / "metres.npy"), spacing_mm=0.1, step_mm=1000.0)
    assert metres.deepest_mm == pytest.approx(1.0)
    np.save(tmp_path / "camera.npy", 300.0 - values * 5e-5)
    seen = load_indenter(str(tmp_path / "camera.npy"), spacing_mm=0.1, step_mm=-1.0)
    np.testing.assert_allclose(seen.cut_mm(0.5), relief.cut_mm(0.5), atol=1e-6)
    assert "are 0" not in caplog.text
    distances_mm = 200.0 - values * 5e-5
    distances_mm[3, 4:6] = 0
    np.save(tmp_path / "holes.npy", distances_mm)
    load_indenter(str(tmp_path / "holes.npy"), spacing_mm=0.1, step_mm=-1.0)
    assert "holes.npy: 2 places are 0 and touch first" in caplog.text


@pytest.mark.parametrize(
    ("values", "fields", "message"),
    [
        (np.ones((20, 20)), {"spacing_mm": 0.1}, "heights differ by 0 mm"),
        (1e-3 * np.eye(20), {"spacing_mm": 0.1}, "by 0.001 mm, must .* step_mm .* 1000 if in m"),
        (np.full((20, 20), np.nan), {"spacing_mm": 0.1}, "hold NaN or an infinity .*: fill in"),
        (np.eye(20), {"spacing_mm": "0.1"}, "spacing_mm = '0.1': must be 0 to 1"),
        (np.eye(20), {"spacing_mm": 0.1, "edge_radius_mm": "0.1"}, "edge_radius_mm = '0.1': input should be"),
        (np.eye(20), {}, "not 0, as spacing_mm=0.05"),
        (np.eye(20), {"spacing_mm": 0.1, "step_mm": -1001.0}, "step_mm = -1001.0: must be -1000 to"),
        (np.zeros(20), {"spacing_mm": 0.1}, "must be 3 to"),
        (np.array([["a"]]), {"spacing_mm": 0.1}, "must be numbers"),
        (np.array([None]), {"spacing_mm": 0.1}, "is not a .npy file of numbers"),
        (np.eye(20), {"spacing_mm": 0.1, "diameter_mm": 3}, "diameter_mm: a surface has none"),
    ],
)
def test_what_is_no_map_is_refused(tmp_path: Path, values: np.ndarray, fields: dict, message: str) -> None:
    np.save(tmp_path / "map.npy", values)
    with pytest.raises(ValueError, match=message):
        load_indenter(str(tmp_path / "map.npy"), **fields)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.toml", b"shape = ['sphere']", r"shape = \['sphere'\]: must be a name in quotes"),
        ("a.toml", b"object = 'nut'\nedge_radius_mm = '1'", "edge_radius_mm = '1': input should be"),
        ("a.toml", b"map = 'a.csv'\nspacing_mm = 0.1", r"a\.csv': a height map's name ends in \.npy, \.png"),
        ("a.npy", b"PK\3\4", "is not a .npy file of numbers"),
        ("a.png", cv2.imencode(".png", np.eye(20)[..., None] * [9, 9, 9, 9])[1].tobytes(), "are transparent"),
    ],
)
def test_files_that_are_no_bodies_are_refused(tmp_path: Path, name: str, text: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(text)
    with pytest.raises(ValueError, match=message):
        load_indenter(
            str(tmp_path / name), **({} if name == "a.toml" else {"spacing_mm": 0.1, "step_mm": 0.1})
        )


def test_what_is_thinner_than_its_rounding_is_refused() -> None:
    with pytest.raises(ValueError, match="more than half as wide"):
        Surface.of(np.where(np.abs(X) < 0.2, 0.0, np.inf), 0.05, height_mm=3.0, edge_radius_mm=0.5)


def test_a_surface_of_damaged_heights_is_refused() -> None:
    for heights in ("", "AAAA", BALL.heights[:-8]):
        with pytest.raises(ValueError, match="heights"):
            Surface.model_validate(BALL.model_dump() | {"heights": heights})


SUM = """
yaw_deg = 90
[[parts]]
shape = "sphere"
diameter_mm = 3.0
at_mm = [-1.6, 0]
[[parts]]
shape = "box"
size_mm = [2, 1]
at_mm = [1.6, 0.0, 0.1]
"""


def test_bodies_at_their_places_are_pressed_as_one(tmp_path: Path) -> None:
    (tmp_path / "sum.toml").write_text(SUM)
    both = load_indenter(str(tmp_path / "sum.toml"))
    ball_mm = Sphere().penetration_radius_mm(0.3)
    # Turned by 90°, x becomes y: the box's end, 2.6 mm from the axis, and the ball's rim on the other side.
    np.testing.assert_allclose(both.cut_mm(0.3), [[-ball_mm, ball_mm], [-1.6 - ball_mm, 2.6]], atol=0.03)
    assert both.cut_mm(0.05)[1, 1] < 0
    assert both.deepest_mm == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("yaw_deg = 3", "nothing: an indenter has one of shape, mesh, map, object, parts"),
        ("shape = 'box'\nobject = 'key'", "shape, object: an indenter has one of"),
        ("parts = 3", "must be tables"),
        ("[[parts]]\nshape = 'box'\nat_mm = [1]", "part 1: must be two or three numbers"),
        ("[[parts]]\nshape = 'box'\nat_mm = [1, 80]", "part 1: must be within ±50 mm"),
        ("[[parts]]\nshape = 'box'\nradius_mm = 3", "part 1: radius_mm: a box has none"),
        ("flip = true\nobject = 'key'", "flip: a surface has none"),
    ],
)
def test_what_is_no_body_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "body.toml").write_text(text)
    with pytest.raises(ValueError, match=message):
        load_indenter(str(tmp_path / "body.toml"))


def test_a_sharp_mesh_is_rounded_with_a_word(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    trimesh.creation.box((4, 3, 3)).export(tmp_path / "box.stl")
    assert load_indenter(str(tmp_path / "box.stl")).edge_radius_mm == 0.25
    assert "its sharp edges are rounded by 0.25 mm" in caplog.text
    assert load_indenter(str(tmp_path / "box.stl"), edge_radius_mm=0.0).edge_radius_mm == 0
    trimesh.creation.icosphere(3, 2.0).export(tmp_path / "ball.stl")
    assert load_indenter(str(tmp_path / "ball.stl")).edge_radius_mm == 0


def test_no_edge_seems_sharper_than_the_ball_that_rounded_it() -> None:
    moon = np.where((np.hypot(X, Y) < 2.5) & (np.hypot(X - 1.5, Y) > 2.0), 0.0, np.inf)
    body = Surface.of(moon, 0.05, height_mm=4.0, edge_radius_mm=0.25)
    assert min(body.curvature(0.3, axis, 0.15)[1].min() for axis in (0, 1)) >= 0.25


@pytest.mark.parametrize("name", OBJECTS)
def test_an_object_is_a_preset(name: str) -> None:
    body = load_indenter(name, edge_radius_mm=0.0)
    assert isinstance(body, Surface)
    assert body.deepest_mm >= 0.8
    assert np.ptp(body.cut_mm(0.3), axis=1).min() > 1.5


def test_a_press_takes_the_closed_forms_force() -> None:
    gel = Elastomer.preset("b0")
    punch = Cylinder(diameter_mm=2.0, edge_radius_mm=0.4)
    along = np.hypot(*over_a_square(1.04, 0.04)) - 0.6
    heights = np.where(
        along <= 0.4, 0.4 - np.sqrt(np.maximum(0.16 - np.maximum(along, 0.0) ** 2, 0.0)), np.inf
    )
    bodies = punch, Surface.of(heights, 0.04, height_mm=10.0)
    own, surface = (
        solve_pose(gel, body, Pose(depth_mm=0.3), "draft", Sharing(cache=False)) for body in bodies
    )
    assert surface.converged
    assert surface.force_n[2] == pytest.approx(own.force_n[2], rel=0.015)
    near = np.hypot(*np.meshgrid(own.x_mm, own.y_mm)) < 3
    off_mm = surface.displacement_mm - own.displacement_mm
    assert np.sqrt((off_mm[near] ** 2).mean()) < 4e-3


def test_a_rounding_that_ends_at_a_wall_between_two_places_keeps_its_radius() -> None:
    punch = Cylinder(diameter_mm=3.0, edge_radius_mm=0.3)
    along = np.hypot(*over_a_square(1.52, 0.04)) - 1.2
    heights = 0.3 - np.sqrt(np.maximum(0.09 - np.maximum(along, 0.0) ** 2, 0.0))
    surface = Surface.of(np.where(along <= 0.3, heights, np.inf), 0.04, height_mm=6.0)
    turn, slope = np.meshgrid(np.linspace(0, 2 * np.pi, 200), np.radians(np.linspace(0, 90, 40)))
    radius = 1.2 + 0.3 * np.sin(slope)
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), 0.3 - 0.3 * np.cos(slope)], axis=-1)
    np.testing.assert_allclose(punch.project(points).distance_mm, 0.0, atol=1e-9)
    off_mm = surface.project(points).distance_mm
    assert np.abs(off_mm.mean()) < 3e-3
    assert np.abs(off_mm[20:].mean()) < 5e-3
    # A step shorter than the heights' spacing finds their facets, or an outline's steps, and takes them for edges.
    assert surface.curvature(0.29, 0, 0.01)[1].min() > 0.1


def test_a_body_mirrored_in_one_plane_is_turned_so_that_half_of_it_is_solved() -> None:
    lopsided = Surface.of(
        np.minimum(ball_mm(X, Y - 1.5, 1.2), 0.1 + ball_mm(X, Y + 1.5, 1.2)), 0.05, height_mm=2.4
    )
    assert lopsided.symmetry is Symmetry.MIRROR_X
    assert lopsided.yawed(90.0).symmetry is Symmetry.MIRROR_Y
    assert lopsided.straightened().yaw_deg == 90.0
    problem = plan_visit(GEL, lopsided, (Pose(depth_mm=0.3),), "draft").solves[0].problem
    assert problem.symmetric


def test_a_whole_pad_has_fewer_lines_under_a_body_of_many_features() -> None:
    problem = plan_visit(GEL, load_indenter("letters"), (Pose(depth_mm=0.3),), "draft").solves[0].problem
    assert not problem.symmetric
    for axis in (0, 1):
        low, high = problem.cut_mm[axis]
        assert len(sizes_along(problem, axis, 2.5, (0.0, 0.0)).positions_mm(low, high)) <= 17
