"""The tasks of a plan, each after what it needs."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from gelgap.domains.generation.plan import FrameBatch, GenerationPlan, PoseSource
from gelgap.domains.generation.shard import Shard, paper_picture, render_batch
from gelgap.sim.plan import Solve

RETRIES_AFTER_WORKER_DEATH = 5
"""A worker that dies takes its task with it; the task is tried this many times again before it gets the blame."""


@dataclass(frozen=True, eq=False)
class Task:
    """A solve, a library of poses, or frames; `make` makes it from what the tasks that it `needs` made, by key."""

    kind: Literal["solve", "library", "frames"]
    key: str
    needs: tuple[str, ...]
    make: Callable[[dict[str, Any]], Any]


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
