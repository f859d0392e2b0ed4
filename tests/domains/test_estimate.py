"""What a generation is expected to take: from its plan, known costs of solves, and sample frames."""

import pytest

from gelgap.domains.estimate import Estimate, estimate
from gelgap.domains.recipe import make_recipes, preset_recipes


def test_the_papers_data_set_needs_few_solves_for_many_contacts():
    small = {"size_px": (80, 60), "render_quality": "draft"}
    plan = estimate(preset_recipes("paper", **small), workers=2)
    assert plan.frames == 3 * 10830 + 873
    assert plan.contacts == 2 * 10800 + 864
    assert plan.solves == 6


def test_sharing_of_pictures_is_part_of_the_estimate():
    small = {"size_px": (80, 60), "render_quality": "draft"}
    both = estimate(make_recipes(["mb0i0", "wmb0i0"], "smoke", **small))
    alone = [estimate(make_recipes([name], "smoke", **small)) for name in ("mb0i0", "wmb0i0")]
    assert both.solves == alone[0].solves == alone[1].solves
    assert both.frames == sum(one.frames for one in alone)
    assert both.wall_s > 0


def test_one_solve_is_not_shared_and_a_busy_machine_takes_longer():
    plan = estimate(make_recipes(["mb0i0"], "smoke", size_px=(80, 60), render_quality="draft"), workers=50)
    assert plan.wall_s >= plan.busy * plan.longest_solve_s
    assert plan.busy >= 1


def test_time_is_that_of_starting_solving_and_rendering():
    plan = Estimate(
        domains=("mb0i0",),
        frames=100,
        shards=4,
        contacts=90,
        solves=3,
        solves_cached=0,
        solve_core_s=30.0,
        frame_core_s=8.0,
        disk_bytes=1e6,
        workers=2,
        longest_solve_s=20.0,
        busy=2.0,
        start_s=3.0,
    )
    assert plan.wall_s == pytest.approx(2 * (3 + 20 + 8 / 2))
    assert plan.core_s == pytest.approx(1.5 * 3 + 30 + 8)
