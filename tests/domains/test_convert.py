"""A user's recordings become picture folders, and what must be refused."""

from pathlib import Path

import pandas as pd
import pytest
from real_clones import force_of, rows_of, write_recordings, write_table

from gelgap.domains import convert
from gelgap.domains.formats.convert import COLUMNS, write_picture_table


def test_a_users_recordings_are_lined_up_by_their_own_clocks(tmp_path: Path):
    found = convert(write_recordings(tmp_path / "mine"), "recordings", tmp_path / "out")
    assert [(clip.domain, clip.name, clip.lag) for clip in found] == [
        ("mine", "press-1", 3),
        ("mine", "press-2", 0),
    ]
    rows = rows_of(tmp_path / "out/mine")
    assert list(rows[0]) == ["picture", "reference", "fx_n", "fz_n", "clip", "object", "session", "time_s"]
    assert {row["object"] for row in rows} == {"press"}
    on_video, of_pictures = (force_of(tmp_path / "out/mine", name) for name in ("press-1", "press-2"))
    assert on_video[26] == pytest.approx(of_pictures[26], abs=0.2)
    assert all(float(row["fx_n"]) == pytest.approx(-0.1 * float(row["fz_n"])) for row in rows[:20])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda mine: [path.unlink() for path in mine.glob("*.csv")], "holds no recordings.*time_s, fz_n"),
        (lambda mine: (mine / "press-1.avi").unlink(), "has no pictures"),
        (lambda mine: (mine / "press-2.mp4").write_bytes(b""), "has several: press-2, press-2.mp4"),
        (
            lambda mine: (mine / "press-1.csv").write_text("when,fz_n\n1,2\n"),
            "the column time_s is needed; there are when, fz_n",
        ),
        (lambda mine: (mine / "press-1.csv").write_text("time_s,depth_mm\n1,2\n"), "one of fx_n, fy_n, fz_n"),
        (
            lambda mine: (mine / "press-1.csv").write_text("time_s,fz_n\n1,a\n"),
            "row 1 below the header holds 'a'",
        ),
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
            # Before any picture is decoded.
            lambda mine: (
                (mine / "press-2/7.png").write_bytes(b"no"),
                write_table(mine / "press-2.csv", [{"time_s": 1e9 + k / 30, "fz_n": -k} for k in range(40)]),
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
    table.to_csv(mine / "press-1.csv", index=False)
    assert len(convert(mine, "recordings", tmp_path / "out")) == 2


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
