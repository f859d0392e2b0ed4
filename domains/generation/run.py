"""Where the tasks of a plan run: in this process, in others of this machine, or on a cluster."""

from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from itertools import count
from typing import Any

from gelgap.assets.progress import Progress
from gelgap.assets.workers import Workers
from gelgap.domains.generation.dask_cluster import finished_by_cluster
from gelgap.domains.generation.plan import GenerationPlan
from gelgap.domains.generation.scheduler import SYNCHRONOUS
from gelgap.domains.generation.shard import Shard
from gelgap.domains.generation.tasks import (
    RETRIES_AFTER_WORKER_DEATH,
    Task,
    make_in_worker,
    tasks_of,
    workers_died,
)

# A process finds its next task waiting, while this one writes shards.
_TASKS_PER_PROCESS = 2


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
        finished = finished_by_cluster(tasks, scheduler)
    solved = count(1)
    for task, made in finished:
        if task.kind == "solve":
            progress("solves", next(solved), len(plan.solves))
        elif task.kind == "frames":
            yield from made


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
