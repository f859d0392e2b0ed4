"""Solve scenes in fresh processes, each measured whole: wall time, processor time and peak memory."""

import multiprocessing
import os
import resource
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from gelgap.sim import Elastomer, MembraneState, Pose, Sharing, Sphere

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Job:
    """Poses that the indenter visits one after the other at one point; the disk cache is off by default."""

    name: str
    elastomer: Elastomer
    poses: tuple[Pose, ...]
    quality: str = "standard"
    indenter: Sphere = field(default_factory=Sphere)
    sharing: Sharing = field(default_factory=lambda: Sharing(cache=False))


@dataclass(frozen=True)
class Outcome:
    """A job's states, and what its process took: wall and processor s (imports included), peak MiB."""

    job: Job
    states: tuple[MembraneState, ...]
    wall_s: float
    processor_s: float
    peak_memory_mib: float

    @property
    def unconverged(self) -> int:
        return sum(not state.converged for state in self.states)


def solve_jobs(jobs: Sequence[Job], processes: int = 1) -> Iterator[Outcome]:
    """Solve each job in a single-threaded process of its own, and yield outcomes in the jobs' order."""
    spawn = multiprocessing.get_context("spawn")
    with (
        single_threaded(),
        ProcessPoolExecutor(max_workers=processes, mp_context=spawn, max_tasks_per_child=1) as pool,
    ):
        yield from pool.map(_solve, jobs)


def single_threaded() -> AbstractContextManager[None]:
    """While entered, processes that are started run one thread each."""
    return _environment(dict.fromkeys(ONE_THREAD, "1"))


def own_cache(folder: Path) -> AbstractContextManager[None]:
    """While entered, what is solved here and in processes that are started is kept in `folder`."""
    return _environment({"GELGAP_CACHE": str(folder)})


@contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _solve(job: Job) -> Outcome:
    started = time.perf_counter()
    from gelgap.sim import solve_poses

    states = solve_poses(job.elastomer, job.indenter, job.poses, job.quality, job.sharing)
    return Outcome(
        job=job,
        states=states,
        wall_s=time.perf_counter() - started,
        processor_s=time.process_time(),
        peak_memory_mib=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    )
