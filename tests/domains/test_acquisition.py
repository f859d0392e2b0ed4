from pathlib import Path

import numpy as np
import pytest

from gelgap.data.frames.folders import open_domain
from gelgap.data.frames.splits import paired_contacts
from gelgap.domains.generation.shard import trajectories
from gelgap.domains.measured_gap import recipe_of
from gelgap.domains.recipe import AcquisitionError, make_recipes
from gelgap.sim import ContactPath


def recipe(name: str = "mb0i0", **settings):
    return make_recipes([name], "cpu", **settings)[0]


def test_nothing_is_drawn_by_default():
    plain = recipe()
    assert plain.solved_path() is plain.path
    assert plain.commanded_poses() is plain.path.poses


def test_errors_are_drawn_once_a_domain_and_repeat_with_the_seed():
    def drawn(name: str, seed: int):
        error = AcquisitionError(point_offset_mm=0.1, depth_zero_mm=0.02, force_bias_n=0.05)
        return recipe(name, acquisition=error, seed=seed).drawn_errors()

    assert drawn("mb0i0", 3) == drawn("mb0i0", 3)
    assert drawn("mb0i0", 3) != drawn("mb1i0", 3)
    assert drawn("mb0i0", 4) != drawn("mb0i0", 3)
    assert recipe().drawn_errors().actual(recipe().path.poses[5]) == recipe().path.poses[5]


def test_the_rig_records_what_it_commanded_and_does_something_else():
    off = recipe(acquisition=AcquisitionError(point_offset_mm=0.1, depth_zero_mm=0.03, tilt_deg=1.0), seed=1)
    assert off.commanded_poses() == off.path.poses
    commanded, actual = off.path.poses, off.solved_path().poses
    offsets = {
        (round(a.point_x_mm - c.point_x_mm, 6), round(a.point_y_mm - c.point_y_mm, 6))
        for c, a in zip(commanded, actual, strict=True)
        if c.depth_mm > 0
    }
    assert len(offsets) == 1
    deeper = {
        round(a.depth_mm - c.depth_mm, 6) for c, a in zip(commanded, actual, strict=True) if c.depth_mm > 0
    }
    assert 12 < len(deeper) <= 30, "a tilted pad gives points depths of their own"
    assert all(a.depth_mm == 0 for c, a in zip(commanded, actual, strict=True) if c.depth_mm == 0)


def test_independent_contacts_stay_in_their_cells_and_share_their_levels():
    one, other = recipe("mb0i0", contacts="independent"), recipe("wmb1i1", contacts="independent")
    first, second = one.commanded_poses(), other.commanded_poses()
    base = one.path.poses
    assert all(pose.contact_class == moved.contact_class for pose, moved in zip(base, first, strict=True))
    assert not {(p.point_x_mm, p.point_y_mm) for p in first} & {(p.point_x_mm, p.point_y_mm) for p in second}
    assert len({pose.depth_mm for pose in first}) == len({pose.depth_mm for pose in base})
    assert max(abs(p.point_x_mm - m.point_x_mm) for p, m in zip(base, first, strict=True)) <= 1.5 / 4 + 1e-9
    assert one.commanded_poses() == first


def test_inpainted_domains_share_the_draw_of_their_source():
    settings = {"contacts": "independent", "acquisition": AcquisitionError(depth_zero_mm=0.05)}
    assert recipe("mb0i0", **settings).solved_path() == recipe("wmb0i0", **settings).solved_path()


def test_force_noise_and_bias_change_labels_and_nothing_else(make, data: Path, tmp_path: Path):
    make(tmp_path, ("mb0i1",), acquisition=AcquisitionError(force_noise_n=0.01, force_bias_n=0.05))
    clean, noisy = open_domain(data / "mb0i1"), open_domain(tmp_path / "mb0i1")
    assert all(np.array_equal(clean.picture(index), noisy.picture(index)) for index in range(26))
    error = noisy.force_n - clean.force_n
    bias = recipe_of(noisy).drawn_errors().force_bias_n
    assert error.mean(axis=0) == pytest.approx(bias, abs=0.01)
    assert error.std(axis=0) == pytest.approx([0.01] * 3, rel=0.5)
    assert len(paired_contacts(clean, noisy)[0]) == 26


def test_bad_errors_are_refused():
    with pytest.raises(ValueError, match="tilt_deg"):
        AcquisitionError(tilt_deg=9.0)


def test_a_path_of_one_level_has_no_room_to_move_in():
    path = ContactPath("one", (0.0,), (0.0,), (0.4,), (0.2,), (0.0, 180.0))
    alone = make_recipes(["mb0i0"], path, contacts="independent")[0]
    assert {pose.depth_mm for pose in alone.commanded_poses()} == {0.0, 0.4}


def test_listed_poses_keep_their_trajectories_and_cannot_be_drawn_independently() -> None:
    (paired,) = make_recipes(["mb0i0"], "loops")
    numbers = np.array(trajectories(paired.path.poses))[[0, 1, 2, 5, 6, 7, 11]]
    assert numbers.T.tolist() == [[0, 1, 1, 1, 2, 3, 3], [0, 0, 1, 4, 0, 0, 4]]
    (drawn,) = make_recipes(["mb0i0"], "loops", contacts="independent")
    with pytest.raises(ValueError, match="contacts = 'independent'"):
        drawn.commanded_poses()
