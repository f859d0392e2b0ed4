import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelgap.data.frames.dataset import ArrayFrames
from gelgap.data.frames.folders import open_domain
from gelgap.data.frames.splits import contact_points, paired_contacts, split_domains, split_frames


def pressed_at(points, name: str = "points", **columns) -> ArrayFrames:
    """Return black pictures of contacts at these points."""
    n = len(points)
    images = np.zeros((n, 1, 1, 3), np.uint8)
    labels = {"contact_class": np.arange(n), "point_id": points, **columns}
    labels = {label: np.asarray(values) for label, values in labels.items()}
    return ArrayFrames(name, images, images[0], np.zeros((n, 3)), **labels)


@given(
    st.lists(st.integers(0, 40), min_size=60, max_size=200),
    st.integers(0, 5),
    st.sampled_from(["random", "point"]),
)
def test_parts_are_disjoint_and_complete_and_points_stay_whole(points: list[int], seed: int, by: str):
    frames = pressed_at([*points, *range(10)])
    parts = split_frames(frames, by, seed)
    assert np.array_equal(np.sort(np.concatenate(parts)), np.arange(len(frames)))
    again = split_frames(frames, by, seed)
    assert all(np.array_equal(one, other) for one, other in zip(parts, again, strict=True))
    if by == "random":
        assert [len(part) for part in parts] == pytest.approx(np.array([0.6, 0.2, 0.2]) * len(frames), abs=1)
    else:
        owned = [set(frames.point_id[part]) for part in parts]
        assert sum(map(len, owned)) == len(set.union(*owned))


def test_the_given_split_is_the_columns(data):
    frames = open_domain(data / "mb0i0")
    parts = split_frames(frames, "given")
    assert [len(part) for part in parts] == [16, 5, 5]
    assert all(frames.columns["split"][index] == "test" for index in parts[2])


def test_the_seed_of_a_domain_draws_the_split_that_it_states(data):
    frames = open_domain(data / "mb0i0")
    stated, drawn = split_frames(frames), split_frames(frames, "random", seed=0)
    assert all(np.array_equal(one, other) for one, other in zip(stated, drawn, strict=True))
    assert not np.array_equal(split_frames(frames, "random", seed=1)[0], stated[0])


def test_a_stated_split_that_has_no_test_frames_is_refused():
    with pytest.raises(ValueError, match="states no split into train, validation, test"):
        split_frames(pressed_at(range(4), split=np.array(["train"] * 4, dtype=object)))


def grid(columns: int, first: int = 0, frames: int = 5) -> ArrayFrames:
    x = np.repeat(np.arange(first, first + columns), frames).astype(float)
    return pressed_at(np.repeat(np.arange(columns), frames), x_mm=x + 1e-7, y_mm=np.zeros(len(x)))


def test_a_contact_point_has_one_number_in_both_domains():
    one, other = contact_points(grid(4), grid(3, first=2))
    assert one[::5].tolist() == [0, 1, 2, 3]
    assert other[::5].tolist() == [2, 3, 4]
    without_positions = pressed_at([7, 2])
    assert [points.tolist() for points in contact_points(without_positions, pressed_at([2, 3]))] == [
        [2, 0],
        [0, 1],
    ]


@pytest.mark.parametrize("target", [grid(30), grid(9, first=4), grid(20, first=20)])
def test_no_point_of_a_target_test_frame_is_trained_on(target: ArrayFrames):
    source, seed = grid(30), 0
    split = split_domains(source, target, "point", seed, held_out=0.0)
    x_source, x_target = (frames.columns["x_mm"].round(3) for frames in (source, target))
    parts = [set(x_target[part]) for part in split[2:]]
    assert not set(x_source[split.source_train]) & parts[2]
    assert len(parts[0] | parts[1] | parts[2]) == sum(map(len, parts))
    assert not set(x_source[split.source_train]) & set(x_source[split.source_held_out])
    assert len(split.source_train) + len(split.source_held_out) == 150
    assert [len(part) for part in parts] == pytest.approx(
        np.array([0.6, 0.2, 0.2]) * len(target) / 5, abs=1.01
    )


def test_domains_of_the_same_points_are_split_as_each_is_alone():
    source, target = grid(10), grid(10, frames=3)
    split = split_domains(source, target, "point", seed=2, held_out=0.2)
    train, validation, test = split_frames(source, "point", seed=2)
    assert np.array_equal(split.source_train, np.sort([*train, *validation]))
    assert np.array_equal(split.source_held_out, test)
    alone = split_frames(target, "point", seed=2)
    assert all(np.array_equal(one, other) for one, other in zip(split[2:], alone, strict=True))


def test_a_stated_split_holds_out_the_sources_test_part_and_the_others_are_drawn(data):
    frames, other = open_domain(data / "mb0i0"), open_domain(data / "mb0i1")
    split = split_domains(frames, other)
    assert set(frames.columns["split"][split.source_held_out]) == {"test"}
    assert np.array_equal(split.source_held_out, split.target_test)
    assert len(split_domains(frames, other, held_out=0.0).source_train) == 26
    drawn = split_domains(frames, other, "random", seed=3, held_out=0.1)
    assert len(drawn.source_held_out) == 3
    assert set(drawn.source_held_out) <= set(split_frames(frames, "random", seed=3)[2])


