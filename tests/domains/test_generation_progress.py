import io

from gelgap.domains import generation_progress
from gelgap.domains.generation_progress import PlainLines, SolveSize, shown_progress


def test_without_a_terminal_progress_is_plain_lines_and_starts_again_with_each_job():
    stream = io.StringIO()
    with shown_progress(stream) as progress:
        for _ in range(2):
            progress.begin(1, 4)
            progress.solved()
            progress.written(4)
    assert isinstance(progress, PlainLines)
    lines = stream.getvalue().splitlines()
    assert [line.split(": ")[1] for line in lines] == ["1 solves, 4 frames", "1/1 solves, 4/4 frames"] * 2


def test_load_steps_are_counted_inside_solves_and_say_how_long_the_rest_takes(monkeypatch):
    monkeypatch.setattr(generation_progress, "_SECONDS_BETWEEN_LINES", 0.0)
    stream = io.StringIO()
    progress = PlainLines(stream)
    progress.begin(2, 8, {"a": SolveSize(4, 60.0), "b": SolveSize(2, 20.0)}, workers=2)
    progress.stepped("a", 2)
    progress.stepped("a", 1)  # events of a cluster may come late
    progress.solved("b")
    progress.solved("a")
    lines = [line.split(": ", 1)[1] for line in stream.getvalue().splitlines()]
    assert lines == [
        "2 solves of 6 load steps, 8 frames; about 60 s of solving left",
        "0/2 solves, 2/6 load steps, 0/8 frames; about 30 s of solving left",
        "0/2 solves, 2/6 load steps, 0/8 frames; about 30 s of solving left",
        "1/2 solves, 4/6 load steps, 0/8 frames; about 30 s of solving left",
        "2/2 solves, 6/6 load steps, 0/8 frames",
    ]
