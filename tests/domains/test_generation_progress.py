import io

from gelgap.domains.generation_progress import PlainLines, shown_progress


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