@pytest.mark.parametrize("by", ["random", "given"])
def test_a_domain_that_is_its_own_target_has_its_test_frames_held_out(data, by):
    frames = open_domain(data / "mb0i0")
    split = split_domains(frames, frames, by, held_out=0.0)
    assert len(split.target_test) > 0
    assert not np.intersect1d(split.source_train, split.target_test).size


def test_a_part_that_would_be_empty_is_said_whichever_domain_has_it():
    with pytest.raises(ValueError, match="few: 2 contact points are too few"):
        split_domains(grid(30), pressed_at([0, 1], "few", x_mm=[0.0, 1], y_mm=[0.0, 0]), "point")
    with pytest.raises(ValueError, match="few: 2 frames are too few"):
        split_domains(grid(30), pressed_at([0, 1], "few"))


def test_paired_domains_share_their_split(data):
    one, other = open_domain(data / "mb0i0"), open_domain(data / "mb0i1")
    assert np.array_equal(one.columns["split"], other.columns["split"])


def test_shares_that_do_not_add_up_are_refused():
    with pytest.raises(ValueError, match="add up to 1"):
        split_frames(grid(9), shares=(0.5, 0.5, 0.5))


def test_contacts_are_paired_by_their_commanded_pose():
    same = {name: np.zeros(4) for name in ("y_mm", "depth_mm", "shear_x_mm", "shear_y_mm")}
    one = pressed_at(range(4), x_mm=[0.0, 1, 2, 3], **same)
    other = pressed_at(range(4), x_mm=[3.0, 7, 0, 1 + 1e-7], **same)
    first, second = paired_contacts(one, other)
    assert first.tolist() == [0, 1, 3]
    assert second.tolist() == [2, 3, 0]


def test_without_poses_contacts_are_paired_by_point_and_class():
    first, second = paired_contacts(pressed_at([0, 0, 3]), pressed_at([0, 1, 3, 0]))
    assert first.tolist() == [0, 2]
    assert second.tolist() == [0, 2]
    with pytest.raises(ValueError, match=r"points does not say its contacts by x_mm, y_mm.*cannot be paired"):
        paired_contacts(pressed_at([-1, -1]), pressed_at([0, 1]))


def clips(objects: list[str], frames: int = 4, name: str = "clips", session: str = "") -> ArrayFrames:
    """Return frames of clips, one for each entry of `objects`."""
    n = len(objects)
    groups = {
        "clip": np.repeat([f"{session}{k}" for k in range(n)], frames).astype(object),
        "object": np.repeat(objects, frames).astype(object),
    }
    return pressed_at(np.arange(n * frames), name, **groups)


def test_whole_groups_of_a_column_are_in_one_part():
    seed = 1
    source, target = clips(["golf", "foam"] * 6), clips(["golf", "foam"] * 6, name="later", session="later ")
    split = split_domains(source, target, "clip", seed)
    owned = [set(target.columns["clip"][part]) for part in split[2:]]
    assert sum(map(len, owned)) == 12
    assert [len(part) for part in owned] == [7, 3, 2]
    assert len(set(source.columns["clip"][split.source_held_out])) == 2
    by_object = split_domains(
        clips(["a", "b", "c", "d", "e"]), clips(["a", "b", "c", "d", "e"]), "object", seed
    )
    tested = set(np.repeat(list("abcde"), 4)[by_object.target_test])
    assert len(tested) == 1
    assert not tested & set(np.repeat(list("abcde"), 4)[by_object.source_train])


def test_strata_are_in_every_part_by_their_share():
    seed = 1
    frames = clips(["a"] * 5 + ["b"] * 10 + ["c"] * 5)
    for by in ("clip", "random"):
        parts = split_frames(frames, by, seed, stratify_by="object")
        assert np.array_equal(np.sort(np.concatenate(parts)), np.arange(80))
        counts = (
            np.array([[np.sum(frames.columns["object"][part] == name) for name in "abc"] for part in parts])
            / 4
        )
        if by == "clip":
            assert counts.tolist() == [[3, 6, 3], [1, 2, 1], [1, 2, 1]]
        assert np.allclose(counts, np.outer([0.6, 0.2, 0.2], [5, 10, 5]), atol=0.26)
    four = split_frames(clips(["a", "b", "c", "d"] * 3), "clip", seed, stratify_by="object")
    assert [len(part) // 4 for part in four] == [7, 3, 2]


@pytest.mark.parametrize(
    ("by", "stratify_by", "message"),
    [
        ("clp", None, r"split_by = 'clp': data set clips has no such column; known: random, point, given"),
        ("clip", "objects", r"stratify_by = 'objects': data set clips has no such column; .*clip, object"),
        ("object", "clip", r"a group that stays whole has more than one clip \(0, 2\)"),
        ("given", "object", "states its split: it cannot be stratified"),
        ("clip", None, r"3 groups \(clip\) are too few for a validation share"),
    ],
)
def test_columns_that_cannot_split_are_refused(by, stratify_by, message):
    with pytest.raises(ValueError, match=message):
        split_frames(clips(["a", "b", "a"]), by, stratify_by=stratify_by)
