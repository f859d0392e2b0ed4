"""Clones of two public repositories, in small, become picture folders; what is no clone, and pickles, are refused."""

import pickle
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from hostile_bytes import pickled
from real_clones import (
    force_of,
    press_curve,
    rectified,
    rows_of,
    write_ball_clone,
    write_table,
    write_wedge_clip,
    write_wedge_clone,
)

from gelgap.cli.main import main
from gelgap.data import convert
from gelgap.data.formats.convert import ConvertedClip
from gelgap.data.formats.published_sets import LAYOUTS, read_pickled_array


@pytest.fixture(scope="module")
def wedge(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small clone of the grasps, not to be changed."""
    return write_wedge_clone(tmp_path_factory.mktemp("clones") / "EstimateModulus")


@pytest.fixture(scope="module")
def converted(
    wedge: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, tuple[ConvertedClip, ...]]:
    """The clone as picture folders, and what became of its clips."""
    out_dir = tmp_path_factory.mktemp("converted") / "out"
    return out_dir, convert(wedge, LAYOUTS["wedge"], out_dir)


@pytest.fixture
def own_wedge(wedge: Path, tmp_path: Path) -> Path:
    """A clone of one clip that may be changed."""
    shutil.copytree(wedge / "wedge_config", tmp_path / "own/wedge_config")
    write_wedge_clip(tmp_path / "own/example_data/day", "ball_1")
    return tmp_path / "own"


def test_a_session_becomes_a_domain_with_a_reference_for_each_clip(converted):
    out_dir, found = converted
    assert sorted(path.name for path in out_dir.iterdir()) == ["2023-12-06", "2023-12-16"]
    rows = rows_of(out_dir / "2023-12-16")
    assert list(rows[0])[2:] == ["fz_n", "clip", "object", "session", "time_s", "trajectory_id", "step"]
    assert {row["object"] for row in rows} == {"golf_ball", "foam"}
    assert {row["session"] for row in rows} == {"2023-12-16"}
    assert {row["clip"] for row in rows} == {
        f"{name}__t={k}" for name in ("golf_ball", "foam") for k in range(3)
    }
    for row in rows:
        assert row["reference"] == f"{row['clip']}/reference.png"
        assert cv2.imread(str(out_dir / "2023-12-16" / row["picture"])).shape == (240, 320, 3)
    assert all(np.isfinite(float(row["fz_n"])) for row in rows)
    assert sum(clip.written for clip in found if clip.domain == "2023-12-16") == len(rows)


def test_lags_glitches_and_contacts_are_counted(converted):
    found = {clip.name: clip for clip in converted[1]}
    assert [found[f"golf_ball__t={k}"].lag for k in range(3)] == [0, 1, 2]
    assert [found[f"golf_ball_{k}"].lag for k in range(3)] == [0, 0, 0]
    assert [found[f"golf_ball_{k}"].dropped for k in range(3)] == [0, 1, 2]
    assert {clip.pictures for clip in found.values()} == {40}
    assert found["golf_ball_0"].correlation == found["golf_ball_0"].correlation_at_0 > 0.9
    assert found["golf_ball__t=2"].correlation_at_0 < found["golf_ball__t=2"].correlation
    assert not any(clip.begins_in_contact or clip.lag_at_limit for clip in found.values())
    red, _, blue = found["golf_ball__t=0"].reference_rgb
    assert blue - red == pytest.approx(30, abs=4)


def test_a_force_belongs_to_the_picture_that_it_trails(converted):
    on_time, late = (force_of(converted[0] / "2023-12-16", f"golf_ball__t={lag}") for lag in (0, 1))
    both = on_time.keys() & late.keys()
    assert len(both) > 20
    assert [late[frame] for frame in both] == pytest.approx([on_time[frame] for frame in both])
    assert min(on_time.values()) == pytest.approx(-10, abs=0.1)


def test_pictures_are_rectified_by_the_pads_corners(own_wedge: Path, tmp_path: Path):
    config = own_wedge / "wedge_config/config_100.csv"
    narrow = {"topleft": (70, 50), "topright": (90, 50), "bottomleft": (70, 70), "bottomright": (90, 70)}
    write_table(config, [{"Name": name, "x": x, "y": y} for name, (x, y) in narrow.items()])
    convert(own_wedge, LAYOUTS["wedge"], tmp_path / "out")
    (deepest,) = sorted(rows_of(tmp_path / "out/day"), key=lambda row: float(row["fz_n"]))[:1]
    # The spot covers all of such a small quadrilateral.
    assert cv2.imread(str(tmp_path / "out/day" / deepest["picture"])).min() > 115


def test_pictures_in_contact_are_thinned_and_those_of_the_reference_kept(own_wedge: Path, tmp_path: Path):
    (every,) = convert(own_wedge, LAYOUTS["wedge"], tmp_path / "every")
    (third,) = convert(own_wedge, LAYOUTS["wedge"], tmp_path / "third", every=3)
    at_rest = [row for row in rows_of(tmp_path / "third/day") if float(row["fz_n"]) > -0.3]
    assert len(at_rest) == 5
    assert third.written - 5 == -(-(every.written - 5) // 3)


def test_a_clip_that_begins_with_a_force_or_ends_at_the_largest_lag_is_noted(
    own_wedge: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    day = own_wedge / "example_data/day"
    write_wedge_clip(day, "late_1", lag=5)
    write_wedge_clip(day, "turned_1")
    (day / "ball_1_forces.pkl").write_bytes(pickle.dumps(press_curve(40) + 0.5))
    (day / "turned_1_forces.pkl").write_bytes(pickle.dumps(9 - press_curve(40)))
    main(["convert", str(own_wedge), "--layout", "wedge", "--out", str(tmp_path / "out")])
    lines = capsys.readouterr().out.splitlines()
    (late,) = (line for line in lines if "largest lag" in line)
    (touching,) = (line for line in lines if "begins with a force" in line)
    (turned,) = (line for line in lines if "hardly follow the force" in line)
    assert late.endswith(": day/late_1")
    assert touching.endswith(": day/ball_1, day/turned_1")
    assert turned.endswith(": day/turned_1")
    assert lines[-1] == f"wrote {tmp_path / 'out/day'}"


def test_a_video_cut_off_and_corners_outside_of_the_pictures_are_refused(own_wedge: Path, tmp_path: Path):
    whole = (own_wedge / VIDEO).read_bytes()
    (own_wedge / VIDEO).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=r"clip ball_1 has \d+ of 40 pictures"):
        convert(own_wedge, LAYOUTS["wedge"], tmp_path / "out", lag=0)
    corners = {"topleft": (10, 10), "topright": (600, 12), "bottomleft": (12, 110), "bottomright": (600, 108)}
    rows = [{"Name": name, "x": x, "y": y} for name, (x, y) in corners.items()]
    write_table(own_wedge / "wedge_config/config_100.csv", rows)
    with pytest.raises(ValueError, match="outside of a picture of 160×120 px"):
        convert(own_wedge, LAYOUTS["wedge"], tmp_path / "out")


CORNERS, VIDEO = "wedge_config/config_100.csv", "example_data/day/ball_1.avi"
FORCES = "example_data/day/ball_1_forces.pkl"


def change(clone: Path, file: str, content: bytes | None) -> None:
    """Give a file of a clone another content; None: none."""
    if content is None:
        (clone / file).unlink()
    else:
        (clone / file).write_bytes(content)


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        (CORNERS, None, r"no clone of EstimateModulus.*git clone https"),
        (CORNERS, b"Name,x,y\ntopleft,1,a\n", "must have a row"),
        (VIDEO, None, r"holds no videos.*git clone https"),
        (VIDEO, b"RIFF", "not a video"),
        (FORCES, None, r"ball_1_forces.pkl is missing"),
        (FORCES, pickle.dumps(np.arange(30.0)), "40 of 30 pictures"),
        (FORCES, pickle.dumps(np.zeros(40)), "do not change"),
        (FORCES, pickle.dumps(np.zeros(3)), "at least 10"),
        (FORCES, pickle.dumps(np.zeros((4, 3))), "one number a picture"),
    ],
)
def test_what_is_no_such_clone_is_refused(own_wedge: Path, tmp_path: Path, file, content, message):
    change(own_wedge, file, content)
    with pytest.raises(ValueError, match=message):
        convert(own_wedge, LAYOUTS["wedge"], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_hostile_pickle_is_refused_and_not_run(own_wedge: Path, tmp_path: Path):
    (own_wedge / "example_data/day/ball_1_forces.pkl").write_bytes(pickled(tmp_path))
    with pytest.raises(ValueError, match=r"ball_1_forces.pkl holds something else than an array.*mkdir"):
        convert(own_wedge, LAYOUTS["wedge"], tmp_path / "out")
    assert not (tmp_path / "bait").exists()


@pytest.mark.parametrize(
    "array",
    [np.arange(6.0).reshape(2, 3), np.asfortranarray(np.eye(3)), np.arange(4, dtype=">i2"), np.zeros(0)],
)
def test_an_array_of_numbers_is_read_from_a_pickle(tmp_path: Path, array: np.ndarray):
    for protocol in (3, 4):
        (tmp_path / "a.pkl").write_bytes(pickle.dumps(array, protocol))
        assert np.array_equal(read_pickled_array(tmp_path / "a.pkl"), array)


def nested_shape(levels: int) -> bytes:
    """Return the pickle of an array whose shape is (0, t), t being tuples of twice the same tuple, many levels deep."""
    before, shape, after = pickle.dumps(np.zeros(0), 4).rpartition(b"K\x00\x85\x94h")
    assert shape
    doubled = b"q\xf0h\xf0\x86" * levels
    return before + b"K\x00)" + doubled + b"\x86h" + after


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"(" * 3000 + b"t" * 3000 + b".",
        pickle.dumps("text"),
        pickle.dumps(np.array([None])),
        pickle.dumps(np.float64(3)),
        pickle.dumps(np.zeros(8)).replace(b"K\x08\x85", b"K\x09\x85"),
        nested_shape(40),
    ],
)
def test_other_pickles_are_refused_in_one_sentence(tmp_path: Path, content: bytes):
    (tmp_path / "a.pkl").write_bytes(content)
    with pytest.raises(ValueError, match="something else than an array of numbers") as refused:
        read_pickled_array(tmp_path / "a.pkl")
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 400


def test_presses_have_their_centre_from_the_pictures_middle(tmp_path: Path):
    found = convert(write_ball_clone(tmp_path / "gelsight"), LAYOUTS["ball-presses"], tmp_path / "out")
    assert [(clip.name, clip.pictures, clip.dropped, clip.written) for clip in found] == [
        ("calibration", 6, 0, 6),
        ("calibration2", 6, 0, 6),
        ("calibration3", 6, 1, 5),
    ]
    rows = rows_of(tmp_path / "out/ball-presses")
    assert list(rows[0]) == ["picture", "reference", "x_mm", "y_mm", "clip", "object", "session"]
    assert {row["object"] for row in rows if row["session"] != "calibration3"} == {"ball of 4.84 mm"}
    assert {row["object"] for row in rows if row["session"] == "calibration3"} == {"ball of 3.96 mm"}
    x, y = rectified((100, 150))
    assert float(rows[0]["x_mm"]) == pytest.approx((x - 119.5) * 0.1, abs=0.051)
    assert float(rows[0]["y_mm"]) == pytest.approx((y - 159.5) * 0.1, abs=0.051)
    reference = cv2.imread(str(tmp_path / "out/ball-presses" / rows[0]["reference"]))
    assert np.ptp(reference.astype(int), axis=(0, 1)).max() < 30


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("calibration/ball_position/ball-2.txt", None, r"ball-2.txt is missing"),
        ("calibration/ball_position/ball-2.txt", b"1 b", "three numbers"),
        ("calibration2/cal-0.jpg", b"no", r"cal-0.jpg is not readable"),
    ],
)
def test_what_is_no_clone_of_presses_is_refused(tmp_path: Path, file, content, message):
    clone = write_ball_clone(tmp_path / "gelsight", presses=3)
    change(clone / "data", file, content)
    with pytest.raises(ValueError, match=message):
        convert(clone, LAYOUTS["ball-presses"], tmp_path / "out")
    shutil.rmtree(clone / "data")
    with pytest.raises(ValueError, match=r"no clone of yanglh14/gelsight.*git clone https"):
        convert(clone, LAYOUTS["ball-presses"], tmp_path / "out")
