"""Contact paths: counts, order, numbering and bad input."""

import math
from pathlib import Path

import pytest

from gelgap.sim.path import ContactPath, DrawnPath, ForcePath, PosePath, load_path
from gelgap.sim.scene import Pose

GRID = "points_x_mm = [0]\npoints_y_mm = [0]\ndepths_mm = [0.2]\nradii_mm = [0.1]\nangles_deg = [0, 90, 180, 270]"


@pytest.mark.parametrize(
    ("name", "frames"), [("paper", 10_830), ("sparse", 873), ("cpu", 1_170), ("smoke", 148)]
)
def test_presets_have_the_published_number_of_frames(name: str, frames: int) -> None:
    assert len(ContactPath.preset(name).poses) == frames


def test_the_paper_path_numbers_every_class_once_a_point() -> None:
    poses = ContactPath.preset("paper").poses
    for point in range(30):
        classes = [pose.contact_class for pose in poses if pose.point_id == point]
        assert classes[0] == 0
        assert sorted(classes) == list(range(361))


@pytest.mark.parametrize("name", ["sparse", "cpu", "smoke"])
def test_grids_are_part_of_the_paper_path(name: str) -> None:
    paper = {(pose.point_id, pose.contact_class): pose for pose in ContactPath.preset("paper").poses}
    for pose in ContactPath.preset(name).poses:
        assert paper[pose.point_id, pose.contact_class] == pose


def test_class_number_follows_depth_then_radius_then_angle() -> None:
    poses = {pose.contact_class: pose for pose in ContactPath.preset("paper").poses if pose.point_id == 0}
    pose = poses[1 + 72 * 2 + 12 * 4 + 7]
    assert (pose.depth_mm, pose.radius_mm, pose.angle_deg) == pytest.approx((0.6, 0.5, 210.0))


def test_angles_turn_from_x_towards_y() -> None:
    pose = Pose(depth_mm=0.2, shear_x_mm=0.0, shear_y_mm=0.3)
    assert pose.angle_deg == 90.0
    assert pose.radius_mm == 0.3


@pytest.mark.parametrize("value", [-0.1, math.nan])
def test_a_depth_must_be_a_number_from_zero(value: float) -> None:
    with pytest.raises(ValueError, match="depth_mm"):
        Pose(depth_mm=value)


def test_trajectories_keep_their_order_and_start_from_a_reference(tmp_path: Path) -> None:
    file = tmp_path / "corner.toml"
    file.write_text(
        """
        [[trajectories]]
        point_mm = [1, 2]
        waypoints_mm = [[0, 0, 0.3], [0.2, 0, 0.3], [0.2, 0.1, 0.4]]
        [[trajectories]]
        waypoints_mm = [[0.1, 0, 0.2]]
        """
    )
    path = load_path(str(file))
    assert path.name == "corner"
    assert [pose.trajectory for pose in path.poses] == [None, 0, 0, 0, None, 1]
    assert [pose.depth_mm for pose in path.poses] == [0, 0.3, 0.3, 0.4, 0, 0.2]
    assert (path.poses[3].shear_x_mm, path.poses[3].shear_y_mm) == (0.2, 0.1)
    assert {pose.point_id for pose in path.poses[:4]} != {pose.point_id for pose in path.poses[4:]}


def test_a_drawn_path_has_some_contacts_of_its_grid_at_each_point() -> None:
    drawn = ContactPath.preset("cpu")
    grid = ContactPath(
        "grid", drawn.points_x_mm, drawn.points_y_mm, drawn.depths_mm, drawn.radii_mm, drawn.angles_deg
    )
    assert isinstance(drawn, DrawnPath)
    assert drawn.poses == load_path("cpu").poses, "always the same ones"
    chosen = set(drawn.poses)
    assert chosen < set(grid.poses)
    assert [pose for pose in grid.poses if pose in chosen] == list(drawn.poses), "in the grid's order"
    at_point = {k: [p for p in drawn.poses if p.point_id == k] for k in {p.point_id for p in drawn.poses}}
    assert {len(poses) for poses in at_point.values()} == {39}
    assert len({tuple(p.contact_class for p in poses) for poses in at_point.values()}) == 30, (
        "each point its own"
    )
    assert {p.contact_class for p in drawn.poses} == {p.contact_class for p in grid.poses}


