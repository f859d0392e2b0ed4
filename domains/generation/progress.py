"""Progress of a generation: bars on a terminal, a plain line now and then elsewhere."""

import contextlib
import sys
import time
from collections import Counter
from collections.abc import Iterator
from typing import Any, TextIO

_SECONDS_BETWEEN_LINES = 10.0


class GenerationProgress:
    """Counts (done, all) of solves and frames: shown as bars of rich, as plain lines on a stream, or not at all.

    Lines come at the beginning, then at most every ten seconds, and at the end.
    """

    def __init__(self, stream: TextIO | None = None, bars: Any = None) -> None:
        self._stream, self._bars = stream, bars
        self._start = self._told_at = time.monotonic()
        self._done: Counter[str] = Counter()
        self._total = {"solves": 0, "frames": 0}
        self._tasks = {name: bars.add_task(name, total=None, left="") for name in self._total if bars}

    def begin(self, solves: int, frames: int) -> None:
        """Say how many solves and frames are to be done."""
        self._start = time.monotonic()
        self._done, self._total = Counter(), {"solves": solves, "frames": frames}
        self._show(first=True)

    def solved(self) -> None:
        """Say that one more solve is done."""
        self._done["solves"] += 1
        self._show()

    def written(self, frames: int) -> None:
        """Say that this many more frames are on disk."""
        self._done["frames"] += frames
        self._show()

    @property
    def left(self) -> str:
        """How long the rest takes at the pace of the frames that are written; nothing before one is."""
        done, total = self._done["frames"], self._total["frames"]
        left_s = (time.monotonic() - self._start) * (total - done) / done if done else 0.0
        if left_s < 1:
            return ""
        return f"about {left_s:.0f} s left" if left_s < 90 else f"about {left_s / 60:.0f} min left"

    def _show(self, first: bool = False) -> None:
        for name, task in self._tasks.items():
            if first:
                self._bars.reset(task, total=self._total[name])
            self._bars.update(task, completed=self._done[name], left=self.left if name == "frames" else "")
        now, complete = time.monotonic(), all(self._done[name] == self._total[name] for name in self._total)
        if self._stream and (first or complete or now - self._told_at >= _SECONDS_BETWEEN_LINES):
            self._told_at = now
            told = ", ".join(f"{self._done[name]}/{total} {name}" for name, total in self._total.items())
            left = f"; {self.left}" if self.left else ""
            when = "to do" if first else f"{now - self._start:6.0f} s"
            print(f"{when}: {told}{left}", file=self._stream, flush=True)


@contextlib.contextmanager
def shown_progress(stream: TextIO | None = None) -> Iterator[GenerationProgress]:
    """Yield the progress that suits the stream (standard error by default): bars on a terminal, else plain lines."""
    stream = stream or sys.stderr
    if not stream.isatty():
        yield GenerationProgress(stream)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn

    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), "{task.fields[left]}")
    with Progress("{task.description}", *columns, console=Console(file=stream)) as bars:
        yield GenerationProgress(bars=bars)
