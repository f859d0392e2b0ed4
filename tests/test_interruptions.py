"""Real commands that are stopped, and generation that is disturbed: running them again ends as if nothing had been."""

import contextlib
import json
import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
import psutil
import pytest
from network_weights import weights

from gelgap.adapt import ForceModel, load_predictions, load_runs
from gelgap.cli.main import main

DEADLINE_S = 300.0
# What Python itself prints while it starts and ends is not the command's.
CHILD = "from gelgap.cli.start import start; print('begun', flush=True); start(); print('done', flush=True)"
PATH = """points_x_mm = [-1.5, -0.5, 0.5, 1.5]
points_y_mm = [-1.0, 1.0]
depths_mm = [0.15]
radii_mm = [0.1]
angles_deg = [{}]
""".format(", ".join(f"{10.0 * k}" for k in range(36)))
PROFILE = """base = "smoke"
width = 0.125
image_size_px = [64, 48]
source_epochs = 3
adapt_epochs = 3
"""


def files_of(folder: Path) -> dict[str, Any]:
    """Return the bytes of every file of a data set."""
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.glob("*/*") if file.is_file()}


def runs_of(folder: Path) -> dict[str, Any]:
    """Return weights and predictions of every run, whose checksums are right."""
    return {
        run.folder.name: joblib.hash(
            (weights(ForceModel.load(run.folder / "model.pt")), load_predictions(run))
        )
        for run in load_runs(folder)
    }


def finished_shards(folder: Path) -> list[Path]:
    """Return the shards that manifests name."""
    manifests = {file.parent: json.loads(file.read_text()) for file in folder.glob("*/manifest.json")}
    return [domain / name for domain, manifest in manifests.items() for name in manifest["files"]]


def finished_runs(folder: Path) -> list[Path]:
    """Return the records of finished runs."""
    return list(folder.glob("*/run.json"))


@dataclass(frozen=True)
class Command:
    """A command with its arguments but `--out`, the files that it has finished, and all that it leaves."""

    words: str
    finished: Callable[[Path], list[Path]]
    content: Callable[[Path], dict[str, Any]]

    def arguments(self, inputs: Path, folder: Path) -> list[str]:
        return [*self.words.format(inputs=inputs).split(), "--out", str(folder)]


GENERATE = "generate mb0i0 --path {inputs}/path.toml --quality draft --size 64 48"
COMMANDS = {
    "generate": Command(f"{GENERATE} --workers synchronous", finished_shards, files_of),
    "adapt": Command(
        "adapt --source {inputs}/pictures --target {inputs}/published --method source-only dan"
        " --profile {inputs}/profile.toml",
        finished_runs,
        runs_of,
    ),
}
BY_WORKERS = Command(f"{GENERATE} --workers 2", finished_shards, files_of)


def run_here(command: Command, inputs: Path, folder: Path) -> None:
    """Run a command to its end in this process."""
    main(command.arguments(inputs, folder))


