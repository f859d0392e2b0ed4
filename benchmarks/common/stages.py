"""Wall time and peak memory of each stage of a job, its worker processes included."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

SAMPLING_PERIOD_S = 0.2
MIB = 1024**2


@dataclass(frozen=True)
class Stage:
    """What one stage took: wall time in s and the largest resident memory of all its processes together in MiB."""

    name: str
    wall_s: float
    peak_memory_mib: float


@dataclass
class StageClock:
    """Collects the stages of a job.

    >>> clock = StageClock()
    >>> with clock.stage("nothing"):
    ...     pass
    >>> [stage.name for stage in clock.stages]
    ['nothing']
    """

    stages: list[Stage] = field(default_factory=list)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what happens inside, and sample the memory of this process and its children meanwhile."""
        sampler = MemorySampler()
        started = time.perf_counter()
        try:
            with sampler:
                yield
        finally:
            self.stages.append(Stage(name, time.perf_counter() - started, sampler.peak_bytes / MIB))


class MemorySampler:
    """Samples the resident memory of this process and all its children until it is left.

    `peak_bytes` is the most that all had together, `peak_child_bytes` the most that one child had, `own_s` the
    processor time that the sampling itself took.
    """

    def __init__(self) -> None:
        self.peak_bytes = 0
        self.peak_child_bytes = 0
        self.own_s = 0.0
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._sample, daemon=True)

    def __enter__(self) -> "MemorySampler":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()

    def _sample(self) -> None:
        import psutil

        process = psutil.Process()
        while True:
            total = 0
            for member in [process, *process.children(recursive=True)]:
                try:
                    resident = member.memory_info().rss
                except psutil.NoSuchProcess:
                    continue
                total += resident
                if member is not process:
                    self.peak_child_bytes = max(self.peak_child_bytes, resident)
            self.peak_bytes = max(self.peak_bytes, total)
            self.own_s = time.thread_time()
            if self._done.wait(SAMPLING_PERIOD_S):
                return
