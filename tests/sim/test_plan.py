"""Plans: how many problems a path needs, and states made from shared solutions."""

import multiprocessing
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest

from gelgap.sim.indenter import Sphere
from gelgap.sim.newton import solve
from gelgap.sim.path import ContactPath, PosePath
from gelgap.sim.plan import SolvePlan, plan_solves, plan_visit
from gelgap.sim.scene import Elastomer, Pose, Sharing
from gelgap.sim.solution import cached_files, clear_cache, load_solution, store_solution

GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.5)
SMALL = GEL.model_copy(update={"pad_size_mm": (10.0, 8.0)})
SHORT = ContactPath("short", (-1.0, 1.0), (0.0,), (0.1,), (0.1,), (0.0, 90.0))


pytestmark = pytest.mark.usefixtures("coarse")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def _plan(gel: Elastomer = GEL, path: ContactPath = SHORT, sharing: Sharing | None = None) -> SolvePlan:
    return plan_solves(gel, Sphere(), path, "draft", sharing)


def test_interior_points_need_a_solve_for_each_descent() -> None:
    assert len(_plan(path=ContactPath.preset("paper")).solves) == 2
    assert len(_plan(path=ContactPath.preset("sparse")).solves) == 2


def test_depths_share_a_descent_and_drags_branch_off_it() -> None:
    path = ContactPath("depths", (0.0,), (0.0,), (0.3, 0.1, 0.2), (0.0, 0.1), (0.0,))
    plan = _plan(path=path)
    deep, shallow = (solve.problem for solve in plan.solves)
    assert deep.waypoints_mm == ((0.0, 0.0, -0.3), (0.1, 0.0, -0.3))
    assert shallow.waypoints_mm == ((0.0, 0.0, -0.1), (0.1, 0.0, -0.1), (0.0, 0.0, -0.2), (0.1, 0.0, -0.2))
    assert shallow.parents == (-1, 0, 0, 2)
    assert shallow.load_steps == 4
    assert sorted(plan.placements) == [*range(1, len(plan.poses))]
    for index, placement in plan.placements.items():
        pose = plan.poses[index]
        waypoint = plan.solves[placement.solve].problem.waypoints_mm[placement.record]
        assert waypoint == (pose.radius_mm, 0.0, -pose.depth_mm)


def test_depths_whose_contacts_differ_much_in_size_share_no_descent() -> None:
    path = ContactPath("depths", (0.0,), (0.0,), (0.02, 0.03, 0.4, 0.6, 1.0), (0.0,), (0.0,))
    solves = plan_solves(GEL, Sphere(), path, "draft").solves
    assert [[-z for _, _, z in solve.problem.waypoints_mm] for solve in solves] == [
        [1.0],
        [0.4, 0.6],
        [0.03],
        [0.02],
    ]
    for one in solves:
        narrowest = min(-z for _, _, z in one.problem.waypoints_mm)
        assert one.problem.penetration_radius_mm < 2.7 * Sphere().penetration_radius_mm(narrowest)


def test_a_small_pad_shares_by_reflection_alone() -> None:
    path = ContactPath.preset("paper")
    mirrored = len(_plan(SMALL, path).solves)
    apart = len(_plan(SMALL, path, Sharing(reflection=False)).solves)
    assert apart == 30 * 2
    assert mirrored == 9 * 2


def test_each_saving_can_be_switched_off() -> None:
    path = ContactPath.preset("smoke")
    assert len(_plan(path=path).solves) == 2
    assert len(_plan(path=path, sharing=Sharing(path=False)).solves) == 4 * 36
    assert len(_plan(path=path, sharing=Sharing(translation=False, reflection=False)).solves) == 4 * 2


def test_another_modulus_needs_no_new_solve_unless_the_mount_gives_way() -> None:
    def keys(gel: Elastomer) -> set[str]:
        return {solve.key for solve in _plan(gel).solves}

    harder = GEL.model_copy(update={"young_modulus_mpa": 0.8})
    assert keys(harder) == keys(GEL)
    as_low, higher = (GEL.model_copy(update={"static_friction": GEL.friction * by}) for by in (1.0, 1.5))
    assert keys(as_low) == keys(GEL)
    assert (
        keys(harder.model_copy(update={"static_friction": higher.static_friction}))
        == keys(higher)
        != keys(GEL)
    )
    mounted = {"mount_stiffness_n_per_mm": 20.0}
    assert keys(harder.model_copy(update=mounted)) != keys(GEL.model_copy(update=mounted))


