"""A cluster of separately started processes on loopback, as on any machine where Dask runs."""

import json
import signal
import socket
import subprocess
import sys
import weakref
from pathlib import Path
from types import SimpleNamespace

import pytest

from gelgap.assets.progress import hidden_progress
from gelgap.domains.generation.cluster import dask_client, run


@pytest.fixture(scope="module")
def scheduler():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    dask = [sys.executable, "-m", "dask"]
    port = address.rsplit(":", 1)[1]
    processes = [
        subprocess.Popen(
            [*dask, "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"], **quiet
        ),
        subprocess.Popen(
            [*dask, "worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny"], **quiet
        ),
    ]
    try:
        yield address
    finally:
        # The worker first, and to its end: a graceful worker waits long for a scheduler that is gone.
        for process in reversed(processes):
            process.terminate()
            process.wait(timeout=30)


def loaded_modules() -> list[str]:
    return sorted({"torch", "colour", "gelgap.render.renderer"} & set(sys.modules))


def test_a_cluster_at_an_address_makes_the_same_bytes_lightly(
    scheduler: str, make, data: Path, tmp_path: Path
):
    from distributed import Client

    with Client(scheduler, timeout="30s", set_as_default=False) as client:
        client.wait_for_workers(1, timeout=60)
        make(tmp_path, ("mb0i1",), scheduler=scheduler)
        (modules,) = client.run(loaded_modules).values()
    for name in ("frames-00000.parquet", "reference.png", "manifest.json"):
        assert (tmp_path / "mb0i1" / name).read_bytes() == (data / "mb0i1" / name).read_bytes()
    assert modules == ["gelgap.render.renderer"]


def test_the_number_of_workers_is_the_clusters_own(scheduler: str, make, tmp_path: Path):
    with pytest.raises(ValueError, match="has its own; leave workers out"):
        make(tmp_path, scheduler=scheduler, workers=3)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "127.0.0.1:99999"])
def test_a_scheduler_that_does_not_answer_is_known_before_anything_is_written(address, make, tmp_path: Path):
    with pytest.raises(RuntimeError, match=f"no Dask scheduler answers at {address} .*dask scheduler"):
        make(tmp_path, scheduler=address)
    assert not list(tmp_path.iterdir())


def test_ctrl_c_waits_until_a_local_cluster_can_be_closed(monkeypatch: pytest.MonkeyPatch):
    events = []

    class Cluster:
        def __init__(self, **_: object) -> None:
            signal.raise_signal(signal.SIGINT)
            events.append("started")

        def close(self) -> None:
            events.append("closed")

    monkeypatch.setattr("distributed.LocalCluster", Cluster)
    monkeypatch.setattr("distributed.Client", lambda *_, **__: SimpleNamespace(close=lambda: None))
    with pytest.raises(KeyboardInterrupt), dask_client(None, 1):
        events.append("used")
    assert events == ["started", "closed"]


def test_a_domain_is_finished_although_the_cluster_does_not_close_in_time(
    make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    """A busy machine answers late; every frame is there by then."""
    from distributed import Client, LocalCluster

    def in_this_process(**options: object) -> LocalCluster:
        return LocalCluster(**options | {"processes": False})

    close = Client.close

    def late(client: Client, *arguments: object) -> None:
        if client.status != "closed":
            close(client, *arguments)
            raise TimeoutError

    monkeypatch.setattr("distributed.LocalCluster", in_this_process)
    monkeypatch.setattr(Client, "close", late)
    make(tmp_path, ("mb1i2",), scheduler=None, workers=1)
    assert json.loads((tmp_path / "mb1i2" / "manifest.json").read_text())["complete"]
    assert "did not close in time" in caplog.text


def test_a_local_cluster_that_does_not_start_says_that_nothing_is_lost(monkeypatch: pytest.MonkeyPatch):
    def late(**_: object) -> None:
        raise TimeoutError

    monkeypatch.setattr("distributed.LocalCluster", late)
    told = r"TimeoutError.*what is written is safe: run the same command"
    with pytest.raises(RuntimeError, match=told), dask_client(None, 1):
        pass


def test_a_solution_is_dropped_after_the_last_batch_that_needs_it(monkeypatch: pytest.MonkeyPatch):
    class Solution:
        pass

    def solve() -> Solution:
        alive.add(solution := Solution())
        return solution

    alive = weakref.WeakSet()
    batches = [SimpleNamespace(solve_keys=keys) for keys in ("ab", "b", "c")]
    sources = {
        key: SimpleNamespace(
            solves=[SimpleNamespace(key=key, run=solve)],
            served_by=lambda solutions, _, key=key: solutions[key],
        )
        for key in "abc"
    }
    plan = SimpleNamespace(batches=batches, solves="abc", sources=sources)
    monkeypatch.setattr("gelgap.domains.generation.cluster.render_batch", lambda *_: [len(alive)])
    assert list(run(plan, hidden_progress, "synchronous", None)) == [2, 1, 1]


def test_no_worker_is_started_that_has_nothing_to_do(make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    asked = []

    def no_client(scheduler: str | None, workers: int | None):
        asked.append(workers)
        raise RuntimeError("no cluster")

    monkeypatch.setattr(sys.modules["gelgap.domains.generation.cluster"], "dask_client", no_client)
    with pytest.raises(RuntimeError, match="no cluster"):
        make(tmp_path, ("mb1i2",), scheduler=None, workers=64)
    assert 1 <= asked[0] < 64