def test_random_poses_follow_their_seed_and_ranges() -> None:
    ranges = {"depth_mm": (0.2, 0.4), "radius_mm": (0.1, 0.3), "point_x_mm": (-1.0, 1.0)}
    path = PosePath.random("drawn", number=50, seed=3, **ranges)
    assert path == PosePath.random("drawn", number=50, seed=3, **ranges)
    assert path != PosePath.random("drawn", number=50, seed=4, **ranges)
    assert len(path.poses) == 51
    for pose in path.poses[1:]:
        assert 0.2 <= pose.depth_mm <= 0.4
        assert 0.1 - 1e-6 <= pose.radius_mm <= 0.3 + 1e-6
        assert abs(pose.point_x_mm) <= 1
        assert pose.point_y_mm == 0
    assert max(pose.angle_deg for pose in path.poses) > 270


@pytest.mark.parametrize("name", ["loops", "manoeuvres", "random"])
def test_presets_that_list_poses(name: str) -> None:
    assert len(load_path(name).poses) > 10
    with pytest.raises(ValueError, match="not a grid"):
        ContactPath.preset(name)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[[trajectories]]\nwaypoints_mm = []", "waypoints_mm"),
        ("[[trajectories]]\nwaypoints_mm = [[0, 0]]", "3 numbers"),
        ("[random]\nnumber = 0", "number"),
        ("[random]\nnumber = 2\ndepth_mm = [0.4, 0.2]", "depth_mm"),
        ("depths_mm = [0.1]", "points_x_mm"),
        (f"{GRID}\ncontacts_per_point = 5", "must be 1 to 4"),
        (f"{GRID}\ncontacts_per_point = 1.5", "must be a whole number"),
        ("[random]\nnumber = true", "number = True of path .*: must be a whole number from 1"),
        ('[random]\nnumber = 3\nseed = "1"', "seed = '1' of path .*: must be a whole number from 0"),
    ],
)
def test_a_bad_path_file_is_refused(text: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(text)
    with pytest.raises(ValueError, match=words):
        load_path(str(file))


def test_a_missing_path_file_is_named() -> None:
    with pytest.raises(FileNotFoundError, match="nowhere"):
        load_path("nowhere.toml")


def test_what_is_wrong_with_a_path_is_told_in_words_that_fit_any_name(tmp_path: Path) -> None:
    file = tmp_path / "path.toml"
    file.write_text("speed = 3\n")
    with pytest.raises(ValueError, match=r"path\.toml: speed in path 'path': must be points_x_mm, .*random"):
        load_path(str(file))


def test_forces_stand_for_depths_until_a_gel_is_known(tmp_path: Path) -> None:
    grid, random = tmp_path / "grid.toml", tmp_path / "random.toml"
    grid.write_text(GRID.replace("depths_mm = [0.2]", "forces_n = [2.0, 0.5]"))
    random.write_text("[random]\nnumber = 5\nforce_n = [0.1, 3.0]\n")
    path = load_path(str(grid))
    assert isinstance(path, ForcePath)
    assert path.forces_n == (0.5, 2.0)
    pressed = path.at_depths((0.3, 0.9))
    assert pressed == ContactPath("grid", (0.0,), (0.0,), (0.9, 0.3), (0.1,), (0.0, 90.0, 180.0, 270.0))
    path = load_path(str(random))
    forces = path.forces_n
    assert len(forces) == 5
    assert 0.1 <= forces[0] <= forces[-1] <= 3.0
    poses = path.at_depths([force / 10 for force in forces]).poses
    assert poses[0].depth_mm == 0
    assert sorted(pose.depth_mm for pose in poses[1:]) == pytest.approx([force / 10 for force in forces])


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (GRID + "\nforces_n = [1]", "has forces and depths"),
        ("[random]\nnumber = 2\nforce_n = [3.0, 1.0]", r"force_n = \[3.0, 1.0\] of path own: must rise"),
        (GRID.replace("depths_mm = [0.2]", "forces_n = [-1]"), "forces_n of path own = .* must be 0 or more"),
    ],
)
def test_bad_forces_are_called_forces(content: str, problem: str, tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text(content)
    with pytest.raises(ValueError, match=problem):
        load_path(str(file))