def test_every_pose_is_served(cache: Path) -> None:
    plan = _plan()
    solutions = {solve.key: solve.run() for solve in plan.solves}
    states = [plan.state(i, solutions) for i in range(len(plan.poses))]
    references = [state for state, pose in zip(states, plan.poses, strict=True) if pose.depth_mm == 0]
    assert len(references) == 2
    assert not references[0].displacement_mm.any()
    left, right = states[1], states[4]
    np.testing.assert_allclose(left.force_n, right.force_n, atol=1e-12)
    np.testing.assert_allclose(left.displacement_mm[:, :60], right.displacement_mm[:, 20:80], atol=1e-5)
    turned = states[2]
    np.testing.assert_allclose(turned.force_n[1], left.force_n[0], rtol=1e-9)
    # The solve is in the cache now, and a damaged file there is no solution.
    key = plan.solves[0].key
    assert load_solution(key) is not None
    assert len(cached_files()) == 1
    (cache / f"{key}.solution").write_bytes(b"half a file")
    assert load_solution(key) is None
    _store_concurrently(solutions[key])
    assert load_solution(key).records[0].force_n.tobytes() == solutions[key].records[0].force_n.tobytes()
    assert not list(cache.glob("*.tmp"))
    clear_cache()
    assert len(cached_files()) == 0


def test_a_membrane_reaches_as_far_as_its_contact_and_as_it_must(cache: Path) -> None:
    thin = GEL.model_copy(update={"thickness_mm": 1.0})
    plan = _plan(thin, PosePath("far", (Pose(depth_mm=0.1, point_x_mm=6.8),)))
    solutions = {plan.solves[0].key: plan.solves[0].run()}
    assert plan.state(0, solutions).x_mm[-1] == pytest.approx(7.7)  # 1.5 times 0.54 mm beyond the point
    wide = plan.state(0, solutions, (9.0, 30.0))
    assert (wide.x_mm[-1], wide.y_mm[-1]) == (9.0, 10.0)  # the pad ends at 10 mm
    assert wide.displacement_mm.shape == (len(wide.y_mm), len(wide.x_mm), 3)
    assert wide.contact.any()


