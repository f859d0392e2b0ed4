"""Worker processes of this machine: one thread each, and none of them outlives who started it."""

import multiprocessing
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from types import TracebackType
from typing import Any, Self

from gelgap.assets.locks import defer_signals

ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "NUMBA")}


class Workers(ProcessPoolExecutor):
    """Processes whose libraries have one thread each, as a block: an error or Ctrl-C within it ends them at once.

    The standard library's pool would wait for all that it has begun, and its processes would outlive one that is
    killed. After `tasks_per_worker` tasks a fresh process takes the place of a worker.
    """

    def __init__(self, count: int, tasks_per_worker: int | None = None) -> None:
        spawning = multiprocessing.get_context("spawn")
        super().__init__(count, spawning, _end_with_parent, max_tasks_per_child=tasks_per_worker)
        self._threads = {name: os.environ.get(name) for name in ONE_THREAD}

    def __enter__(self) -> Self:
        os.environ.update(ONE_THREAD)
        return self

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """Begin a task; a process that is started for it does not heed Ctrl-C, which reaches a whole group."""
        with defer_signals():
            return super().submit(function, *arguments, **named)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, place: TracebackType | None
    ) -> None:
        for name, value in self._threads.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        processes = list((self._processes or {}).values()) if kind is not None else []
        self.shutdown(wait=kind is None, cancel_futures=True)
        for process in processes:
            process.kill()


def _end_with_parent() -> None:
    """End this process as soon as the one that started it has ended, however that was."""
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
