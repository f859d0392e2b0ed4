"""Progress of a generation: bars on a terminal, a plain line now and then elsewhere."""

import contextlib
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, TextIO

_SECONDS_BETWEEN_LINES = 10.0


@dataclass(frozen=True)
class Workload:
    """The load steps of each solve that the cache lacks, by its key, and what a step and a frame take of a core, s."""

    load_steps: Mapping[str, int] = field(default_factory=dict)
    step_s: float = 1.0
    frame_s: float = 0.015


class GenerationProgress:
    """How a generation reports its progress; this one is silent."""

    def begin(self, solves: int, frames: int, load: Workload | None = None) -> None:
        """Say how many solves and frames are to be done, and what the solves take."""

    def stepped(self, solve: str, done: int) -> None:
        """Say how many load steps of a solve are done; it may come from another thread, and late."""

    def solved(self, solve: str = "") -> None:
        """Say that one more solve is done."""

    def written(self, frames: int) -> None:
        """Say that this many more frames are on disk."""


class ShownProgress(GenerationProgress):
    """Counts (done, all) of solves, load steps and frames, shown as bars of rich or as plain lines.

    Lines come at the beginning, then at most every ten seconds, and at the end.
    """

    def __init__(self, stream: TextIO | None = None, bars: Any = None) -> None:
        self._stream, self._bars, self._lock = stream, bars, threading.Lock()
        self._start = self._told_at = time.monotonic()
        self._load, self._steps = Workload(), dict[str, int]()
        self.counts = {"solves": (0, 0), "load steps": (0, 0), "frames": (0, 0)}
        self._tasks = {name: bars.add_task(name, total=None, left="") for name in self.counts if bars}

    def begin(self, solves: int, frames: int, load: Workload | None = None) -> None:
        self._start, self._load = time.monotonic(), load or Workload()
        self._steps = dict.fromkeys(self._load.load_steps, 0)
        steps = (0, sum(self._load.load_steps.values()))
        self.counts = {"solves": (0, solves), "load steps": steps, "frames": (0, frames)}
        self._show(first=True)

    def stepped(self, solve: str, done: int) -> None:
        self._count("load steps", 0, solve, done)

    def solved(self, solve: str = "") -> None:
        self._count("solves", 1, solve, self._load.load_steps.get(solve, 0))

    def written(self, frames: int) -> None:
        self._count("frames", frames)

    def _count(self, what: str, more: int, solve: str = "", steps_done: int = 0) -> None:
        with self._lock:
            if solve in self._steps:
                self._steps[solve] = max(self._steps[solve], steps_done)
            self.counts[what] = (self.counts[what][0] + more, self.counts[what][1])
            self.counts["load steps"] = (sum(self._steps.values()), self.counts["load steps"][1])
            self._show()

    @property
    def left(self) -> str:
        """How long the rest takes if it goes on as until now; nothing where that is not known, or next to nothing."""
        weight_s = {"load steps": self._load.step_s, "frames": self._load.frame_s}
        done_s, all_s = (sum(weight_s[what] * self.counts[what][i] for what in weight_s) for i in (0, 1))
        left_s = (time.monotonic() - self._start) * (all_s - done_s) / done_s if done_s else 0.0
        if left_s < 1:
            return ""
        return f"about {left_s:.0f} s left" if left_s < 90 else f"about {left_s / 60:.0f} min left"

    def _show(self, first: bool = False) -> None:
        for name, task in self._tasks.items():
            done, total = self.counts[name]
            if first:
                self._bars.reset(task, total=total)
            self._bars.update(task, completed=done, left=self.left if name == "solves" else "")
        now, complete = time.monotonic(), all(done == total for done, total in self.counts.values())
        if self._stream and (first or complete or now - self._told_at >= _SECONDS_BETWEEN_LINES):
            self._told_at = now
            told = (f"{n}/{of} {what}" for what, (n, of) in self.counts.items() if of or what != "load steps")
            left = f"; {self.left}" if self.left else ""
            when = "to do" if first else f"{now - self._start:6.0f} s"
            print(f"{when}: {', '.join(told)}{left}", file=self._stream, flush=True)


@contextlib.contextmanager
def shown_progress(stream: TextIO | None = None) -> Iterator[GenerationProgress]:
    """Yield the progress that suits the stream (standard error by default): bars on a terminal, else plain lines."""
    stream = stream or sys.stderr
    if not stream.isatty():
        yield ShownProgress(stream)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn

    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), "{task.fields[left]}")
    with Progress("{task.description}", *columns, console=Console(file=stream)) as bars:
        yield ShownProgress(bars=bars)
