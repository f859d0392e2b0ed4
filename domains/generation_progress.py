"""Progress of a generation: bars on a terminal, a plain line now and then elsewhere."""

import contextlib
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any, TextIO

from gelgap.domains.time_left import TimeLeft, Workload

_SECONDS_BETWEEN_LINES = 10.0
_LEAST_TOLD_S = 1.0


class GenerationProgress:
    """How a generation reports its progress; this one is silent."""

    def begin(self, solves: int, frames: int, load: Workload | None = None) -> None:
        """Say how much is to be done, and what it is expected to take; None where that is not known."""

    def stepped(self, solve: str, done: int) -> None:
        """Say how many load steps of a solve are done; it may come from another thread, and late."""

    def solved(self, solve: str = "") -> None:
        """Say that one more solve is done."""

    def written(self, frames: int) -> None:
        """Say that this many more frames are on disk."""


class _Counts:
    """What is done of all, in solves, load steps and frames, and how long the rest takes."""

    def __init__(self, solves: int = 0, frames: int = 0, load: Workload | None = None) -> None:
        self.all_solves, self.all_frames = solves, frames
        self.solves = self.frames = 0
        self._left = TimeLeft(load) if load else None
        self._start = time.monotonic()

    @property
    def passed_s(self) -> float:
        return time.monotonic() - self._start

    @property
    def steps(self) -> int:
        return self._left.steps if self._left else 0

    @property
    def all_steps(self) -> int:
        return self._left.all_steps if self._left else 0

    @property
    def complete(self) -> bool:
        return (self.solves, self.frames) == (self.all_solves, self.all_frames)

    def step(self, solve: str, done: int) -> None:
        if self._left:
            self._left.step(solve, done, self.passed_s)

    def solve(self, solve: str) -> None:
        self.solves += 1
        if self._left:
            self._left.solve(solve, self.passed_s)

    def write(self, frames: int) -> None:
        self.frames += frames
        if self._left:
            self._left.write(frames, self.passed_s)

    @property
    def left(self) -> str:
        """How long the rest takes, in words; nothing where that is not known, or next to nothing."""
        left_s = self._left.left_s(self.passed_s) if self._left and not self.complete else None
        if left_s is None or left_s < _LEAST_TOLD_S:
            return ""
        return f"about {left_s:.0f} s left" if left_s < 90 else f"about {left_s / 60:.0f} min left"

    def __str__(self) -> str:
        steps = f"{self.steps}/{self.all_steps} load steps, " if self.all_steps else ""
        left = f"; {self.left}" if self.left else ""
        return f"{self.solves}/{self.all_solves} solves, {steps}{self.frames}/{self.all_frames} frames{left}"


class PlainLines(GenerationProgress):
    """Prints what is to be done, then a line at most every ten seconds, and one at the end."""

    def __init__(self, stream: TextIO):
        self._stream = stream
        self._counts = _Counts()
        self._last = time.monotonic()
        self._lock = threading.Lock()

    def begin(self, solves: int, frames: int, load: Workload | None = None) -> None:
        with self._lock:
            self._counts, self._last = _Counts(solves, frames, load), time.monotonic()
            self._print(f"to do: {self._counts}")

    def stepped(self, solve: str, done: int) -> None:
        with self._lock:
            self._counts.step(solve, done)
            self._tell()

    def solved(self, solve: str = "") -> None:
        with self._lock:
            self._counts.solve(solve)
            self._tell()

    def written(self, frames: int) -> None:
        with self._lock:
            self._counts.write(frames)
            self._tell()

    def _print(self, line: str) -> None:
        print(line, file=self._stream, flush=True)

    def _tell(self) -> None:
        now = time.monotonic()
        if now - self._last >= _SECONDS_BETWEEN_LINES or self._counts.complete:
            self._last = now
            self._print(f"{self._counts.passed_s:6.0f} s: {self._counts}")


class _Bars(GenerationProgress):
    """Bars of solves, of their load steps and of frames; the time left stands beside the first."""

    def __init__(self, bars: Any):
        self._bars = bars
        self._counts = _Counts()
        self._tasks = {
            name: bars.add_task(name, total=None, left="") for name in ("solves", "load steps", "frames")
        }

    def begin(self, solves: int, frames: int, load: Workload | None = None) -> None:
        self._counts = _Counts(solves, frames, load)
        totals = {"solves": solves, "load steps": self._counts.all_steps, "frames": frames}
        for name, total in totals.items():
            self._bars.reset(self._tasks[name], total=total)
        self._show()

    def stepped(self, solve: str, done: int) -> None:
        self._counts.step(solve, done)
        self._show()

    def solved(self, solve: str = "") -> None:
        self._counts.solve(solve)
        self._show()

    def written(self, frames: int) -> None:
        self._counts.write(frames)
        self._show()

    def _show(self) -> None:
        done = {
            "solves": self._counts.solves,
            "load steps": self._counts.steps,
            "frames": self._counts.frames,
        }
        for name, count in done.items():
            left = self._counts.left if name == "solves" else ""
            self._bars.update(self._tasks[name], completed=count, left=left)


@contextlib.contextmanager
def shown_progress(stream: TextIO | None = None) -> Iterator[GenerationProgress]:
    """Yield the progress that suits the stream (standard error by default): bars on a terminal, else plain lines."""
    stream = stream or sys.stderr
    if not stream.isatty():
        yield PlainLines(stream)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn

    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), "{task.fields[left]}")
    with Progress("{task.description}", *columns, console=Console(file=stream)) as bars:
        yield _Bars(bars)
