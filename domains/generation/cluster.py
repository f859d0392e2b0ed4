"""Where the tasks of a plan run: in this process, on a local Dask cluster, or on one at an address."""

import contextlib
import logging
import os
import re
import socket
from collections.abc import Iterator
from itertools import count
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from gelgap.assets.locks import defer_signals
from gelgap.assets.names import quoted
from gelgap.assets.progress import Progress
from gelgap.domains.generation.plan import FrameBatch, GenerationPlan, PoseSource
from gelgap.domains.generation.shard import Shard, paper_picture, render_batch

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

LOG = logging.getLogger(__name__)
SYNCHRONOUS = "synchronous"
"""Scheduler name for running in this process: no cluster is started."""

# A worker that dies takes its task with it; the task is tried this many times again before it gets the blame.
_RETRIES_AFTER_WORKER_DEATH = 5
CONNECTION_TIMEOUT_S = 20
ANSWER_TIMEOUT_S = 5
# On a machine with far more to do than cores, processes of one's own take a while to answer.
LOCAL_TIMEOUT_S = 120
_ADDRESS = re.compile(r"((tcp|tls|ucx|wss?)://)?[^\s/]+:\d{1,5}/?|inproc://\S+")


def check_scheduler(scheduler: str | None, workers: int | None = None) -> None:
    """Raise ValueError for what is neither None (a local cluster), `synchronous` nor an address with a port.

    A number of workers is that of the local cluster.
    """
    if workers is not None and workers < 1:
        raise ValueError(f"workers = {workers}: must be 1 or more")
    if scheduler not in (None, SYNCHRONOUS) and not _ADDRESS.fullmatch(scheduler):
        raise ValueError(
            f"scheduler {quoted(scheduler)} must be {SYNCHRONOUS} (this process) or the address of a Dask scheduler "
            "such as tcp://host:8786"
        )
    if scheduler not in (None, SYNCHRONOUS) and workers is not None:
        raise ValueError(f"workers = {workers}: the cluster at {scheduler} has its own; leave workers out")


def check_answers(scheduler: str | None) -> None:
    """Raise RuntimeError if nothing listens at a scheduler's address; Dask itself would try for half a minute."""
    if scheduler in (None, SYNCHRONOUS):
        return
    kind, _, place = scheduler.rpartition("://")
    address = urlsplit(f"//{place}")
    if kind in ("", "tcp", "tls"):
        try:
            socket.create_connection((address.hostname, address.port), timeout=ANSWER_TIMEOUT_S).close()
        except (OSError, ValueError) as error:
            raise _no_answer(scheduler, error) from error


def _no_answer(scheduler: str, error: Exception) -> RuntimeError:
    return RuntimeError(
        f"no Dask scheduler answers at {scheduler} ({error}); start one with `dask scheduler` "
        "and workers with `dask worker ADDRESS --nthreads 1`"
    )


def run(
    plan: GenerationPlan, progress: Progress, scheduler: str | None, workers: int | None
) -> Iterator[Shard]:
    """Run a plan and yield the shards as they come; see `dask_client` for scheduler and workers.

    A RuntimeError if the cluster is lost, or workers keep dying on one task.
    """
    if not plan.batches:
        return
    if scheduler == SYNCHRONOUS:
        yield from _run_in_process(plan, progress)
        return
    if scheduler is None:
        workers = plan.processes(workers)
    with dask_client(scheduler, workers) as client:
        yield from _run_on_cluster(plan, progress, client)


def _run_in_process(plan: GenerationPlan, progress: Progress) -> Iterator[Shard]:
    """Run a plan batch by batch; what was solved is dropped after the last batch that needs it."""
    last = {key: batch for batch in plan.batches for key in batch.solve_keys}
    made: dict[str, Any] = {}
    solved = count(1)

    def make(source: PoseSource) -> Any:
        solutions = {}
        for solve in source.solves:
            solutions[solve.key] = solve.run()
            progress("solves", next(solved), len(plan.solves))
        return source.served_by(solutions, paper_picture)

    for batch in plan.batches:
        made |= {key: make(plan.sources[key]) for key in batch.solve_keys if key not in made}
        yield from render_batch(batch, {key: made[key] for key in batch.solve_keys})
        made = {key: solution for key, solution in made.items() if last[key] is not batch}


