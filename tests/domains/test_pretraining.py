"""Drawn domains: what they share, what one factor changes, and how they are joined."""

import numpy as np
import pytest

from gelgap.domains import PretrainingRanges, pretraining_recipes
from gelgap.domains.generation.plan import plan_generation

RANGES = PretrainingRanges(
    **{**PretrainingRanges.default().model_dump(), "presses": 2, "depths": 2, "young_modulus_mpa": (0.1, 0.4)}
)


def test_domains_share_the_solves_of_their_press():
    recipes = pretraining_recipes(6, 9, RANGES)
    plan = plan_generation(recipes)
    two = plan_generation(recipes[:2])
    assert set(plan.solves) == set(two.solves)
    assert plan.frames == 54
    gels = [recipe.elastomer for recipe in recipes]
    assert len({gel.young_modulus_mpa for gel in gels}) == 6
    assert len({(gel.poisson_ratio, gel.thickness_mm, gel.friction) for gel in gels}) == 2
    assert len({recipe.illumination.model_dump_json() for recipe in recipes}) == 6


def test_contacts_are_those_of_the_press_within_view_and_their_depths_spread_the_force_evenly():
    for recipe in pretraining_recipes(4, 20, RANGES):
        first, *poses = recipe.path.poses
        assert (first.depth_mm, first.contact_class) == (0.0, 0)
        assert len({(pose.depth_mm, pose.radius_mm) for pose in poses}) == 2 * RANGES.depths
        depths_mm = np.unique([pose.depth_mm for pose in recipe.path.poses])
        np.testing.assert_allclose((depths_mm / depths_mm[-1]) ** 2, [0, 0.5, 1], atol=0.01)
        half_mm = np.array(recipe.sensor.camera.footprint_mm(recipe.size_px)) / 2
        assert all((np.abs([pose.point_x_mm, pose.point_y_mm]) < half_mm).all() for pose in poses)
        low, high = RANGES.sphere_diameter_mm
        assert low <= recipe.indenter.diameter_mm <= high


def test_a_range_whose_ends_are_equal_keeps_its_factor_and_the_draws_of_others():
    drawn = [recipe.sensor.camera for recipe in pretraining_recipes(4, 9, RANGES)]
    sharp = RANGES.model_copy(update={"point_spread_px": (0.5, 0.5)})
    fixed = [recipe.sensor.camera for recipe in pretraining_recipes(4, 9, sharp)]
    assert {camera.point_spread_px for camera in fixed} == {0.5}
    assert [camera.model_copy(update={"point_spread_px": 0.5}) for camera in drawn] == fixed


def test_other_seeds_draw_other_domains():
    one, other = (pretraining_recipes(2, 9, RANGES, seed=seed)[0] for seed in (0, 1))
    assert one == pretraining_recipes(5, 9, RANGES)[0]
    assert one.elastomer != other.elastomer
    assert one.path.poses != other.path.poses


def test_bad_choices_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"frames_per_domain = 4: must be 5 or more"):
        pretraining_recipes(2, 4, RANGES)
    (tmp_path / "ranges.toml").write_text("view_mm = [20.0, 12.0]")
    with pytest.raises(ValueError, match=r"ranges\.toml.*view_mm.*lowest and a highest"):
        PretrainingRanges.load(tmp_path / "ranges.toml")
    (tmp_path / "ranges.toml").write_text("sphere_diameter_mm = [0.0, 12.0]")
    with pytest.raises(ValueError, match=r"sphere_diameter_mm.*greater than 0"):
        PretrainingRanges.load(tmp_path / "ranges.toml")


def test_a_file_replaces_single_values(tmp_path):
    (tmp_path / "ranges.toml").write_text("presses = 3\n[variation]\nled_drive = 0.0")
    default, own = PretrainingRanges.default(), PretrainingRanges.load(tmp_path / "ranges.toml")
    variation = default.variation.model_copy(update={"led_drive": 0.0})
    assert own == default.model_copy(update={"presses": 3, "variation": variation})
