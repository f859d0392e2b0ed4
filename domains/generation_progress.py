"""Progress of a generation: bars on a terminal, a plain line now and then elsewhere."""

import contextlib
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TextIO

_SECONDS_BETWEEN_LINES = 10.0


@dataclass(frozen=True)
class SolveSize:
    """The load steps of a solve, and the seconds of a core that they are expected to take."""

    load_steps: int
    core_s: float


Sizes = Mapping[str, SolveSize]


class GenerationProgress:
    """How a generation reports its progress; this one is silent."""

    def begin(self, solves: int, frames: int, sizes: Sizes | None = None, workers: int | None = None) -> None:
        """Say how much is to be done: the sizes of solves by their keys, and how many processes share them."""

    def stepped(self, solve: str, done: int) -> None:
        """Say how many load steps of a solve are done; it may come from another thread, and late."""

    def solved(self, solve: str = "") -> None:
        """Say that one more solve is done."""

    def written(self, frames: int) -> None:
        """Say that this many more frames are on disk."""


class _Counts:
    """What is done of all, in solves, load steps and frames."""

    def __init__(
        self, solves: int = 0, frames: int = 0, sizes: Sizes | None = None, workers: int | None = None
    ) -> None:
        self.all_solves, self.all_frames, self._sizes, self._workers = solves, frames, sizes or {}, workers
        self.solves = self.frames = 0
        self._steps: dict[str, int] = {}
        self._rendering_since: float | None = None

    @property
    def steps(self) -> int:
        return sum(self._steps.values())

    @property
    def all_steps(self) -> int:
        return sum(size.load_steps for size in self._sizes.values())

    @property
    def complete(self) -> bool:
        return (self.solves, self.frames) == (self.all_solves, self.all_frames)

    def step(self, solve: str, done: int) -> None:
        known = self._steps.get(solve, 0)
        self._steps[solve] = max(done, known)

    def solve(self, solve: str) -> None:
        self.solves += 1
        if solve in self._sizes:
            self.step(solve, self._sizes[solve].load_steps)
        self._rendering_since = self._rendering_since or time.monotonic()

    @property
    def left(self) -> str:
        """How long the rest takes, in words: solving by what is expected, frames by those that there are."""
        if self._workers is None or self.complete:
            return ""
        remaining_s = [
            size.core_s * (1 - self._steps.get(key, 0) / size.load_steps) for key, size in self._sizes.items()
        ]
        # One solve is not shared: the longest is the least that it takes.
        solving_s = max([sum(remaining_s) / self._workers, *remaining_s])
        if not self.frames:
            return f"; about {solving_s:.0f} s of solving left" if solving_s >= 1 else ""
        passed_s = time.monotonic() - (self._rendering_since or time.monotonic())
        return f"; about {solving_s + passed_s * (self.all_frames / self.frames - 1):.0f} s left"

    def __str__(self) -> str:
        steps = f"{self.steps}/{self.all_steps} load steps, " if self.all_steps else ""
        return f"{self.solves}/{self.all_solves} solves, {steps}{self.frames}/{self.all_frames} frames"


class PlainLines(GenerationProgress):
    """Prints what is to be done, then a line at most every ten seconds, and one at the end."""

    def __init__(self, stream: TextIO):
        self._stream = stream
        self._counts = _Counts()
        self._start = self._last = time.monotonic()
        self._lock = threading.Lock()

    def begin(self, solves: int, frames: int, sizes: Sizes | None = None, workers: int | None = None) -> None:
        with self._lock:
            self._counts = _Counts(solves, frames, sizes, workers)
            self._start = self._last = time.monotonic()
            of = f" of {self._counts.all_steps} load steps" if self._counts.all_steps else ""
            self._print(f"to do: {solves} solves{of}, {frames} frames{self._counts.left}")

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
            self._counts.frames += frames
            self._tell()

    def _print(self, line: str) -> None:
        print(line, file=self._stream, flush=True)

    def _tell(self) -> None:
        now = time.monotonic()
        if now - self._last >= _SECONDS_BETWEEN_LINES or self._counts.complete:
            self._last = now
            self._print(f"{now - self._start:6.0f} s: {self._counts}{self._counts.left}")


class _Bars(GenerationProgress):
    """Bars of solves, of their load steps and of frames."""

    def __init__(self, bars: Any):
        self._bars = bars
        self._counts = _Counts()
        self._tasks = {name: bars.add_task(name, total=None) for name in ("solves", "load steps", "frames")}

    def begin(self, solves: int, frames: int, sizes: Sizes | None = None, workers: int | None = None) -> None:
        self._counts = _Counts(solves, frames, sizes, workers)
        totals = {"solves": solves, "load steps": self._counts.all_steps, "frames": frames}
        for name, total in totals.items():
            self._bars.reset(self._tasks[name], total=total)

    def stepped(self, solve: str, done: int) -> None:
        self._counts.step(solve, done)
        self._show()

    def solved(self, solve: str = "") -> None:
        self._counts.solve(solve)
        self._show()

    def written(self, frames: int) -> None:
        self._counts.frames += frames
        self._show()

    def _show(self) -> None:
        done = {
            "solves": self._counts.solves,
            "load steps": self._counts.steps,
            "frames": self._counts.frames,
        }
        for name, count in done.items():
            self._bars.update(self._tasks[name], completed=count)


@contextlib.contextmanager
def shown_progress(stream: TextIO | None = None) -> Iterator[GenerationProgress]:
    """Yield the progress that suits the stream (standard error by default): bars on a terminal, else plain lines."""
    stream = stream or sys.stderr
    if not stream.isatty():
        yield PlainLines(stream)
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress("{task.description}", *columns, console=Console(file=stream)) as bars:
        yield _Bars(bars)