def _run_on_cluster(plan: GenerationPlan, progress: Progress, client: "Client") -> Iterator[Shard]:
    """Run a plan on a Dask cluster; keys are content, so no work is done twice."""
    from distributed import as_completed
    from distributed.client import FutureCancelledError
    from distributed.scheduler import KilledWorker

    try:
        made = {key: client.submit(solve.run, key=f"solve-{key}") for key, solve in plan.solves.items()}
        solves = {future.key for future in made.values()}
        waiting = as_completed(made.values(), loop=client.loop)
        for key, source in plan.sources.items():
            if key not in made:
                of_source = {solve.key: made[solve.key] for solve in source.solves}
                made[key] = client.submit(source.served_by, of_source, paper_picture, key=key)
        for batch in plan.batches:
            needed = {key: made[key] for key in batch.solve_keys}
            waiting.add(client.submit(_render_in_worker, batch, needed, key=f"frames-{batch.key}"))
        # Only batches are results: a solution stays where it was made, until no batch needs it.
        del made, needed
        solved = count(1)
        for future in waiting:
            if future.key in solves:
                if future.status == "error":
                    future.result()
                progress("solves", next(solved), len(solves))
            else:
                shards = future.result()
                future.release()
                yield from shards
            del future
    except KilledWorker as error:
        raise RuntimeError(
            f"workers died {_RETRIES_AFTER_WORKER_DEATH + 1} times at the task {error.task}; "
            "they may be short of memory: give them more or start fewer"
        ) from error
    except (FutureCancelledError, OSError, TimeoutError) as error:
        raise RuntimeError(
            f"lost the Dask scheduler ({type(error).__name__}); "
            "what is written is safe: run the same command again to finish"
        ) from error


def _render_in_worker(batch: FrameBatch, solutions: dict[str, Any]) -> list[Shard]:
    """Render a batch with one OpenCV thread: a worker process has one core."""
    import cv2

    cv2.setNumThreads(1)
    return render_batch(batch, solutions)


@contextlib.contextmanager
def dask_client(scheduler: str | None, workers: int | None) -> Iterator["Client"]:
    """Yield a client of the cluster at an address, or of a local one with one process per core, one thread each.

    Raises
    ------
    RuntimeError
        If nothing answers at the address, or a local cluster does not start in time.
    """
    import dask
    from distributed import Client, LocalCluster

    # Dask reports every lost connection in many lines; what matters is raised as one error.
    for name in tuple(logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "tornado"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=CONNECTION_TIMEOUT_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise _no_answer(scheduler, error) from error
        try:
            yield client
        finally:
            _close(client)
        return
    settings = {
        "distributed.scheduler.allowed-failures": _RETRIES_AFTER_WORKER_DEATH,
        "distributed.comm.timeouts.connect": LOCAL_TIMEOUT_S,
        # Dask watches itself for a dashboard: a client and a worker then take 3.0 and 2.6 % of a core, not 1.4 and 0.9.
        "distributed.worker.profile.enabled": False,
        "distributed.admin.tick.interval": "1s",
    }
    with contextlib.ExitStack() as entered:
        entered.enter_context(dask.config.set(settings))
        # Half a cluster cannot be closed.
        with defer_signals():
            try:
                cluster = LocalCluster(
                    n_workers=workers or len(os.sched_getaffinity(0)),
                    threads_per_worker=1,
                    dashboard_address="127.0.0.1:0",
                    silence_logs=logging.CRITICAL,
                )
                entered.callback(_close, cluster)
                client = Client(cluster, timeout=LOCAL_TIMEOUT_S, set_as_default=False)
            except (OSError, TimeoutError) as error:
                raise RuntimeError(
                    f"no local workers could be started ({str(error) or type(error).__name__}), as on a very busy "
                    "machine; what is written is safe: run the same command again, or with fewer --workers"
                ) from error
            entered.callback(_close, client)
        yield client


def _close(opened: "Client | LocalCluster") -> None:
    """Close a client or a cluster; a busy machine may take longer than Dask waits, and all results are here by then."""
    try:
        opened.close()
    except TimeoutError:
        LOG.warning("a Dask %s did not close in time; its processes end with this one", type(opened).__name__)
