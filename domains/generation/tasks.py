"""The tasks of a plan, each after what it needs, and where they run: in this process, in others, on a cluster."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import Any, Literal

from gelgap.assets.progress import Progress
from gelgap.assets.workers import Workers
from gelgap.domains.generation.plan import FrameBatch, GenerationPlan, PoseSource
from gelgap.domains.generation.scheduler import SYNCHRONOUS
from gelgap.domains.generation.shard import Shard, paper_picture, render_batch
from gelgap.sim.plan import Solve

RETRIES_AFTER_WORKER_DEATH = 5
"""A worker that dies takes its task with it; the task is tried this many times again before it gets the blame."""
# A process finds its next task waiting, while this one writes shards.
_TASKS_PER_PROCESS = 2


@dataclass(frozen=True, eq=False)
class Task:
    """A solve, a library of poses, or frames; `make` makes it from what the tasks that it `needs` made, by key."""

    kind: Literal["solve", "library", "frames"]
    key: str
    needs: tuple[str, ...]
    make: Callable[[dict[str, Any]], Any]


def run(
    plan: GenerationPlan, progress: Progress, scheduler: str | None, workers: int | None
) -> Iterator[Shard]:
    """Run a plan and yield the shards as they come.

    The scheduler is `synchronous` for this process, or the address of a Dask scheduler. Without one, `workers`
    processes are started on this machine, by default one per core.

    Raises
    ------
    RuntimeError
        If workers keep dying on one task, or a cluster is lost.
    """
    tasks = tasks_of(plan)
    if scheduler == SYNCHRONOUS or not tasks:
        finished = _finished_here(tasks)
    elif scheduler is None:
        finished = _finished_by_processes(tasks, plan.processes(workers))
    else:
        from gelgap.domains.generation.dask_cluster import finished_by_cluster

        finished = finished_by_cluster(tasks, scheduler)
    solved = count(1)
    for task, made in finished:
        if task.kind == "solve":
            progress("solves", next(solved), len(plan.solves))
        elif task.kind == "frames":
            yield from made


def tasks_of(plan: GenerationPlan) -> list[Task]:
    """Return the tasks of a plan: each batch of frames follows the solves and the library that it needs first."""
    tasks: dict[str, Task] = {}
    for batch in plan.batches:
        for key in batch.solve_keys:
            source = plan.sources[key]
            for solve in source.solves:
                tasks.setdefault(solve.key, Task("solve", solve.key, (), partial(_solution, solve)))
            needs = tuple(solve.key for solve in source.solves)
            tasks.setdefault(key, Task("library", key, needs, partial(_library, source)))
        tasks[batch.key] = Task("frames", batch.key, batch.solve_keys, partial(_shards, batch))
    return list(tasks.values())


def _solution(solve: Solve, made: dict[str, Any]) -> Any:
    return solve.run()


def _library(source: PoseSource, made: dict[str, Any]) -> Any:
    return source.served_by(made, paper_picture)


def _shards(batch: FrameBatch, made: dict[str, Any]) -> list[Shard]:
    return render_batch(batch, made)


class _Made:
    """What tasks have made, as long as a task needs it that is not finished."""

    def __init__(self, tasks: Sequence[Task]) -> None:
        self._by_key: dict[str, Any] = {}
        self._users = Counter(need for task in tasks for need in task.needs)

    def add(self, task: Task, made: Any) -> None:
        """Keep what a finished task has made, and drop what it was the last to need."""
        if self._users[task.key]:
            self._by_key[task.key] = made
        for need in task.needs:
            self._users[need] -= 1
            if not self._users[need]:
                del self._by_key[need]

    def serves(self, task: Task) -> bool:
        return all(need in self._by_key for need in task.needs)

    def needed_by(self, task: Task) -> dict[str, Any]:
        return {need: self._by_key[need] for need in task.needs}


def _finished_here(tasks: Sequence[Task]) -> Iterator[tuple[Task, Any]]:
    """Yield each task and what it makes, one after the other in this process."""
    made = _Made(tasks)
    for task in tasks:
        result = task.make(made.needed_by(task))
        made.add(task, result)
        yield task, result


def _finished_by_processes(tasks: Sequence[Task], processes: int) -> Iterator[tuple[Task, Any]]:
    """Yield each task and what it made as processes of this machine finish it; of those that can begin, the first does.

    A dead worker takes the pool with it: another one begins with what was not finished.
    """
    made = _Made(tasks)
    unfinished = list(tasks)
    deaths = Counter[str]()
    while unfinished:
        running: dict[Future[Any], Task] = {}
        try:
            with Workers(processes) as workers:
                while unfinished:
                    begun = set(running.values())
                    ready = [task for task in unfinished if task not in begun and made.serves(task)]
                    for task in ready[: _TASKS_PER_PROCESS * processes - len(running)]:
                        running[workers.submit(make_in_worker, task, made.needed_by(task))] = task
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        result = future.result()
                        task = running.pop(future)
                        unfinished.remove(task)
                        made.add(task, result)
                        yield task, result
        except BrokenProcessPool as error:
            deaths.update(task.key for task in running.values())
            if max(deaths.values()) > RETRIES_AFTER_WORKER_DEATH:
                raise workers_died() from error


def make_in_worker(task: Task, needed: dict[str, Any]) -> Any:
    """Make a task with one OpenCV thread: a worker process has one core."""
    import cv2

    cv2.setNumThreads(1)
    return task.make(needed)


def workers_died() -> RuntimeError:
    """Return the error that says what to do where a task outlives no worker."""
    return RuntimeError(
        f"workers died {RETRIES_AFTER_WORKER_DEATH + 1} times at one task; they may be short of memory: give them "
        "more or start fewer; what is written is safe: run the same command again to go on"
    )
