"""A cluster of separately started processes on loopback, as on any machine where Dask runs."""

import json
import socket
import subprocess
import sys
from pathlib import Path

import pytest


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


def test_an_address_without_dask_says_how_to_install_it(
    make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("gelgap.assets.extras.find_spec", lambda name: None)
    with pytest.raises(
        ValueError, match=r"needs the packages dask and distributed; .*pip install 'gelgap\[cluster\]'"
    ):
        make(tmp_path, scheduler="tcp://127.0.0.1:9")
    assert not list(tmp_path.iterdir())


def test_a_domain_is_finished_although_the_connection_does_not_close_in_time(
    scheduler: str, make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    """A busy machine answers late; every frame is there by then."""
    from distributed import Client

    close = Client.close

    def late(client: Client, *arguments: object) -> None:
        if client.status != "closed":
            close(client, *arguments)
            raise TimeoutError

    monkeypatch.setattr(Client, "close", late)
    make(tmp_path, ("mb1i2",), scheduler=scheduler)
    assert json.loads((tmp_path / "mb1i2" / "manifest.json").read_text())["complete"]
    assert "did not close in time" in caplog.text
