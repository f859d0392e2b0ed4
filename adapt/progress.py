"""The progress of a training: what is told after every epoch, and how the console shows it."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Progress = Callable[[str, int, int, str], None]
"""Called after every epoch with the stage's title, the epochs done, the epochs in all, and a short message."""


def silent(title: str, done: int, total: int, message: str) -> None:
    """Say nothing."""


@contextmanager
def console_progress() -> Iterator[Progress]:
    """Yield a `Progress` that writes to stderr: a bar on a terminal, plain lines elsewhere."""
    if not sys.stderr.isatty():
        yield _print_some
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), "{task.fields[message]}")
    with Bars("{task.description}", *columns, console=Console(file=sys.stderr)) as bars:
        tasks = {}

        def advance(title: str, done: int, total: int, message: str) -> None:
            if title not in tasks:
                tasks[title] = bars.add_task(title, total=total, message="")
            bars.update(tasks[title], completed=done, message=message)

        yield advance


def _print_some(title: str, done: int, total: int, message: str) -> None:
    """Print a line for every fifth of the epochs."""
    if done == total or done % max(1, total // 5) == 0:
        print(f"{title}: epoch {done}/{total}  {message}", file=sys.stderr, flush=True)
