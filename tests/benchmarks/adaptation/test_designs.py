"""The board's data: points apart, depths that are drawn, lights, crossed gaps and shifted labels."""

import numpy as np
import pytest

from gelgap.benchmarks.adaptation import designs
from gelgap.domains import ArrayFrames


def points(role: designs.Role) -> np.ndarray:
    return np.array(sorted({(p.point_x_mm, p.point_y_mm) for p in designs.contact_path(role).poses}))


def test_source_and_target_share_no_point_nor_depth():
    source, target = map(points, designs.ROLES)
    assert len(source) == len(target) == 30
    assert np.linalg.norm(source[:, None] - target[None], axis=2).min() > 0.8
    depths = [{p.depth_mm for p in designs.contact_path(role).poses} - {0.0} for role in designs.ROLES]
    assert len(depths[0]) == len(depths[1]) == designs.LEVELS
    assert not depths[0] & depths[1]
    # Evenly drawn: no gap is wider than two of the intervals from which one is drawn each.
    assert np.diff(sorted(depths[0])).max() < 2 * np.ptp(designs.DEPTH_MM) / designs.LEVELS


def test_a_gel_takes_few_solves():
    from gelgap.sim.plan import plan_solves

    recipe = designs.role_recipes(["wmb0i0"], "source")[0]
    plan = plan_solves(recipe.elastomer, recipe.indenter, recipe.path, recipe.quality)
    assert len(plan.solves) == designs.LEVELS / 3


@pytest.mark.parametrize(
    ("depth", "travel", "angle", "expected"), [(0.2, 0.1, 0.0, 1), (1.0, 0.6, 5.8, 361 - 1)]
)
def test_the_class_is_that_of_the_nearest_contact_of_the_grid(depth, travel, angle, expected):
    assert designs.contact_class(depth, travel, angle) == expected


def test_the_design_of_crossed_gaps_is_balanced():
    cells = np.array([list(cell.values()) for _, cell in designs.factorial_cells()])
    assert cells.shape == (16, 6)
    signs = 2 * cells.astype(int) - 1
    assert (signs.T @ signs == 16 * np.eye(6)).all()
    # Resolution IV: no product of two gaps is a third.
    for i in range(6):
        for j in range(i):
            assert not np.abs((signs[:, i] * signs[:, j]) @ signs).any()


def test_crossed_gaps_change_what_they_say():
    recipes = {recipe.name: recipe for recipe in designs.factorial_recipes()}
    assert len(recipes) == 16
    base = recipes["crossed-000000"]
    for name, cell in designs.factorial_cells():
        one = recipes[name]
        assert (one.elastomer.friction != base.elastomer.friction) == cell["friction"]
        assert one.markers != cell["markers"]
        for part, field in (("geometry", "position_mm"), ("drive", "drive"), ("spectrum", "spectrum")):
            of_both = zip(one.illumination.leds, base.illumination.leds, strict=True)
            assert any(getattr(a, field) != getattr(b, field) for a, b in of_both) == cell[part]


def test_a_source_in_any_light_has_the_contacts_of_one_light():
    domains = designs.random_light_recipes()
    contacts = [p for recipe in domains for p in recipe.path.poses if p.depth_mm > 0]
    assert sorted(contacts, key=str) == sorted(
        (p for p in designs.contact_path("source").poses if p.depth_mm > 0), key=str
    )
    assert {recipe.elastomer for recipe in domains} == {
        designs.role_recipes(["wmb0i0"], "source")[0].elastomer
    }


def test_of_a_shifted_target_few_contacts_are_deep():
    depth = np.linspace(0.1, 1.0, 400)
    images = np.zeros((400, 2, 2, 3), np.uint8)
    frames = ArrayFrames("a", images, images[0], np.zeros((400, 3)))
    frames.columns["depth_mm"] = depth
    kept = designs.with_shifted_labels(frames).columns["depth_mm"]
    assert (kept <= designs.SHALLOW_MM).sum() == (depth <= designs.SHALLOW_MM).sum()
    assert 0.03 < (kept > designs.SHALLOW_MM).sum() / (depth > designs.SHALLOW_MM).sum() < 0.2
