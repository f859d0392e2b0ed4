"""What a generation is expected to take: from its plan and sample frames."""

import numpy as np
import pytest

from gelgap.data import open_domain
from gelgap.data.formats.pictures import encode_png
from gelgap.domains import estimate, make_recipes, preset_recipes

SMALL = {"size_px": (80, 60), "render_quality": "draft"}


def test_the_papers_data_set_needs_few_solves_for_many_contacts():
    found = estimate(preset_recipes("paper", **SMALL), workers=2)
    assert found.plan.frames == 3 * 10830 + 873
    assert len(found.plan.solves) == 6
    assert "time     about" in str(found)


def test_sharing_of_pictures_is_part_of_the_estimate():
    both = estimate(make_recipes(["mb0i0", "wmb0i0"], "smoke", **SMALL))
    alone = [estimate(make_recipes([name], "smoke", **SMALL)) for name in ("mb0i0", "wmb0i0")]
    assert both.plan.solves.keys() == alone[0].plan.solves.keys() == alone[1].plan.solves.keys()
    assert both.plan.frames == sum(one.plan.frames for one in alone)
    assert both.disk_bytes == pytest.approx(sum(one.disk_bytes for one in alone), rel=0.3)
    assert both.wall_s > 0


def test_a_solve_is_not_shared_by_workers_and_known_solves_take_no_time(monkeypatch):
    recipes = make_recipes(["mb0i0"], "smoke", **SMALL)
    few, many = (estimate(recipes, workers=workers) for workers in (2, 50))
    assert many.wall_s > 0.5 * few.wall_s
    monkeypatch.setattr("gelgap.domains.generation.estimate.has_solution", lambda key: True)
    known = estimate(recipes, workers=2)
    assert known.solves_cached == len(known.plan.solves)
    assert known.wall_s < few.wall_s


def test_optional_columns_take_what_they_take_where_there_is_contact(data):
    frames = open_domain(data / "mb0i0")
    pressed = np.flatnonzero(frames.columns["depth_mm"])
    map_bytes = np.mean([len(encode_png(frames.optional("height_map", index))) for index in pressed])
    with_map, without = (
        estimate(make_recipes(["mb0i0"], "smoke", columns=columns, **SMALL))
        for columns in (["height_map"], [])
    )
    found = (with_map.disk_bytes - without.disk_bytes) / without.plan.frames
    assert found == pytest.approx(map_bytes, rel=0.1)