def test_drags_that_branch_off_one_press_are_those_solved_apart(cache: Path) -> None:
    path = ContactPath("branches", (3.5,), (2.5,), (0.1,), (0.05, 0.1), (0.0, 90.0))
    plan = _plan(SMALL, path)
    (branching,) = plan.solves
    assert branching.problem.parents == (-1, 0, 1, 0, 3)
    together = branching.run()
    waypoints = branching.problem.waypoints_mm
    alone = solve(
        replace(
            branching.problem, waypoints_mm=(waypoints[0], waypoints[3], waypoints[4]), parents=(-1, 0, 1)
        )
    )
    # The order of the vertices depends on all ways, and rounding on the order.
    order, other_order = (np.lexsort(np.round(solution.rest_mm[0], 6).T) for solution in (together, alone))
    for record, other in zip((together.records[k] for k in (0, 3, 4)), alone.records, strict=True):
        np.testing.assert_allclose(record.force_n, other.force_n, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(
            record.displacement_mm[order], other.displacement_mm[other_order], atol=1e-7
        )
        assert astuple(record.diagnostics) == pytest.approx(astuple(other.diagnostics), rel=1e-6, abs=1e-9)
        assert record.converged == other.converged


def test_a_mirrored_corner_of_a_harder_gel_has_the_mirrored_force_and_torque(cache: Path) -> None:
    drag = Pose(depth_mm=0.1, point_x_mm=3.5, point_y_mm=2.5, shear_x_mm=0.05)
    mirrored = replace(drag, point_x_mm=-3.5, shear_x_mm=-0.05)
    harder = SMALL.model_copy(update={"young_modulus_mpa": 0.6})
    one, other = _plan(SMALL, PosePath("one", (drag,))), _plan(harder, PosePath("other", (mirrored,)))
    assert one.solves[0].key == other.solves[0].key
    solutions = {one.solves[0].key: one.solves[0].run()}
    here, there = one.state(0, solutions), other.state(0, solutions)
    assert np.abs(here.torque_n_mm).min() > 1e-6
    np.testing.assert_allclose(there.force_n, 2 * here.force_n * [-1, 1, 1], rtol=1e-12)
    # Torque is an axial vector: mirroring x keeps its x component and negates the other two.
    np.testing.assert_allclose(there.torque_n_mm, 2 * here.torque_n_mm * [1, -1, -1], rtol=1e-12)


def test_a_trajectory_is_one_solve_that_remembers_its_way(cache: Path) -> None:
    there_and_back = [(0.0, 0.0, 0.2), (0.2, 0.0, 0.2), (0.0, 0.0, 0.2)]
    path = PosePath.from_trajectories(
        "way", [{"waypoints_mm": there_and_back}, {"waypoints_mm": [(y, x, d) for x, y, d in there_and_back]}]
    )
    plan = _plan(path=path)
    assert len(plan.solves) == 2
    solution = plan.solves[0].run()
    assert solution.problem.symmetric
    states = [plan.state(index, {plan.solves[0].key: solution}) for index in range(4)]
    assert not states[0].displacement_mm.any()
    assert states[2].force_n[0] > 0
    # Friction at 0.5 slips on this way, so on the way back it pulls against it.
    assert states[3].force_n[0] < -0.1 * abs(states[3].force_n[2])
    assert plan.solve_key(1) == plan.solve_key(3)
    assert plan.solves[1].problem.waypoints_mm == plan.solves[0].problem.waypoints_mm


def test_edges_matter_to_a_descent_if_they_do_to_its_deepest_pose() -> None:
    gel, body = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.48, friction=0.5), Sphere(diameter_mm=10.0)
    deep, shallow = (Pose(depth_mm=depth_mm, point_y_mm=2.5) for depth_mm in (1.5, 0.1))
    alone = plan_visit(gel, body, [deep], "draft").solves[0].problem
    assert alone.pad_mm is not None
    for poses in ([shallow, deep], [deep, shallow], [deep, replace(shallow, shear_x_mm=0.1)]):
        assert plan_visit(gel, body, poses, "draft").solves[0].problem.pad_mm == alone.pad_mm
    with pytest.raises(ValueError, match="several trajectories"):
        plan_visit(gel, body, [replace(deep, trajectory=1), replace(deep, trajectory=2)], "draft")


def test_a_trajectory_around_a_corner_needs_the_whole_gel() -> None:
    path = PosePath.from_trajectories(
        "corner", [{"waypoints_mm": [(0.0, 0.0, 0.2), (0.1, 0.0, 0.2), (0.1, 0.1, 0.2)]}]
    )
    (solve,) = _plan(path=path).solves
    assert solve.problem.pad_mm is None
    assert not solve.problem.symmetric


def test_progress_goes_from_none_to_all_without_going_back(cache: Path) -> None:
    told: list[tuple[int, int]] = []
    poses = tuple(Pose(depth_mm=depth) for depth in (0.1, 0.3, 0.5))
    plan = plan_solves(GEL, Sphere(), PosePath("several", poses), "draft")
    plan.solves[0].run(lambda done, total: told.append((done, total)))
    steps = plan.solves[0].problem.load_steps
    assert told[0] == (0, steps)
    assert told[-1] == (steps, steps)
    assert [done for done, _ in told] == sorted(done for done, _ in told)


def _store_concurrently(solution) -> None:
    workers = [
        multiprocessing.get_context("fork").Process(target=store_solution, args=(solution,)) for _ in range(4)
    ]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
        assert worker.exitcode == 0


def test_plans_and_paths_are_shown_in_one_line() -> None:
    plan = plan_solves(GEL, Sphere(), SHORT)
    for shown in (plan, plan.solves[0], PosePath("own", plan.poses), plan.state(0, {}).diagnostics):
        assert len(repr(shown)) < 300
