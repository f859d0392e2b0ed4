import io

from gelgap.domains import shown_progress
from gelgap.domains.generation import progress as module
from gelgap.domains.generation.progress import ShownProgress, Workload


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


def test_load_steps_are_counted_inside_solves_and_say_how_long_the_rest_takes(monkeypatch):
    monkeypatch.setattr(module, "_SECONDS_BETWEEN_LINES", 0.0)
    now, stream = clock(monkeypatch), io.StringIO()
    progress = ShownProgress(stream)
    progress.begin(2, 8, Workload({"a": 4, "b": 2}, step_s=1.0))
    now[0] = 100.0
    progress.stepped("a", 2)
    progress.stepped("a", 1)  # events of a cluster may come late
    progress.solved("b")
    progress.solved("a")
    progress.written(8)
    lines = [line.split(": ", 1)[1] for line in stream.getvalue().splitlines()]
    assert [line.partition("; ")[0] for line in lines] == [
        "0/2 solves, 0/6 load steps, 0/8 frames",
        "0/2 solves, 2/6 load steps, 0/8 frames",
        "0/2 solves, 2/6 load steps, 0/8 frames",
        "1/2 solves, 4/6 load steps, 0/8 frames",
        "2/2 solves, 6/6 load steps, 0/8 frames",
        "2/2 solves, 6/6 load steps, 8/8 frames",
    ]
    assert "left" not in lines[0]
    assert lines[1].endswith("; about 3 min left")
    assert lines[3].endswith("; about 53 s left")
    assert "left" not in lines[-1]


def test_frames_alone_say_how_long_the_rest_takes(monkeypatch):
    now = clock(monkeypatch)
    progress = ShownProgress(io.StringIO())
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
        progress.begin(1, 4, Workload({"a": 4}, step_s=1.0))
        now[0] = 100.0
        progress.stepped("a", 1)
    assert "load steps" in stream.getvalue()
    assert "min left" in stream.getvalue()
