import io

from gelgap.domains import GenerationProgress, shown_progress
from gelgap.domains.generation import progress as module


def test_without_a_terminal_progress_is_plain_lines_and_starts_again_with_each_job():
    stream = io.StringIO()
    with shown_progress(stream) as progress:
        for _ in range(2):
            progress.begin(1, 4)
            progress.solved()
            progress.written(4)
    lines = stream.getvalue().splitlines()
    assert [line.split(": ")[1] for line in lines] == ["0/1 solves, 0/4 frames", "1/1 solves, 4/4 frames"] * 2


def clock(monkeypatch) -> list[float]:
    """Return the time in seconds, as a list of one number that may be changed."""
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    return now


def test_written_frames_say_how_long_the_rest_takes(monkeypatch):
    now = clock(monkeypatch)
    progress = GenerationProgress(io.StringIO())
    progress.begin(0, 1000)
    now[0] = 20.0
    progress.written(250)
    assert progress.left == "about 60 s left"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_on_a_terminal_the_time_left_stands_beside_the_bars(monkeypatch):
    now, stream = clock(monkeypatch), Terminal()
    with shown_progress(stream) as progress:
        progress.begin(1, 4)
        now[0] = 100.0
        progress.solved()
        progress.written(1)
    assert "solves" in stream.getvalue()
    assert "about 5 min left" in stream.getvalue()
