"""The tasks of a plan on a Dask cluster at an address, as of SLURM or Kubernetes; needs the extra `cluster`."""

import logging
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from gelgap.domains.generation.scheduler import no_answer
from gelgap.domains.generation.tasks import Task, make_in_worker, workers_died

if TYPE_CHECKING:
    from distributed import Client

LOG = logging.getLogger(__name__)
CONNECTION_TIMEOUT_S = 20


def finished_by_cluster(tasks: Sequence[Task], scheduler: str) -> Iterator[tuple[Task, Any]]:
    """Yield solves and frames as a cluster finishes them, of frames also what was made.

    Raises
    ------
    RuntimeError
        If nothing answers at the address, the cluster is lost, or workers keep dying on one task.
    """
    from distributed.client import FutureCancelledError
    from distributed.scheduler import KilledWorker

    client = _client_of(scheduler)
    try:
        yield from _finished(tasks, client)
    except KilledWorker as error:
        raise workers_died() from error
    except (FutureCancelledError, OSError, TimeoutError) as error:
        raise RuntimeError(
            f"lost the Dask scheduler ({type(error).__name__}); "
            "what is written is safe: run the same command again to finish"
        ) from error
    finally:
        try:
            client.close()
        except TimeoutError:
            # All results are here by then.
            LOG.warning("the connection to %s did not close in time; it ends with this process", scheduler)


def _client_of(scheduler: str) -> "Client":
    from distributed import Client

    # Dask reports every lost connection in many lines; what matters is raised as one error.
    for name in tuple(logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "tornado"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        return Client(scheduler, timeout=CONNECTION_TIMEOUT_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise no_answer(scheduler, error) from error


def _finished(tasks: Sequence[Task], client: "Client") -> Iterator[tuple[Task, Any]]:
    """Submit all tasks; keys are content, so no work is done twice."""
    from distributed import as_completed

    by_key = {f"{task.kind}-{task.key}": task for task in tasks}
    made: dict[str, Any] = {}
    for key, task in by_key.items():
        made[task.key] = client.submit(
            make_in_worker, task, {need: made[need] for need in task.needs}, key=key
        )
    waiting = as_completed([made[task.key] for task in tasks if task.kind != "library"], loop=client.loop)
    # Only frames are results: a solution stays where it was made, until no frames need it.
    del made
    for future in waiting:
        task = by_key[future.key]
        if task.kind == "frames" or future.status == "error":
            result = future.result()
            future.release()
            yield task, result
        else:
            yield task, None
        del future
