"""A library serves any pose in its ranges from a few solves, says how far off it is, and generation uses it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from distributed import Client, LocalCluster
from hypothesis import given, settings
from hypothesis import strategies as st

from gelgap.data import open_domain
from gelgap.domains import TactileSensor, estimate, make_recipes
from gelgap.domains.generation.generate import GenerationReport, generate_recipes
from gelgap.domains.generation.plan import Contacts
from gelgap.sim import (
    Edge,
    Elastomer,
    LibraryPlan,
    Pose,
    PoseLibrary,
    PosePath,
    PoseRanges,
    Sphere,
    library,
    solve_pose,
)

GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.5)
RANGES = PoseRanges(0.05, 0.1, travel_mm=0.06)
SMALL = {"size_px": (64, 48), "render_quality": "draft", "quality": "draft"}


pytestmark = pytest.mark.usefixtures("few_solves")


@pytest.fixture(scope="module")
def plan(few_solves: None, solve_cache: None) -> LibraryPlan:
    return LibraryPlan(GEL, Sphere(), RANGES)


@pytest.fixture(scope="module")
def checked(plan: LibraryPlan) -> PoseLibrary:
    return plan.served_by({solve.key: solve.run() for solve in plan.solves})


def test_a_solved_pose_is_given_back(plan: LibraryPlan, checked: PoseLibrary) -> None:
    pose = plan.solved.poses[-1]
    solved = {solve.key: solve.run() for solve in plan.solved.solves}
    exact, served = plan.solved.state(len(plan.solved.poses) - 1, solved), checked.state(GEL, pose)
    np.testing.assert_allclose(served.force_n, exact.force_n, rtol=1e-6, atol=1e-9)
    on_its_grid = checked.state(GEL, pose, axes_mm=(exact.x_mm, exact.y_mm))
    np.testing.assert_allclose(on_its_grid.displacement_mm, exact.displacement_mm, atol=2e-6)
    np.testing.assert_array_equal(on_its_grid.contact, exact.contact)
    assert served.contact_radius_mm == pytest.approx(exact.contact_radius_mm)
    assert exact.diagnostics.slip == served.diagnostics.slip != "stick"
    for name in ("sticking_fraction", "slip_mm", "elastic_energy_mj", "residual", "coulomb_excess"):
        assert getattr(served.diagnostics, name) == pytest.approx(getattr(exact.diagnostics, name)), name


def test_held_out_poses_tell_the_error_of_those_between(checked: PoseLibrary) -> None:
    row = checked.held_out.iloc[1]
    pose = Pose(depth_mm=row["depth_mm"], shear_x_mm=row["travel_mm"])
    exact, served = solve_pose(GEL, Sphere(), pose, "draft"), checked.state(GEL, pose)
    off = np.linalg.norm(served.force_n - exact.force_n) / np.linalg.norm(exact.force_n)
    assert off == pytest.approx(row["force_share"], abs=0.02)
    assert 0 < checked.errors["force_rms_percent"] < 5
    assert 0 < checked.errors["membrane_rms_um"] < 5
    assert served.diagnostics.contact_radius_error_mm > checked.errors["radius_rms_um"] / 1000 > 0
    assert served.diagnostics.fz_error_n > row["force_n"] * checked.errors["force_rms_percent"] / 100 * 0.5
    press, worse = Pose(depth_mm=0.07), replace(checked, held_out=checked.held_out.assign(force_share=0.04))
    assert not checked.state(GEL, press).diagnostics.coarse
    assert worse.state(GEL, press).diagnostics.coarse


@settings(max_examples=25, deadline=None)
@given(
    depth=st.floats(0.05, 0.1),
    share=st.floats(0.01, 1),
    angle=st.floats(0, 6.3),
    x=st.floats(-4, 4),
    y=st.floats(-2, 2),
)
def test_points_and_directions_move_and_turn_what_is_served(checked, depth, share, angle, x, y) -> None:
    travel = share * RANGES.farthest_mm(depth) * 0.999
    along_x = checked.state(GEL, Pose(depth_mm=depth, shear_x_mm=travel))
    turned = Pose(
        depth_mm=depth,
        shear_x_mm=travel * np.cos(angle),
        shear_y_mm=travel * np.sin(angle),
        point_x_mm=x,
        point_y_mm=y,
    )
    served = checked.state(GEL, turned)
    tangent, normal = along_x.force_n[0], along_x.force_n[2]
    expected = [tangent * np.cos(angle), tangent * np.sin(angle), normal]
    np.testing.assert_allclose(served.force_n, expected, atol=1e-6 * abs(normal))
    deepest = along_x.displacement_mm[..., 2].min()
    assert served.displacement_mm[..., 2].min() == pytest.approx(deepest, abs=2e-3)


def test_force_is_that_of_the_modulus(checked: PoseLibrary) -> None:
    pose, stiff = Pose(depth_mm=0.07), GEL.model_copy(update={"young_modulus_mpa": 0.9})
    np.testing.assert_allclose(
        checked.state(stiff, pose).force_n, 3 * checked.state(GEL, pose).force_n, rtol=1e-6
    )
    assert LibraryPlan(stiff, Sphere(), RANGES).key == checked.plan.key


def test_a_pose_has_its_pressure_and_the_indenters_place(checked: PoseLibrary) -> None:
    pose = Pose(depth_mm=0.08, shear_y_mm=0.03, point_x_mm=1.0)
    exact, served = solve_pose(GEL, Sphere(), pose, "draft"), checked.pose(GEL, pose)
    np.testing.assert_allclose(served.indenter_mm, exact.indenter_mm, atol=1e-9)
    assert served.pressure_mpa.max() == pytest.approx(exact.pressure_mpa.max(), rel=0.1)
    assert served.pressure_mpa.min() == 0
    assert served.pressure_mpa.sum() == pytest.approx(exact.pressure_mpa.sum(), rel=0.1)
    untouched = checked.pose(GEL, Pose(depth_mm=0.0))
    assert not untouched.pressure_mpa.any()
    assert not untouched.displacement_mm.any()


def test_an_equilibrium_that_did_not_converge_flags_the_poses_around_it(checked: PoseLibrary) -> None:
    flags = checked.numbers["converged"].copy()
    flags[-1, 0] = False
    doubtful = replace(checked, numbers=checked.numbers | {"converged": flags})
    assert not doubtful.state(GEL, Pose(depth_mm=0.1)).converged
    assert doubtful.state(GEL, Pose(depth_mm=checked.depths_mm[0])).converged


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (Pose(depth_mm=0.2), "depth_mm = 0.2: the library ends at 0.1 mm"),
        (Pose(depth_mm=0.08, shear_x_mm=0.1), "shear = 0.1 mm: at a depth of 0.08 mm the library ends"),
        (Pose(depth_mm=0.08, point_x_mm=11.0), "a library serves points"),
    ],
)
def test_a_pose_outside_is_refused(checked: PoseLibrary, pose: Pose, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        checked.state(GEL, pose)


@pytest.mark.parametrize(
    "field", [{"friction": 0.3}, {"thickness_mm": 2.0}, {"mount_stiffness_n_per_mm": 5.0}]
)
def test_another_gel_is_refused(checked: PoseLibrary, field: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(field))} = .*: must be the library's"):
        checked.state(GEL.model_copy(update=field), Pose(depth_mm=0.07))


def test_a_mount_that_grows_with_the_modulus_is_served(checked: PoseLibrary) -> None:
    soft, hard = (
        GEL.model_copy(
            update={"young_modulus_mpa": modulus_mpa, "mount_stiffness_n_per_mm": 10 * modulus_mpa}
        )
        for modulus_mpa in (0.3, 0.7)
    )
    mounted, pose = replace(checked, plan=replace(checked.plan, elastomer=soft)), Pose(depth_mm=0.07)
    np.testing.assert_allclose(
        mounted.state(hard, pose).force_n * 0.3, mounted.state(soft, pose).force_n * 0.7
    )


def test_where_no_held_out_pose_converges_estimates_are_the_librarys_own_and_that_is_said(
    plan: LibraryPlan, checked: PoseLibrary, caplog: pytest.LogCaptureFixture
) -> None:
    solutions = {solve.key: solve.run() for solve in plan.solves}
    for held_out in plan.held_out:
        for solve in held_out.solves:
            failed = tuple(replace(one, converged=False) for one in solutions[solve.key].records)
            solutions[solve.key] = replace(solutions[solve.key], records=failed)
    unmeasured = plan.served_by(solutions)
    assert unmeasured.errors["held_out_unconverged"] == len(checked.held_out)
    assert "no held-out pose of a library converged" in caplog.text
    pose = Pose(depth_mm=0.07)
    found, own = (one.state(GEL, pose).diagnostics for one in (unmeasured, replace(checked, held_out=None)))
    assert found == own
    assert found.fz_error_n > 0
    report = GenerationReport(Path(), ("a",), (), *(0,) * 7, 1.0, {"a": unmeasured.errors})
    assert "a: poses interpolated; no held-out pose converged" in str(report)


def test_where_the_error_is_too_large_a_depth_is_added(
    plan: LibraryPlan, checked: PoseLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(library, "MEMBRANE_BOUND_UM", 1e-6)
    monkeypatch.setattr(library, "MOST_SOLVES", checked.solves + 2)
    refined = plan.served_by({solve.key: solve.run() for solve in plan.solves})
    assert set(checked.depths_mm) < set(refined.depths_mm)
    assert refined.solves <= checked.solves + 2
    assert not refined.errors["within_bounds"]


@pytest.fixture(scope="module")
def random_path() -> PosePath:
    ranges = {"depth_mm": (0.05, 0.1), "radius_mm": (0.0, 0.06)}
    return PosePath.random("many", number=30, seed=3, point_x_mm=(-3, 3), point_y_mm=(-2, 2), **ranges)


def test_generation_serves_a_random_path_from_a_library(tmp_path: Path, random_path: PosePath) -> None:
    recipes = make_recipes(["mb0i0"], random_path, **SMALL)
    said = estimate(recipes)
    assert len(said.plan.solves) <= library.MOST_SOLVES < len(said.exact.plan.solves) == 10
    assert "--set interpolated=false" in str(said)
    report = generate_recipes(recipes, tmp_path, scheduler="synchronous")
    manifest = json.loads((tmp_path / "mb0i0" / "manifest.json").read_text())
    assert manifest["configuration"]["interpolated"]
    assert manifest["interpolation"] == report.interpolation["mb0i0"]
    assert manifest["interpolation"]["solves"] == report.solves == len(said.plan.solves)
    assert "held-out poses" in str(report)
    frames = open_domain(tmp_path / "mb0i0")
    depths = np.array([pose.depth_mm for pose in random_path.poses])
    assert np.corrcoef(depths**1.5, -frames.force_n[:, 2])[0, 1] > 0.99
    shards = [path.read_bytes() for path in sorted((tmp_path / "mb0i0").glob("*.parquet"))]
    with Client(LocalCluster(1, processes=False, dashboard_address=None)) as client:
        address = client.scheduler.address
        generate_recipes(recipes, tmp_path / "cluster", scheduler=address)
    on_cluster = tmp_path / "cluster" / "mb0i0"
    assert [path.read_bytes() for path in sorted(on_cluster.glob("*.parquet"))] == shards
    assert json.loads((on_cluster / "manifest.json").read_text()) == manifest
    again = generate_recipes(recipes, tmp_path, scheduler="synchronous")
    assert again.skipped == ("mb0i0",)
    assert again.interpolation == report.interpolation


def test_exact_solves_each_pose_and_its_configuration_is_as_before(random_path: PosePath) -> None:
    exact, served = (make_recipes(["mb0i0"], random_path, exact=exact, **SMALL)[0] for exact in (True, False))
    assert "interpolated" not in exact.configuration()
    assert exact.key != served.key
    few = PosePath("few", random_path.poses[:10])
    assert not make_recipes(["mb0i0"], few, **SMALL)[0].interpolated


def test_poses_that_a_library_does_not_reach_are_solved(random_path: PosePath) -> None:
    at_the_edge = replace(random_path.poses[1], point_x_mm=11.0)
    path = PosePath("edge", (*random_path.poses, at_the_edge))
    contacts = Contacts.interpolated(GEL, Sphere(), path, "draft")
    last = len(path.poses) - 1
    assert 0 not in contacts.libraries
    assert 0 not in contacts.plan.placements
    assert sorted(contacts.libraries) == list(range(1, last))
    assert list(contacts.plan.placements) == [last]
    assert contacts.source_keys() == {contacts.libraries[1].key, contacts.plan.solves[0].key}
    end = contacts.part(last - 1, last + 5)
    assert end.poses == path.poses[last - 1 :]
    assert list(end.libraries) == [0]
    assert list(end.plan.placements) == [1]


def test_what_a_library_does_not_serve_is_refused_before_anything_is_solved(random_path: PosePath) -> None:
    with pytest.raises(ValueError, match=r"indenter \(edge, .*\): a library serves bodies of revolution"):
        LibraryPlan(GEL, Edge(), RANGES)
    with pytest.raises(ValueError, match=r"deepest_mm = 5, .* must be in \[0, 1.5\] mm"):
        TactileSensor(GEL, deepest_mm=5)
    with pytest.raises(ValueError, match=r"farthest drag 4 mm: .* at most the pad's thickness, 3 mm"):
        TactileSensor(GEL, farthest_mm=4)
    for fields in (
        {"columns": ("traction",)},
        {"indenter": Edge()},
        {"further_indenters": (Sphere(diameter_mm=4),)},
    ):
        with pytest.raises(ValueError, match=r"interpolated = true: .* has no tractions"):
            make_recipes(["mb0i0"], random_path, interpolated=True, **fields, **SMALL)
