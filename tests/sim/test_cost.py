"""What a solve takes is known before: it grows with the work, its iterations are about right, and advice is true."""

from dataclasses import replace

import pytest

from gelgap.sim import Box, Elastomer, Pose, Sphere
from gelgap.sim.cost import DEAR_S, Work, cheaper, expected_core_s, expected_work, forecast, most_iterations
from gelgap.sim.grading import is_served
from gelgap.sim.indenter import Indenter
from gelgap.sim.newton import solve
from gelgap.sim.plan import plan_visit
from gelgap.sim.problem import QUALITIES, ContactProblem

GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.5)
# Most of this slide is not moved: its line is broken.
DEAR = (Pose(0.0226), Pose(0.0226, -0.7777, 0.6179), Pose(0.0226, 0.8, 0.6))


def _problem(pose: Pose, body: Indenter = Sphere(), quality: str = "draft") -> ContactProblem:  # noqa: B008
    return plan_visit(GEL, body, (pose,), quality).solves[0].problem


def test_longer_ways_and_finer_meshes_take_longer() -> None:
    shallow, press = (expected_core_s(_problem(Pose(depth_mm=depth_mm))) for depth_mm in (0.2, 0.6))
    drag = expected_core_s(_problem(Pose(depth_mm=0.6, shear_x_mm=0.4)))
    fine = expected_core_s(_problem(Pose(depth_mm=0.6), quality="standard"))
    assert 0 < shallow < press < drag
    assert 2 * press < fine


@pytest.mark.parametrize("shear_mm", [0.0, 0.2])
def test_the_iterations_of_a_solve_are_foreseen(shear_mm: float) -> None:
    problem = _problem(Pose(depth_mm=0.4, shear_x_mm=shear_mm))
    taken = sum(record.diagnostics.iterations for record in solve(problem).records)
    assert 1 / 1.8 < expected_work(problem).iterations / taken < 1.8


def test_a_dear_scene_says_what_makes_it_cheaper_and_others_do_not() -> None:
    dear = plan_visit(GEL, Sphere(diameter_mm=2.577), DEAR, "draft").solves[0].problem
    assert expected_core_s(dear) > DEAR_S["draft"]
    assert "half the travel" in cheaper(dear)
    assert all(core_s < expected_core_s(dear) for core_s in cheaper(dear).values())
    assert "cheaper: " in forecast(dear)
    assert "cheaper" not in forecast(_problem(Pose(depth_mm=0.6)))
    box = _problem(Pose(depth_mm=0.6), Box(yaw_deg=20.0, tilt_deg=(3.0, 2.0)), "standard")
    assert next(iter(cheaper(box))) == "quality draft"


def test_a_dear_draft_gets_wider_cells_that_serve_its_edges_and_says_so(
    caplog: pytest.LogCaptureFixture,
) -> None:
    thin = GEL.model_copy(update={"thickness_mm": 1.2, "pad_size_mm": (40.0, 40.0)})
    box = Box(size_mm=(7.0, 2.0), edge_radius_mm=0.15, yaw_deg=7.0)
    wider = plan_visit(thin, box, (Pose(0.4), Pose(0.4, 0.4, 0.4)), "draft").solves[0].problem
    usual = replace(wider, quality=QUALITIES["draft"])
    assert expected_core_s(usual) > 42 > 25 > expected_core_s(wider)
    assert is_served(wider)
    assert "times as wide" in forecast(wider)
    assert [record.levelname for record in caplog.records if "times as wide" in record.getMessage()] == [
        "WARNING"
    ]


def test_work_costs_what_it_consists_of() -> None:
    one, twice = Work(3.0, 0.1, 0.4, 20.0), Work(3.0, 0.1, 0.4, 40.0)
    assert one.core_s < twice.core_s < 2 * one.core_s


@pytest.mark.parametrize(("core_s", "most_s"), [(2.0, 20.0), (16.0, 40.0), (36.0, 60.0), (70.0, 105.0)])
def test_no_solve_is_given_up_before_half_more_than_its_forecast(
    monkeypatch: pytest.MonkeyPatch, core_s: float, most_s: float
) -> None:
    work = Work(10.0, 1.0, 10.0, 50.0)
    work = work._replace(iterations=work.iterations + (core_s - work.core_s) / work.iteration_s)
    monkeypatch.setattr("gelgap.sim.cost.expected_work", lambda _: work)
    taken_s = most_iterations(_problem(Pose(depth_mm=0.6))) * work.iteration_s
    assert most_s <= taken_s <= most_s + work.iteration_s