@dataclass(frozen=True)
class Child:
    """A command in a process and a session of its own; it heeds Ctrl-C, which background jobs ignore."""

    process: subprocess.Popen

    @classmethod
    def begin(cls, command: Command, inputs: Path, folder: Path, prepare: Callable = lambda: None) -> "Child":
        """Start a command, and wait until Python has loaded its first line."""

        def before_it() -> None:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            prepare()

        given = command.arguments(inputs, folder)
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        child = cls(
            subprocess.Popen(
                [sys.executable, "-c", CHILD, *given], start_new_session=True, preexec_fn=before_it, **streams
            )
        )
        assert child.process.stdout.readline() == "begun\n"
        return child

    def wait_for(self, begun: Callable[[], Any]) -> None:
        """Wait until something is so, or the command has ended."""
        while self.process.poll() is None and not begun():
            time.sleep(0.01)

    def end(self) -> tuple[int, str, str]:
        """Wait for the end; return the exit code and what was said. Nothing that was started may outlive it."""
        out, err = self.process.communicate(timeout=DEADLINE_S)
        deadline = time.monotonic() + 60
        while left := list(filter(self.started, psutil.process_iter())):
            assert time.monotonic() < deadline, left
            time.sleep(0.05)
        return self.process.returncode, out, err

    def started(self, process: psutil.Process) -> bool:
        """Return whether a process that still runs is of the command's session."""
        with contextlib.suppress(ProcessLookupError, psutil.NoSuchProcess):
            zombie = process.status() == psutil.STATUS_ZOMBIE
            return os.getsid(process.pid) == self.process.pid and not zombie
        return False


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory, valid_files: Path) -> Iterator[Path]:
    """The inputs of all commands; what they solve is kept, so that most stops come while frames are made."""
    folder = tmp_path_factory.mktemp("inputs")
    for name in ("pictures", "published"):
        shutil.copytree(valid_files / name, folder / name)
    (folder / "path.toml").write_text(PATH)
    (folder / "profile.toml").write_text(PROFILE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GELGAP_CACHE", str(folder / "cache"))
        yield folder


@pytest.fixture(scope="module")
def undisturbed(inputs: Path) -> Callable[[str], tuple[dict[str, Any], float]]:
    """What a command leaves if it is not stopped, and how long it takes, s."""
    known = {}

    def run(name: str) -> tuple[dict[str, Any], float]:
        if name not in known:
            folder, start = inputs / "undisturbed" / name, time.monotonic()
            run_here(COMMANDS[name], inputs, folder)
            known[name] = COMMANDS[name].content(folder), time.monotonic() - start
        return known[name]

    return run


def finish(name: str, inputs: Path, folder: Path, expected: dict[str, Any]) -> None:
    """Run a command again: what was finished stays, and the outcome is that of an undisturbed run."""
    command = COMMANDS[name]
    finished = {file: file.stat().st_mtime_ns for file in command.finished(folder)}
    run_here(command, inputs, folder)
    assert {file: file.stat().st_mtime_ns for file in finished} == finished
    assert command.content(folder) == expected


def check_end(stopped_by: signal.Signals, code: int, out: str, err: str) -> None:
    """A command that was interrupted at work ends with one sentence; it may have been done by then."""
    if "done" not in out:
        assert code == (130 if stopped_by == signal.SIGINT else -signal.SIGKILL), err
        assert err.count("gelgap: interrupted") == (stopped_by == signal.SIGINT), err
    if stopped_by == signal.SIGINT:
        assert "Traceback" not in err


@pytest.mark.parametrize(
    ("name", "begun"),
    [
        ("generate", finished_shards),
        pytest.param("adapt", lambda folder: list(folder.rglob("*.pt")), marks=pytest.mark.slow),
    ],
)
def test_a_stopped_command_goes_on_where_it_was(
    name: str, begun: Callable, inputs: Path, tmp_path: Path, undisturbed: Callable
) -> None:
    expected, _ = undisturbed(name)
    child = Child.begin(COMMANDS[name], inputs, tmp_path)
    child.wait_for(lambda: begun(tmp_path))
    os.kill(child.process.pid, signal.SIGINT)
    code, out, err = child.end()
    assert "done" not in out
    check_end(signal.SIGINT, code, out, err)
    finish(name, inputs, tmp_path, expected)


def test_a_killed_command_takes_its_workers_along_and_goes_on(
    inputs: Path, tmp_path: Path, undisturbed: Callable
) -> None:
    expected, _ = undisturbed("generate")
    child = Child.begin(BY_WORKERS, inputs, tmp_path)
    child.wait_for(lambda: finished_shards(tmp_path))
    child.process.kill()
    code, out, _ = child.end()
    assert (code, "done" in out) == (-signal.SIGKILL, False)
    finish("generate", inputs, tmp_path, expected)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.02, 0.5, 0.98])
@pytest.mark.parametrize("stopped_by", [signal.SIGINT, signal.SIGKILL])
@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_may_be_stopped_at_any_moment(
    name: str, stopped_by: signal.Signals, share: float, inputs: Path, tmp_path: Path, undisturbed: Callable
) -> None:
    expected, duration_s = undisturbed(name)
    child = Child.begin(COMMANDS[name], inputs, tmp_path)
    time.sleep(share * duration_s)
    if child.process.poll() is None:
        os.kill(child.process.pid, stopped_by)
    check_end(stopped_by, *child.end())
    finish(name, inputs, tmp_path, expected)


@pytest.mark.slow
def test_generation_survives_the_end_of_a_worker(inputs: Path, tmp_path: Path, undisturbed: Callable) -> None:
    expected, _ = undisturbed("generate")
    child = Child.begin(BY_WORKERS, inputs, tmp_path)
    child.wait_for(lambda: list(tmp_path.glob("*/frames-*.parquet")))
    family = psutil.Process(child.process.pid).children(recursive=True)
    worker = next(process for process in family if "spawn_main" in " ".join(process.cmdline()))
    worker.kill()
    code, out, err = child.end()
    assert (code, "done" in out) == (0, True), err
    assert files_of(tmp_path) == expected


def test_a_refused_write_loses_nothing_and_says_so(
    inputs: Path, tmp_path: Path, undisturbed: Callable
) -> None:
    expected, _ = undisturbed("generate")
    limit = min(len(data) for name, data in expected.items() if name.endswith(".parquet")) // 2

    def limit_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    code, _, err = Child.begin(COMMANDS["generate"], inputs, tmp_path, limit_files).end()
    assert code == 1
    assert "run the same command again" in err.splitlines()[-1]
    assert "Traceback" not in err
    finish("generate", inputs, tmp_path, expected)


@pytest.mark.slow
def test_generation_whose_scheduler_ends_stops_with_a_sentence(
    inputs: Path, tmp_path: Path, undisturbed: Callable
) -> None:
    expected, _ = undisturbed("generate")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    ends = ["scheduler", "--host", "127.0.0.1", "--port", str(port)], ["worker", address, "--nthreads", "1"]
    scheduler, worker = (
        subprocess.Popen([sys.executable, "-m", "dask", *words, "--no-dashboard"], **quiet) for words in ends
    )
    try:
        command = Command(f"{GENERATE} --workers {address}", finished_shards, files_of)
        child = Child.begin(command, inputs, tmp_path)
        child.wait_for(lambda: finished_shards(tmp_path))
        scheduler.kill()
        code, _, err = child.end()
    finally:
        for process in (worker, scheduler):
            process.kill()
            process.wait()
    assert code == 1
    assert "Traceback" not in err
    finish("generate", inputs, tmp_path, expected)
