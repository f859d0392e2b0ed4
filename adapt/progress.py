"""Progress of a training run: a bar on a terminal, plain lines elsewhere, nothing in a library call."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Progress = Callable[[str, int, int, str], None]
"""Called after every epoch with the stage's title, the epochs done, the epochs in all, and a short message."""


def silent(title: str, done: int, total: int, message: str) -> None:
    """Say nothing."""


@contextmanager
def console_progress() -> Iterator[Progress]:
    """Yield a `Progress` for the command line; it writes to stderr."""
    from rich.console import Console

    console = Console(file=sys.stderr)
    if not console.is_terminal:

        def lines(title: str, done: int, total: int, message: str) -> None:
            if done == total or done % max(1, total // 5) == 0:
                print(f"{title}: epoch {done}/{total}  {message}", file=sys.stderr, flush=True)

        yield lines
        return

    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Bars(*columns, TextColumn("{task.fields[message]}"), console=console) as bars:
        tasks = {}

        def advance(title: str, done: int, total: int, message: str) -> None:
            if title not in tasks:
                tasks[title] = bars.add_task(title, total=total, message="")
            bars.update(tasks[title], completed=done, message=message)

        yield advance
