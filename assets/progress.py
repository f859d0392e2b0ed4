"""How far long work is: bars of rich on a terminal and in a notebook, a plain line now and then elsewhere."""

import multiprocessing
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from importlib.util import find_spec
from typing import Protocol

SECONDS_BETWEEN_LINES = 10.0
# Steps that the time left is estimated from: a load step on a fine mesh takes a minute.
_SPEED_PERIOD_S = 300.0


class Progress(Protocol):
    """Told how far work is: its title, how much is done, how much there is, and a short message."""

    def __call__(self, title: str, done: int, total: int, message: str = "") -> None: ...


_SHOWN: ContextVar[Progress | None] = ContextVar("shown", default=None)


def hidden_progress(title: str, done: int, total: int, message: str = "") -> None:
    """Say nothing."""


@contextmanager
def shown_progress() -> Iterator[Progress]:
    """Yield a `Progress` that is shown, on standard error or in the notebook, until the block ends.

    Blocks within the block share its display. Threads and worker processes show nothing: who started them does.
    """
    shown = _SHOWN.get()
    in_main_thread = threading.current_thread() is threading.main_thread()
    if shown is not None or not in_main_thread or multiprocessing.parent_process() is not None:
        yield shown or hidden_progress
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TimeRemainingColumn
    from rich.progress import Progress as Bars

    console = Console(stderr=True)
    has_bars = bool(find_spec("ipywidgets")) if console.is_jupyter else console.is_terminal
    columns = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(elapsed_when_finished=True))
    bars = Bars(
        "{task.description}",
        *columns,
        "{task.fields[message]}",
        console=console,
        transient=True,
        redirect_stdout=False,  # rich would move it to standard error
        speed_estimate_period=_SPEED_PERIOD_S,
        disable=not has_bars,
    )
    tasks: dict[str, TaskID] = {}
    next_line: dict[str, float] = {}

    def tell(title: str, done: int, total: int, message: str = "") -> None:
        if title not in tasks:
            tasks[title] = bars.add_task(title, message="")
        task = tasks[title]
        if done == 0:
            bars.reset(task)
        bars.update(task, completed=done, total=total, message=message)
        if not has_bars and (now := time.monotonic()) >= next_line.get(title, 0.0):
            next_line[title] = now + SECONDS_BETWEEN_LINES
            _print_line(title, done, total, message, bars.tasks[task].time_remaining)

    token = _SHOWN.set(tell)
    try:
        with bars:
            yield tell
    finally:
        _SHOWN.reset(token)


def _print_line(title: str, done: int, total: int, message: str, left_s: float | None) -> None:
    parts = [f"{title}: {done} of {total}", message]
    if left_s:
        parts.append(f"about {left_s:.0f} s left" if left_s < 90 else f"about {left_s / 60:.0f} min left")
    print("; ".join(filter(None, parts)), file=sys.stderr, flush=True)
