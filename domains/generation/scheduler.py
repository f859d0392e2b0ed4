"""What may be said of where a plan runs: nothing, this process, or the address of a Dask scheduler."""

import re
import socket
from urllib.parse import urlsplit

from gelgap.assets.extras import need_extra
from gelgap.assets.names import quoted

SYNCHRONOUS = "synchronous"
"""Scheduler name for running in this process: no other is started."""
ANSWER_TIMEOUT_S = 5
_ADDRESS = re.compile(r"((tcp|tls|ucx|wss?)://)?[^\s/]+:\d{1,5}/?|inproc://\S+")


def check_scheduler(scheduler: str | None, workers: int | None = None) -> None:
    """Raise ValueError for what is neither None (processes of this machine), `synchronous` nor an address with a port.

    A number of workers is that of the processes of this machine. An address needs Dask, which is an extra.
    """
    if workers is not None and workers < 1:
        raise ValueError(f"workers = {workers}: must be 1 or more")
    if scheduler in (None, SYNCHRONOUS):
        return
    if not _ADDRESS.fullmatch(scheduler):
        raise ValueError(
            f"scheduler {quoted(scheduler)} must be {SYNCHRONOUS} (this process) or the address of a Dask scheduler "
            "such as tcp://host:8786"
        )
    if workers is not None:
        raise ValueError(f"workers = {workers}: the cluster at {scheduler} has its own; leave workers out")
    need_extra(f"a scheduler at {scheduler}", "cluster", "dask", "distributed")


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
            raise no_answer(scheduler, error) from error


def no_answer(scheduler: str, error: Exception) -> RuntimeError:
    """Return the error that says how a cluster is started."""
    return RuntimeError(
        f"no Dask scheduler answers at {scheduler} ({error}); start one with `dask scheduler` "
        "and workers with `dask worker ADDRESS --nthreads 1`"
    )
