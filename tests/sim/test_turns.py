"""Indenters that turn on their way: twists and rolls, by theory, by symmetry, and by what comes to the same."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter

from gelgap.assets import asset_path
from gelgap.sim import Box, Cone, Cylinder, Edge, Elastomer, Ellipsoid, Pose, Sharing, Sphere, solve_poses
from gelgap.sim.indenter import rotation
from gelgap.sim.path import PosePath, load_path
from gelgap.sim.plan import plan_solves, plan_visit
from gelgap.sim.problem import ContactProblem
from gelgap.sim.rounded import Shape

NO_SLIP = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=10.0)
FRICTIONLESS = NO_SLIP.model_copy(update={"friction": 0.0})
ALONE = Sharing(cache=False)
PRESSED = Pose(depth_mm=0.4)
angles = st.floats(-15, 15)


@settings(deadline=None, max_examples=40)
@given(
    body=st.sampled_from(
        (Cylinder(edge_radius_mm=0.3), Cone(), Edge(yaw_deg=20), Box(tilt_deg=(2, 3)), Ellipsoid())
    ),
    turn=st.tuples(angles, angles, angles),
    point=st.tuples(st.floats(-4, 4), st.floats(-4, 4), st.floats(-2, 3)),
)
def test_a_turned_body_is_as_in_turned_axes(
    body: Shape, turn: tuple[float, ...], point: tuple[float, ...]
) -> None:
    matrix, points = rotation(np.array(turn)), np.array([point])
    turned = body.turned(turn).project(points @ matrix.T)
    own = body.project(points)
    assert turned.distance_mm == pytest.approx(own.distance_mm, abs=1e-6)
    # Deep inside, several places of the surface are equally near, and rounding chooses.
    assume(own.distance_mm[0] > -0.1)
    np.testing.assert_allclose(turned.outward_normal, own.outward_normal @ matrix.T, atol=1e-5)


def test_what_a_turn_does_not_show_is_not_turned() -> None:
    assert Sphere().turned((10.0, 20.0, 30.0)) == Sphere()
    assert Cylinder().turned((0.0, 0.0, 30.0)) == Cylinder()
    assert Edge(yaw_deg=10).turned((0.0, 0.0, 30.0)) == Edge(yaw_deg=40)


@pytest.fixture(scope="module")
def twisted() -> dict[float, tuple]:
    return {
        twist: solve_poses(NO_SLIP, Sphere(), (PRESSED, replace(PRESSED, twist_deg=twist)), "draft", ALONE)
        for twist in (1.0, -1.0)
    }


def test_a_bonded_twist_takes_the_torque_of_finite_elements(twisted: dict[float, tuple]) -> None:
    """A per cent of the contact's radius makes three of the torque."""
    pressed, found = twisted[1.0]
    table = pd.read_csv(asset_path("reference", "shapes", "torque.csv"))
    (per_deg,) = table.query("case == 'val_sph_R1.5_h3_nu48_stick' and depth_mm == 0.4")["T_per_deg_best_Nmm"]
    assert found.converged
    assert found.torque_n_mm[2] == pytest.approx(per_deg, rel=0.08)
    np.testing.assert_allclose(found.force_n, pressed.force_n, atol=1e-4)
    np.testing.assert_allclose(found.torque_n_mm[:2], 0.0, atol=1e-5)


def test_a_mirrored_twist_gives_the_mirror_image(twisted: dict[float, tuple]) -> None:
    one, other = (twisted[twist][1] for twist in (1.0, -1.0))
    assert one.torque_n_mm[2] == pytest.approx(-other.torque_n_mm[2], rel=1e-4)
    image = other.displacement_mm[::-1] * [1, -1, 1]
    np.testing.assert_allclose(one.displacement_mm, image, atol=2e-4)
    around = -one.displacement_mm[..., 0] * one.y_mm[:, None] + one.displacement_mm[..., 1] * one.x_mm
    assert around[one.contact].mean() > 0


def test_beyond_coulombs_bound_the_contact_turns_below_the_indenter() -> None:
    """By Hertz, full slip takes 3π/16 μ P a (Johnson 1985, eq. 7.45): pressure is most where the lever is short."""
    gel = Elastomer(
        young_modulus_mpa=0.3, poisson_ratio=0.48, friction=0.3, thickness_mm=10, pad_size_mm=(90, 90)
    )
    pose = Pose(depth_mm=0.1)
    poses = (pose, *(replace(pose, twist_deg=twist) for twist in (2.0, 20.0)))
    pressed, *turned = solve_poses(gel, Sphere(diameter_mm=6.0), poses, "draft", ALONE)
    full_n_mm = 3 * math.pi / 16 * 0.3 * -pressed.force_n[2] * pressed.contact_radius_mm
    torque = [state.torque_n_mm[2] for state in turned]
    assert all(state.converged for state in turned)
    assert 0 < torque[0] < torque[1]
    assert torque[1] == pytest.approx(full_n_mm, rel=0.1)
    assert [state.diagnostics.slip for state in turned] == ["partial", "gross"]
    # What sticks is the vertex in the middle, which the turn does not move.
    assert turned[-1].diagnostics.sticking_fraction < 0.1
    assert np.linalg.norm(turned[-1].force_n[:2]) < 0.02 * -pressed.force_n[2]


@pytest.mark.usefixtures("coarse")
def test_what_slides_wholly_is_dragged_the_way_it_goes_though_it_twists() -> None:
    """Pressure and slip are symmetric about that way; friction along a load step's chords is a tenth off it."""
    gel = NO_SLIP.model_copy(update={"friction": 0.05})
    x, y, _ = solve_poses(
        gel, Sphere(), (Pose(depth_mm=0.1, shear_x_mm=0.05, twist_deg=20.0),), "draft", ALONE
    )[0].force_n
    assert abs(y) < 0.03 * x


