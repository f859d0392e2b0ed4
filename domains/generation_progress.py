"""Progress of a generation: bars on a terminal, a plain line now and then elsewhere."""

import contextlib
import sys
import time
from collections.abc import Iterator
from typing import Any, TextIO

_SECONDS_BETWEEN_LINES = 10.0


class GenerationProgress:
    """How a generation reports its progress; this one is silent."""

    def begin(self, solves: int, frames: int) -> None:
        """Say how much is to be done."""

    def solved(self) -> None:
        """Say that one more solve is done."""

    def written(self, frames: int) -> None:
        """Say that this many more frames are on disk."""


class PlainLines(GenerationProgress):
    """Prints a line at most every ten seconds, and one at the end."""

    def __init__(self, stream: TextIO):
        self._stream = stream
        self._done = [0, 0]
        self._all = [0, 0]
        self._start = self._last = time.monotonic()

    def begin(self, solves: int, frames: int) -> None:
        self._done, self._all = [0, 0], [solves, frames]
        self._start = self._last = time.monotonic()
        self._print(f"to do: {solves} solves, {frames} frames")

    def solved(self) -> None:
        self._advance(0, 1)

    def written(self, frames: int) -> None:
        self._advance(1, frames)

    def _print(self, line: str) -> None:
        print(line, file=self._stream, flush=True)

    def _advance(self, which: int, count: int) -> None:
        self._done[which] += count
        now = time.monotonic()
        if now - self._last >= _SECONDS_BETWEEN_LINES or self._done == self._all:
            self._last = now
            (solves, frames), (all_solves, all_frames) = self._done, self._all
            self._print(
                f"{now - self._start:6.0f} s: {solves}/{all_solves} solves, {frames}/{all_frames} frames"
            )


class _Bars(GenerationProgress):
    """Two bars: solves and frames."""

    def __init__(self, bars: Any):
        self._bars = bars
        self._solves = bars.add_task("solves", total=None)
        self._frames = bars.add_task("frames", total=None)

    def begin(self, solves: int, frames: int) -> None:
        self._bars.reset(self._solves, total=solves)
        self._bars.reset(self._frames, total=frames)

    def solved(self) -> None:
        self._bars.advance(self._solves)

    def written(self, frames: int) -> None:
        self._bars.advance(self._frames, frames)


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
