"""Cases of the benchmarks, solved in fresh processes that are measured whole; what is finished is kept on disk."""

import hashlib
import importlib.metadata
import inspect
import multiprocessing
import os
import resource
import shutil
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from gelgap import sim
from gelgap.assets.locks import defer_signals
from gelgap.assets.whole_file import write_whole
from gelgap.benchmarks import fem
from gelgap.benchmarks.common.kept_results import read_kept, result_bytes, result_from_bytes
from gelgap.sim import Elastomer, MembraneState, Pose, Sharing, Sphere

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Case:
    """Poses that the indenter visits one after the other at one point; the simulator's cache is off by default."""

    name: str
    elastomer: Elastomer
    poses: tuple[Pose, ...]
    quality: str = "standard"
    indenter: Sphere = field(default_factory=Sphere)
    sharing: Sharing = field(default_factory=lambda: Sharing(cache=False))


@dataclass(frozen=True)
class SolvedCase:
    """A case's states, and what its process took: wall and processor s (imports included), peak MiB."""

    case: Case
    states: tuple[MembraneState, ...]
    wall_s: float
    processor_s: float
    peak_memory_mib: float

    @property
    def wall_s_per_pose(self) -> float:
        return self.wall_s / len(self.states)

    @property
    def processor_s_per_pose(self) -> float:
        return self.processor_s / len(self.states)

    @property
    def unconverged(self) -> int:
        return sum(not state.converged for state in self.states)


@dataclass(frozen=True)
class Workers:
    """Fresh processes of one thread each, and the folder that keeps what they have finished.

    A benchmark that was stopped goes on from that folder, unless the code that it runs has changed.
    """

    processes: int
    folder: Path

    def solve(self, cases: Iterable[Case]) -> list[SolvedCase]:
        """Solve each case in a process of its own."""
        return self.map(solve_case, cases)

    def map(self, function: Callable[[Any], Any], arguments: Iterable[Any]) -> list[Any]:
        """Return function(argument) for each argument; arguments are told apart by their `repr`."""
        files = {argument: self._file(function, argument) for argument in arguments}
        spawn = multiprocessing.get_context("spawn")
        with (
            single_threaded(),
            ProcessPoolExecutor(
                self.processes, mp_context=spawn, max_tasks_per_child=1, initializer=end_with_parent
            ) as pool,
            _no_wait_when_stopped(pool),
        ):
            with defer_signals():
                pending = [
                    pool.submit(_keep, function, argument, file)
                    for argument, file in files.items()
                    if read_kept(file) is None
                ]
            for future in as_completed(pending):
                future.result()
        return [result_from_bytes(file.read_bytes()) for file in files.values()]

    def forget(self) -> None:
        """Delete what is kept, so that the next benchmark measures anew."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _file(self, function: Callable[[Any], Any], argument: Any) -> Path:
        question = f"{_code_digest(inspect.getfile(function))} {function.__qualname__} {argument!r}"
        return self.folder / f"{hashlib.sha256(question.encode()).hexdigest()[:32]}.result"


def _keep(function: Callable[[Any], Any], argument: Any, file: Path) -> None:
    """Write a result to its file, in the process that found it.

    Sent to the parent, one of megabytes that is cut off by the end of its sender would be waited for without end.
    """
    write_whole(file, result_bytes(function(argument)))


def end_with_parent() -> None:
    """End this process as soon as the one that started it has ended, however that was."""
    parent = multiprocessing.parent_process()

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


@contextmanager
def _no_wait_when_stopped(pool: ProcessPoolExecutor) -> Iterator[None]:
    """End a pool's processes when the block is left by an error or an interruption, instead of waiting for them."""
    try:
        yield
    except BaseException:
        processes = list((pool._processes or {}).values())
        pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.kill()
        raise


def solve_case(case: Case) -> SolvedCase:
    """Solve a case in this process, which is taken to be fresh."""
    started = time.perf_counter()
    solved = SolvedCase(
        case=case,
        states=sim.solve_poses(case.elastomer, case.indenter, case.poses, case.quality, case.sharing),
        wall_s=time.perf_counter() - started,
        processor_s=time.process_time(),
        peak_memory_mib=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    )
    print(f"  {case.name} {case.quality}: {solved.processor_s:.1f} s", flush=True)
    return solved


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


@cache
def _code_digest(source: str) -> str:
    """Return a digest of a source file, of the solvers, and of MuJoCo's version."""
    solvers = [file for room in (sim, fem) for file in sorted(Path(room.__file__).parent.rglob("*.py"))]
    code = b"".join(file.read_bytes() for file in (Path(source), *solvers))
    return f"{hashlib.sha256(code).hexdigest()} {importlib.metadata.version('mujoco')}"