def test_a_rolling_sphere_hardly_drags() -> None:
    way = {"shear_x_mm": 1.5 * math.radians(8.0)}
    rolled, dragged = (
        solve_poses(
            NO_SLIP, Sphere(), (PRESSED, replace(PRESSED, **way, roll_deg=(0.0, roll))), "draft", ALONE
        )[1]
        for roll in (8.0, 0.0)
    )
    assert rolled.converged
    assert abs(rolled.force_n[0]) < 0.15 * dragged.force_n[0]
    assert rolled.force_n[2] == pytest.approx(dragged.force_n[2], rel=0.05)


@pytest.mark.slow
@pytest.mark.usefixtures("coarse")
def test_without_friction_a_turn_ends_where_a_turned_body_begins() -> None:
    body = Ellipsoid(diameters_mm=(5.0, 3.0, 3.0))
    pose = Pose(depth_mm=0.3)
    turned = solve_poses(FRICTIONLESS, body, (pose, replace(pose, twist_deg=10.0)), "draft", ALONE)[1]
    other = solve_poses(FRICTIONLESS, body.yawed(10.0), (pose,), "draft", ALONE)[0]
    assert turned.converged
    assert turned.force_n[2] == pytest.approx(other.force_n[2], rel=0.03)
    assert np.abs(turned.displacement_mm - other.displacement_mm)[..., 2].max() < 0.04
    assert abs(turned.torque_n_mm[2]) < 2e-3


def _plan(*poses: Pose, gel: Elastomer = NO_SLIP) -> list[ContactProblem]:
    return [
        solve.problem for solve in plan_solves(gel, Sphere(), PosePath("turns", poses), "draft", ALONE).solves
    ]


def test_what_turns_shares_with_the_same_alone() -> None:
    twist = replace(PRESSED, twist_deg=3.0)
    assert len(_plan(PRESSED, twist, replace(twist, point_x_mm=1.0))) == 2
    assert len(_plan(twist, replace(twist, twist_deg=-3.0))) == 2
    assert len(_plan(twist, gel=NO_SLIP.model_copy(update={"young_modulus_mpa": 0.6}))) == 1
    along, across = (_plan(replace(PRESSED, roll_deg=roll))[0] for roll in ((0.0, 3.0), (3.0, 0.0)))
    assert along.key == across.key
    assert along.symmetric
    assert not _plan(twist)[0].symmetric


def test_a_mirrored_corner_turns_the_other_way() -> None:
    corner = {"point_x_mm": 11.0, "point_y_mm": 9.0}
    one = plan_visit(NO_SLIP, Sphere(), (replace(PRESSED, twist_deg=3.0, **corner),), "draft", ALONE)
    mirrored = {"point_x_mm": -11.0, "point_y_mm": 9.0}
    other = plan_visit(NO_SLIP, Sphere(), (replace(PRESSED, twist_deg=-3.0, **mirrored),), "draft", ALONE)
    assert one.solves[0].key == other.solves[0].key


def test_problems_that_do_not_turn_are_named_as_before() -> None:
    problem, kind = _plan(PRESSED)[0], TypeAdapter(ContactProblem)
    content = json.loads(kind.dump_json(problem))
    content.pop("turns_deg", None)
    assert kind.validate_json(json.dumps(content)).key == problem.key
    assert _plan(replace(PRESSED, twist_deg=1.0))[0].key != problem.key
    assert "twist_deg" not in TypeAdapter(Pose).dump_python(PRESSED)
    turned = TypeAdapter(Pose).dump_python(replace(PRESSED, roll_deg=(1.0, 0.0)), mode="json")
    assert turned["roll_deg"] == [1.0, 0.0]


def test_a_trajectory_lists_its_turns(tmp_path: Path) -> None:
    file = tmp_path / "turns.toml"
    text = "[[trajectories]]\nwaypoints_mm = [[0, 0, 0.3], [0, 0, 0.3]]\n"
    file.write_text(text + "twist_deg = [0, 5]\nroll_deg = [[0, 0], [1, 0]]\n")
    assert [pose.turn_deg for pose in load_path(str(file)).poses[1:]] == [(0, 0, 0), (1, 0, 5)]
    for bad, words in (
        ("twist_deg = [0]", "twist_deg"),
        ("roll_deg = [1, 2]", "roll_deg"),
        ("yaw_deg = 1", "yaw"),
    ):
        file.write_text(text + bad)
        with pytest.raises(ValueError, match=words):
            load_path(str(file))


@pytest.mark.parametrize(
    ("body", "turn", "words"),
    [
        (Sphere(), {"twist_deg": 100.0}, "twist_deg"),
        (Sphere(), {"roll_deg": (0.0, -91.0)}, "roll_deg"),
        (Cylinder(edge_radius_mm=0.3), {"roll_deg": (0.0, 20.0)}, "roll_deg"),
        (Cylinder(edge_radius_mm=0.3), {"roll_deg": (0.0, 14.0)}, "lifts the far side"),
        (
            Ellipsoid(diameters_mm=(6.0, 3.0, 2.0)),
            {"depth_mm": 0.0, "roll_deg": (0.0, 10.0)},
            "reaches 0.129",
        ),
    ],
)
def test_a_turn_that_is_not_served_is_refused(body: Shape, turn: dict, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        plan_visit(NO_SLIP, body, (replace(Pose(depth_mm=0.2), **turn),), "draft")
