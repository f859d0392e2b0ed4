"""A user's recordings become picture folders, and what must be refused."""

import re
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from real_clones import force_of, pictures_of, rows_of, write_recordings, write_table, write_video

from gelgap.data import convert
from gelgap.data.formats.convert import COLUMNS, write_picture_table
from gelgap.data.formats.video import video_pictures


def test_a_users_recordings_are_lined_up_by_their_clocks(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    mine = write_recordings(tmp_path / "mine")
    whole = (mine / "press-1.avi").read_bytes()
    (mine / "press-1.avi").rename(mine / "press-1.AVI").write_bytes(whole[: -len(whole) // 10])
    (mine / "no-table.mp4").touch()
    found = convert(mine, "recordings", tmp_path / "out")
    assert [(own.domain, own.name, own.lag) for own in found] == [
        ("mine", "press-1", 3),
        ("mine", "press-2", 0),
    ]
    rows = rows_of(tmp_path / "out/mine")
    columns = "picture reference fx_n fz_n clip object session time_s trajectory_id step"
    assert list(rows[0]) == columns.split()
    assert {(row["clip"], row["trajectory_id"]) for row in rows} == {("press-1", "0"), ("press-2", "1")}
    assert {row["object"] for row in rows} == {"press"}
    on_video, of_pictures = (force_of(tmp_path / "out/mine", name) for name in ("press-1", "press-2"))
    assert "not read, since no CSV table has their name: no-table.mp4" in caplog.messages
    assert "press-1.AVI states 40 pictures, of which 3" in caplog.text
    assert on_video[26] == pytest.approx(of_pictures[26], abs=0.2)
    assert all(float(row["fx_n"]) == pytest.approx(-0.1 * float(row["fz_n"])) for row in rows[:20])


def test_of_a_video_that_states_its_length_alone_it_is_said_that_it_is_cut_off(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    noise = np.random.default_rng(0).integers(0, 255, (60, 48, 64, 3), np.uint8)
    write_video(video := tmp_path / "press.mkv", list(noise))
    assert len(list(video_pictures(video))) == 60
    assert not caplog.messages
    video.write_bytes(video.read_bytes()[: video.stat().st_size // 2])
    assert len(list(video_pictures(video))) in (29, 30)
    assert re.search("press.mkv states 2.0 s, of which (0.9|1.0) s could be read", caplog.text)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda mine: [path.unlink() for path in mine.glob("*.csv")], "holds no recordings.*time_s, fz_n"),
        (lambda mine: (mine / "press-1.avi").unlink(), "has no pictures"),
        (lambda mine: (mine / "press-2.mp4").write_bytes(b""), "has several: press-2, press-2.mp4"),
        (lambda mine: (mine / "press-1.csv").write_text("when,fz_n\n1,2\n"), "time_s is needed"),
        (lambda mine: (mine / "press-1.csv").write_text("time_s,depth_mm\n1,2\n"), "one of fx_n, fy_n, fz_n"),
        (lambda mine: (mine / "press-1.csv").write_text("time_s,fz_n\n1,9\n2,0\n"), "turn its sign"),
        (
            lambda mine: (mine / "press-1.csv").write_text("time_s,fz_n\n1,-9\n0,0\n"),
            r"row 2 below the header 0 s comes after 1 s",
        ),
        (lambda mine: (mine / "press-2/times.csv").unlink(), "one table with the columns picture, time_s"),
        (
            lambda mine: (mine / "press-2/7.png").unlink(),
            "names the picture '7.png' in row 8 below the header, which is not there: expected 7.png",
        ),
        (lambda mine: (mine / "press-2/7.png").write_bytes(b"no"), "7.png is not readable"),
        (
            lambda mine: cv2.imwrite(str(mine / "press-2/7.png"), np.zeros((90, 120, 3), np.uint8)),
            r"7\.png is 120×90 px, and 0\.png \d+×\d+ px: all must have one size",
        ),
        (
            lambda mine: write_table(
                mine / "press-1.csv", [{"time_s": k / 30, "fz_n": -0.7} for k in range(60)]
            ),
            "do not change",
        ),
        (
            lambda mine: write_table(mine / "press-1.csv", [{"time_s": k, "fz_n": -k} for k in range(2)]),
            "2 rows of labels; at least 10 of each",
        ),
        (
            # A force that rises alone goes with no part of the pictures.
            lambda mine: write_table(
                mine / "press-2.csv", [{"time_s": 1e9 + k / 30, "fz_n": -k} for k in range(40)]
            ),
            "count both from the same moment",
        ),
    ],
)
def test_recordings_that_do_not_fit_are_refused(tmp_path: Path, change, message: str):
    mine = write_recordings(tmp_path / "mine")
    change(mine)
    with pytest.raises(ValueError, match=message):
        convert(mine, "recordings", tmp_path / "out")


def test_columns_that_are_not_read_may_hold_anything(tmp_path: Path):
    mine = write_recordings(tmp_path / "mine")
    table = pd.read_csv(mine / "press-1.csv").assign(label="firm", session="")
    table.rename(columns={"time_s": "%time_s"}).to_csv(mine / "press-1.csv", index=False)
    cv2.imwrite(str(mine / "press-2/spare.png"), np.zeros((60, 80, 3), np.uint8))
    _, of_pictures = convert(mine, "recordings", tmp_path / "out")
    assert of_pictures.notes == ("1 pictures have no row in times.csv: not read",)


def test_an_unknown_layout_and_a_full_folder_are_refused(tmp_path: Path):
    mine = write_recordings(tmp_path / "mine")
    with pytest.raises(ValueError, match="layout 'other' is unknown; known layouts: recordings"):
        convert(mine, "other", tmp_path / "out")
    with pytest.raises(ValueError, match="is not empty"):
        convert(mine, "recordings", mine)


def test_a_table_has_no_empty_cells(tmp_path: Path):
    rows = pd.DataFrame([{"picture": "a.png", "fz_n": -1.0}, {"picture": "b.png", "fz_n": -2.0, "clip": "c"}])
    with pytest.raises(ValueError, match="only some frames have clip"):
        write_picture_table(tmp_path, rows)
    with pytest.raises(ValueError, match="no frame is left"):
        write_picture_table(tmp_path, rows[:0])
    assert COLUMNS[0] == "picture"


def write_noisy_clip(
    folder: Path,
    kind: str,
    lag: int,
    frames: int = 60,
    hole_s: tuple[float, float] = (9, 9),
    press_frames: int = 36,
) -> Path:
    """Write a press that starts and ends at rest, seen by a noisy camera; its forces trail by `lag` frames."""
    random = np.random.default_rng(lag + 20)

    def force_n(frame: np.ndarray) -> np.ndarray:
        return 5 * np.sin(np.clip((frame - 12) / press_frames, 0, 1) * np.pi) ** 2

    noisy = [
        np.clip(picture + random.normal(0, 3, picture.shape), 0, 255).astype(np.uint8)
        for picture in pictures_of(force_n(np.arange(frames)))
    ]
    if kind == "mp4":
        write_video(folder / "press.mp4", noisy, "mp4v")
    else:
        rows = [{"picture": f"{number}.png", "time_s": number / 30} for number in range(frames)]
        write_table(folder / "press/times.csv", rows)
        for row, picture in zip(rows, noisy, strict=True):
            cv2.imwrite(str(folder / "press" / row["picture"]), picture[..., ::-1])
    time_s = np.arange(0, frames / 30, 0.01)
    time_s = time_s[(time_s < hole_s[0]) | (time_s > hole_s[1])]
    measured_n = force_n(time_s * 30 - lag) + random.normal(0, 0.02, len(time_s))
    write_table(
        folder / "press.csv",
        [{"time (ms)": 1000 * t, "Fz [mN]": -1000 * f} for t, f in zip(time_s, measured_n, strict=True)],
    )
    return folder


@pytest.mark.parametrize(
    ("kind", "lag"), [("png", -6), ("png", 0), ("png", 1), ("png", 6), ("mp4", -3), ("mp4", 4)]
)
def test_the_lag_of_a_noisy_clip_that_starts_at_rest_is_found(tmp_path: Path, kind: str, lag: int):
    (clip,) = convert(write_noisy_clip(tmp_path / "mine", kind, lag), "recordings", tmp_path / "out")
    assert clip.lag == lag
    low, high = clip.lag_range
    assert low <= lag <= high <= low + 2
    assert clip.notes == ("'Fz [mN]' is converted to N", "'time (ms)' is converted to s")[::-1]


def test_the_range_of_a_slow_press_on_compressed_video_has_the_lag(tmp_path: Path):
    mine = write_noisy_clip(tmp_path / "mine", "mp4", 2, frames=210, press_frames=180)
    (clip,) = convert(mine, "recordings", tmp_path / "out")
    assert clip.lag_range[0] <= 2 <= clip.lag_range[1]


def test_the_reference_is_of_the_pictures_before_the_contact_less_the_last(tmp_path: Path):
    """A lag may be wrong by one frame: the last picture before the contact may show it."""
    mine, levels = tmp_path / "mine", [100, 140, *[200] * 18]
    rows = [{"picture": f"{k}.png", "time_s": k / 30} for k in range(len(levels))]
    write_table(mine / "press/times.csv", rows)
    for row, level in zip(rows, levels, strict=True):
        cv2.imwrite(str(mine / "press" / row["picture"]), np.full((24, 32, 3), level, np.uint8))
    write_table(mine / "press.csv", [{"time_s": k / 30, "fz_n": -max(k - 1, 0)} for k in range(len(levels))])
    convert(mine, "recordings", tmp_path / "out", lag=0)
    first, *_ = rows_of(tmp_path / "out/mine")
    assert (cv2.imread(str(tmp_path / "out/mine" / first["reference"])) == 100).all()


def test_a_stated_lag_is_taken_and_a_hole_of_the_log_has_no_labels(tmp_path: Path):
    mine = write_noisy_clip(tmp_path / "mine", "png", 2, hole_s=(0.5, 1.0))
    (clip,) = convert(mine, "recordings", tmp_path / "out", lag=0)
    assert (clip.lag, clip.lag_range, clip.in_holes) == (0, None, 16)
    written = force_of(tmp_path / "out/mine", "press")
    assert not set(range(15, 31)) & set(written)
    assert 31 in written
    (clip,) = convert(mine, "recordings", tmp_path / "again")
    assert clip.lag_range[0] <= 2 <= clip.lag_range[1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,Fz (N)\n0,-1\n1,-2\n2,-3\n", "'time' states no unit, and its values are 1 apart"),
        ("time_s,fz_n\n0,-1\n,-2\n", "row 2 below the header has no time"),
    ],
)
def test_a_log_that_does_not_say_what_it_measures_is_refused(tmp_path: Path, text: str, message: str):
    mine = write_recordings(tmp_path / "mine")
    (mine / "press-1.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        convert(mine, "recordings", tmp_path / "out")


def test_forces_of_one_time_are_averaged(tmp_path: Path):
    mine = write_recordings(tmp_path / "mine")
    table = pd.read_csv(mine / "press-2.csv")
    pd.concat([table, table]).sort_values("time_s").to_csv(mine / "press-2.csv", index=False)
    found = convert(mine, "recordings", tmp_path / "out")
    assert found[1].notes == ("40 rows repeat the time of the row before: their mean is taken",)
    times = mine / "press-2/times.csv"
    pd.read_csv(times).assign(time_s=[5, 5, *range(6, 44)]).to_csv(times, index=False)
    with pytest.raises(ValueError, match=r"times.csv: rows 1 and 2 below the header have one time, 5 s"):
        convert(mine, "recordings", tmp_path / "again")
