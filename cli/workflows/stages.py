"""Wall time and peak memory of each stage of a job, its worker processes included."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from gelgap.benchmarks.common.memory import MIB, MemorySampler


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
