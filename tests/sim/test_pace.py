"""How long solves take by the machine's own record."""

import json
from pathlib import Path

import pytest

from gelgap.sim.elastomer import Elastomer
from gelgap.sim.indenters.sphere import Sphere
from gelgap.sim.pace import RECORD, known_pace, measured_pace, time_left_s
from gelgap.sim.path import Pose, PosePath
from gelgap.sim.plan import plan_solves
from gelgap.sim.problem import ContactProblem


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path))
    return tmp_path


def problem(quality: str = "draft", **pose: float) -> ContactProblem:
    gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.8)
    return plan_solves(gel, Sphere(), PosePath("one", (Pose(**pose),)), quality).solves[0].problem


def test_a_record_decides_and_scales_what_it_lacks(cache: Path) -> None:
    press, drag = problem(depth_mm=0.2), problem("standard", depth_mm=0.6, shear_x_mm=0.3)
    built_in = known_pace()
    lines = [{"kind": "draft half disc", "slowness": slowness} for slowness in (2.0, 3.0, 100.0)]
    (cache / RECORD).write_text("\n".join(map(json.dumps, lines)) + "\nhalf a line {\n[1]\n{}\n")
    pace = known_pace()
    assert pace.solve_s(press) == pytest.approx(3.0 * built_in.solve_s(press))
    assert pace.solve_s(drag) == pytest.approx(3.0 * built_in.solve_s(drag))


def test_a_finer_and_deeper_solve_takes_longer() -> None:
    cost = known_pace().solve_s
    assert cost(problem(depth_mm=0.2)) < cost(problem(depth_mm=0.6)) < cost(problem("standard", depth_mm=0.6))


def test_a_machine_without_a_record_measures_once(cache: Path) -> None:
    first = measured_pace()
    assert first.slowness is not None
    assert len((cache / RECORD).read_text().splitlines()) == 1
    assert measured_pace() == first


def test_the_record_stays_short(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gelgap.sim.pace._LINES_KEPT", 3)
    line = json.dumps({"kind": "x", "slowness": 1.0})
    (cache / RECORD).write_text(f"{line}\n" * 10)
    from gelgap.sim import solve_pose

    gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.8)
    solve_pose(gel, Sphere(), Pose(depth_mm=0.05), "draft")
    assert len((cache / RECORD).read_text().splitlines()) == 3


def test_progress_goes_from_none_to_all_without_going_back() -> None:
    told: list[tuple[int, int]] = []
    gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.8)
    poses = tuple(Pose(depth_mm=depth) for depth in (0.1, 0.3, 0.5))
    plan = plan_solves(gel, Sphere(), PosePath("several", poses), "draft")
    plan.solves[0].run(lambda done, total: told.append((done, total)))
    steps = plan.solves[0].problem.load_steps
    assert told[0] == (0, steps)
    assert told[-1] == (steps, steps)
    assert [done for done, _ in told] == sorted(done for done, _ in told)


@pytest.mark.parametrize(("share", "passed", "left"), [(0.0, 0.0, 10.0), (0.25, 5.0, 7.5), (0.8, 16.0, 4.0)])
def test_time_left_follows_what_was_seen_once_half_is_done(share: float, passed: float, left: float) -> None:
    assert time_left_s(share, 10.0, passed) == pytest.approx(left)
