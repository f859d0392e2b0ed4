"""The protocol's data: points apart, depths that are drawn, lights and shifted labels."""

import numpy as np
import pytest

from gelgap.benchmarks.adaptation import protocol
from gelgap.data import ArrayFrames
from gelgap.sim.plan import plan_solves


def points(role: protocol.Role) -> np.ndarray:
    return np.array(sorted({(p.point_x_mm, p.point_y_mm) for p in protocol.contact_path(role).poses}))


def test_source_and_target_share_no_point_nor_depth():
    source, target = map(points, protocol.ROLES)
    assert len(source) == len(target) == 30
    assert np.linalg.norm(source[:, None] - target[None], axis=2).min() > 0.8
    depths = [{p.depth_mm for p in protocol.contact_path(role).poses} - {0.0} for role in protocol.ROLES]
    assert len(depths[0]) == len(depths[1]) == protocol.LEVELS
    assert not depths[0] & depths[1]
    # Evenly drawn: no gap is wider than two of the intervals from which one is drawn each.
    assert np.diff(sorted(depths[0])).max() < 2 * np.ptp(protocol.DEPTH_MM) / protocol.LEVELS


def test_a_gel_takes_few_solves():
    recipe = protocol.role_recipes(["wmb0i0"], "source")[0]
    plan = plan_solves(recipe.elastomer, recipe.indenter, recipe.path, recipe.quality)
    assert len(plan.solves) == protocol.LEVELS / 3


@pytest.mark.parametrize(
    ("depth", "travel", "angle", "expected"), [(0.2, 0.1, 0.0, 1), (1.0, 0.6, 5.8, 361 - 1)]
)
def test_the_class_is_that_of_the_nearest_contact_of_the_grid(depth, travel, angle, expected):
    assert protocol.contact_class(depth, travel, angle) == expected


def test_a_source_in_any_light_has_the_contacts_of_one_light():
    domains = protocol.random_light_recipes()
    contacts = [p for recipe in domains for p in recipe.path.poses if p.depth_mm > 0]
    assert sorted(contacts, key=str) == sorted(
        (p for p in protocol.contact_path("source").poses if p.depth_mm > 0), key=str
    )
    assert {recipe.elastomer for recipe in domains} == {
        protocol.role_recipes(["wmb0i0"], "source")[0].elastomer
    }


def test_of_a_shifted_target_few_contacts_are_deep():
    depth = np.linspace(0.1, 1.0, 400)
    images = np.zeros((400, 2, 2, 3), np.uint8)
    frames = ArrayFrames("a", images, images[0], np.zeros((400, 3)))
    frames.columns["depth_mm"] = depth
    kept = protocol.with_shifted_labels(frames).columns["depth_mm"]
    assert (kept <= protocol.SHALLOW_MM).sum() == (depth <= protocol.SHALLOW_MM).sum()
    assert 0.03 < (kept > protocol.SHALLOW_MM).sum() / (depth > protocol.SHALLOW_MM).sum() < 0.2
