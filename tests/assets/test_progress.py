"""One display of progress: lines where there is no terminal, bars where there is one, nothing in threads."""

import io
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from gelgap.assets import progress as module
from gelgap.assets.progress import hidden_progress, shown_progress


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time in seconds, as a list of one number that may be changed; rich looks at it, too."""
    now = [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    monkeypatch.setattr("rich.console.monotonic", lambda: now[0])
    return now


def test_without_a_terminal_it_is_a_line_at_the_beginning_and_every_ten_seconds(capsys, now):
    with shown_progress() as progress:
        for frames in range(0, 50, 10):
            progress("frames", frames, 40, "of mb0i0" if frames else "")
            now[0] += 5.0
        progress("solves", 1, 1)
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition("; about")[0] for line in lines] == [
        "frames: 0 of 40",
        "frames: 20 of 40; of mb0i0",
        "frames: 40 of 40; of mb0i0",
        "solves: 1 of 1",
    ]


def test_the_time_left_is_by_the_pace_of_the_work_itself_not_of_what_came_before(capsys, now):
    with shown_progress() as progress:
        progress("frames", 0, 400)
        for frames in (100, 200, 300):
            now[0] += 100.0 if frames == 100 else 20.0
            progress("frames", frames, 400)
    assert capsys.readouterr().err.splitlines()[-1] == "frames: 300 of 400; about 20 s left"


def test_blocks_within_a_block_share_its_display_and_threads_have_none(capsys):
    with shown_progress() as outer, shown_progress() as inner, ThreadPoolExecutor() as pool:
        assert inner is outer

        def in_thread():
            with shown_progress() as shown:
                return shown

        assert pool.submit(in_thread).result() is hidden_progress
    with shown_progress() as later:
        assert later is not outer


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_on_a_terminal_there_are_bars_which_are_taken_away_in_the_end_also_after_an_error(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", stream := Terminal())

    def fails() -> None:
        with shown_progress() as progress:
            progress("solves", 0, 2)
            progress("solves", 1, 2, "a message")
            raise ValueError("stop")

    with pytest.raises(ValueError, match="stop"):
        fails()
    text = stream.getvalue()
    assert "solves" in text
    assert "1/2" in text
    assert text.endswith("\x1b[2K")
