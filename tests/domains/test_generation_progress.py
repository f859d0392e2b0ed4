import io

from gelgap.domains import generation_progress
from gelgap.domains.generation_progress import PlainLines, shown_progress
from gelgap.domains.time_left import SolveSize, Workload


def test_without_a_terminal_progress_is_plain_lines_and_starts_again_with_each_job():
    stream = io.StringIO()
    with shown_progress(stream) as progress:
        for _ in range(2):
            progress.begin(1, 4)
            progress.solved()
            progress.written(4)
    assert isinstance(progress, PlainLines)
    lines = stream.getvalue().splitlines()
    assert [line.split(": ")[1] for line in lines] == ["0/1 solves, 0/4 frames", "1/1 solves, 4/4 frames"] * 2


def test_load_steps_are_counted_inside_solves_and_say_how_long_the_rest_takes(monkeypatch):
    monkeypatch.setattr(generation_progress, "_SECONDS_BETWEEN_LINES", 0.0)
    stream = io.StringIO()
    progress = PlainLines(stream)
    load = Workload({"a": SolveSize(4, 300.0), "b": SolveSize(2, 20.0)}, 8, 0.01, workers=2, renderers=1)
    progress.begin(2, 8, load)
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
    assert lines[0].endswith("; about 5 min left")
    assert "left" not in lines[-1]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_on_a_terminal_the_time_left_stands_beside_the_bars():
    stream = Terminal()
    with shown_progress(stream) as progress:
        progress.begin(1, 4, Workload({"a": SolveSize(4, 300.0)}, 4, 0.01, workers=1, renderers=1))
        progress.stepped("a", 1)
    assert "load steps" in stream.getvalue()
    assert "min left" in stream.getvalue()
