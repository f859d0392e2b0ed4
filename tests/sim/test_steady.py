"""Slides that are moved: what of a path is solved, when nothing is, and that the moved state is the slide's own."""

from types import SimpleNamespace

import numpy as np
import pytest

from gelgap.sim import Elastomer, Pose, Sharing, Sphere
from gelgap.sim.newton import solve
from gelgap.sim.plan import plan_visit
from gelgap.sim.problem import ContactProblem
from gelgap.sim.solution import solution_bytes, solution_from_bytes
from gelgap.sim.steady import solve_steadily, steady_slide

GEL = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.3)


def problem_of(*poses: Pose, gel: Elastomer = GEL) -> ContactProblem:
    return plan_visit(gel, Sphere(), poses, "draft", Sharing(cache=False)).solves[0].problem


def test_only_the_beginning_of_a_long_slide_is_solved() -> None:
    problem = problem_of(Pose(0.2), Pose(0.2, 1.0), Pose(0.2, 2.0))
    slide = steady_slide(problem)
    assert slide is not None
    (solved,) = slide.solved
    assert solved.travel_mm < 0.3
    press, *moved = slide.waypoints
    assert press == 0
    ends_mm = [solved.waypoints_mm[own.end.record][0] + own.moved_mm[0] for own in moved]
    assert ends_mm == pytest.approx([1.0, 2.0])


def test_a_slide_towards_an_edge_is_solved_where_it_ends() -> None:
    problem = problem_of(Pose(0.2, 1.0, point_x_mm=10.0))
    slide = steady_slide(problem)
    assert slide is not None
    first, last = slide.solved
    assert first.travel_mm == 0
    assert last.travel_mm < 0.3
    press, moved = slide.waypoints
    assert (press, moved.end.problem, moved.end.record, moved.of_edges) == (
        0,
        1,
        len(last.waypoints_mm) - 1,
        0,
    )
    to_edge_mm = problem.pad_mm[1] - 1.0
    assert last.pad_mm[1] - last.waypoints_mm[-1][0] == pytest.approx(to_edge_mm)
    along_the_edge = steady_slide(problem_of(Pose(0.2, 0.0, 1.0, point_x_mm=10.0)))
    assert along_the_edge is not None
    assert len(along_the_edge.solved) == 1


def test_what_is_not_steady_is_solved_twice_as_far_before_anything_else_and_a_press_once() -> None:
    """Two slides end near an edge; while the first sticks the second is not solved, nor is their press again."""
    problem = problem_of(Pose(0.2, 0.8, point_x_mm=10.0), Pose(0.2, 1.2, point_x_mm=10.0))
    solved = []

    def sticking(own: ContactProblem, _: object) -> SimpleNamespace:
        solved.append(own)
        record = SimpleNamespace(
            converged=True, force_n=np.ones(3), diagnostics=SimpleNamespace(sticking_fraction=1.0)
        )
        return SimpleNamespace(records=[record] * len(own.waypoints_mm))

    solve_steadily(problem, sticking)
    press, first, further = solved[:3]
    assert [own for own in solved if own.travel_mm == 0] == [press]
    assert further.travel_mm == pytest.approx(2 * first.travel_mm)
    ends_mm = [problem.pad_mm[1] - (own.pad_mm[1] - own.travel_mm) for own in (first, further)]
    assert ends_mm == pytest.approx([0.8, 0.8])
    assert solved[-1] == problem


@pytest.mark.parametrize(
    "problem",
    [
        problem_of(Pose(0.2)),
        problem_of(Pose(0.2), Pose(0.2, 0.1)),
        problem_of(Pose(0.2), Pose(0.2, 1.0), Pose(0.2, 0.5)),
        problem_of(Pose(0.2), Pose(0.2, 1.0), Pose(0.3, 1.0)),
        problem_of(Pose(0.2), Pose(0.2, 1.0), Pose(0.2, 1.0, 1.0)),
        problem_of(Pose(0.2), Pose(0.2, 1.0), gel=GEL.model_copy(update={"static_friction": 0.4})),
    ],
)
def test_what_turns_back_or_has_a_memory_is_solved_to_its_end(problem: ContactProblem) -> None:
    assert steady_slide(problem) is None


@pytest.mark.numerical
def test_a_moved_state_is_the_one_that_the_whole_slide_ends_in() -> None:
    """Solved to its end at commit 032934a the slide of 1 mm has (0.02213, 0, −0.06925) N and a radius of 0.585 mm."""
    problem = problem_of(Pose(0.2), Pose(0.2, 1.0))
    solution = solve(problem)
    _, slid = solution.records
    assert slid.converged
    assert slid.force_n == pytest.approx([0.02213, 0.0, -0.06925], rel=0.015, abs=1e-4)
    assert slid.indenter_mm == pytest.approx([1.0, 0.0, -0.2])
    assert 0 < slid.moved_error < 0.01
    assert slid.torque_n_mm[1] == pytest.approx(0.0662, rel=0.015)
    rest_mm, displacement_mm, force_n = solution.whole_surface(slid)
    centre_mm = force_n @ (rest_mm + displacement_mm[:, :2]) / force_n.sum()
    assert centre_mm == pytest.approx([1.0, 0.0], abs=0.03)
    again = solution_from_bytes(solution_bytes(solution))
    assert again is not None
    assert again.records[1].moved_mm == pytest.approx(slid.moved_mm)
