"""Faults during generation: what is lost, and whether the finished data set has the bytes of an undisturbed run."""

import hashlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from pathlib import Path

from gelgap.adapt import ResultTable
from gelgap.benchmarks.common.python_process import start_python
from gelgap.benchmarks.common.records import Ledger
from gelgap.benchmarks.common.tables import write_json

DOMAINS = ("mb0i0", "wmb0i0")
POINTS_X_MM, POINTS_Y_MM = (-3.0, -1.8, -0.6, 0.6, 1.8, 3.0), (-2.4, -1.2, 0.0, 1.2, 2.4)
DIRECTIONS, QUICK_DIRECTIONS = 18, 10
"""Drags per contact point: five shards per domain, and three in the quick form."""
DEADLINE_S = 300.0
DISK_SHARES = (0.3, 0.5, 0.8)
"""The size of the small disk over that of the data set: it is full early, midway and near the end."""


class ImpossibleHere(Exception):
    """This machine does not permit a fault, for lack of rights."""


@dataclass(frozen=True)
class FaultResult:
    """One fault: tries, in how many the run itself survived, and what a rerun of the same command left.

    No tries: this machine does not permit the fault.
    """

    fault: str
    tries: int
    survived: int
    shards_kept: int
    frames_lost: int
    files_different: int


COLUMNS = ("fault", "tries", "survived", "shards kept", "frames lost", "files different")


@dataclass(frozen=True)
class Trial:
    """One try of a fault: the folder to generate into, the undisturbed data set, drags per point, and its number."""

    folder: Path
    undisturbed: Path
    directions: int
    number: int = 0

    def start(self, scheduler: str = "", setup: str = "", folder: Path | None = None) -> subprocess.Popen:
        """Generate in another process, on a cluster of its own unless a scheduler is named."""
        code = (
            f"{setup}\nfrom gelgap.benchmarks.data.faults import generate_domains\n"
            f"generate_domains({str(folder or self.folder)!r}, {self.directions}, {scheduler!r})"
        )
        return start_python(code)

    def start_and_wait(self, scheduler: str = "") -> subprocess.Popen:
        """Start, and wait until the shards after which the fault strikes are there: later in a later try."""
        child, deadline = self.start(scheduler), time.monotonic() + DEADLINE_S
        while len(shards(self.folder)) < 2 + 4 * self.number:
            if child.poll() is not None or time.monotonic() > deadline:
                break
            time.sleep(0.02)
        return child


def generate_domains(folder: Path | str, directions: int, scheduler: str = "synchronous") -> None:
    """Generate the data set, or what is missing of it: one solve, and many frames."""
    from gelgap.domains import generate
    from gelgap.sim import ContactPath

    angles = tuple(360.0 / directions * k for k in range(directions))
    path = ContactPath("faults", POINTS_X_MM, POINTS_Y_MM, (0.2,), (0.1,), angles)
    generate(
        DOMAINS,
        path,
        folder,
        quality="draft",
        render_quality="draft",
        size_px=(80, 60),
        scheduler=scheduler or None,
        workers=None if scheduler else 2,
    )


def run(quick: bool, out_dir: Path) -> None:
    """Try every fault, finish the data set by running the same command again, compare; print the table.

    Writes `faults.json`. The quick form tries one fault of each kind once: a killed process, a refused write, two
    processes, a damaged file. What a stopped benchmark has measured is kept until the next one has ended.
    """
    from gelgap.domains import package_versions

    folder = out_dir / "faults"
    ledger = Ledger(folder / "unfinished.jsonl", [quick, package_versions()])
    directions, tries = (QUICK_DIRECTIONS, 1) if quick else (DIRECTIONS, 3)
    undisturbed = folder / "undisturbed"
    if not ledger.found:
        shutil.rmtree(undisturbed, ignore_errors=True)
    start = time.perf_counter()
    generate_domains(undisturbed, directions)
    print(f"undisturbed data set: complete after {time.perf_counter() - start:.1f} s", flush=True)
    results = []
    for fault, strike in FAULTS.items():
        if quick and fault not in QUICK_FAULTS:
            continue
        trials = [Trial(folder / "struck", undisturbed, directions, number) for number in range(tries)]
        result = ledger.once(fault, FaultResult, lambda f=fault, s=strike, t=trials: measure(f, s, t))
        print(f"{fault}: {result.survived} of {result.tries} survived", flush=True)
        results.append(result)
    ResultTable("Faults during generation", COLUMNS, [astuple(result) for result in results]).show()
    write_json(out_dir / "faults.json", results)
    ledger.close()


def measure(fault: str, strike: Callable[[Trial], bool], trials: list[Trial]) -> FaultResult:
    """Let a fault strike in every trial, finish the data set each time and count what differs."""
    survived = kept = lost = different = made = 0
    for trial in trials:
        shutil.rmtree(trial.folder, ignore_errors=True)
        try:
            survived += strike(trial)
        except ImpossibleHere as reason:
            print(f"{fault}: {reason}")
            break
        made += 1
        kept += sum(path.stat().st_size > 0 for path in shards(trial.folder))
        generate_domains(trial.folder, trial.directions)
        found, expected = hashes(trial.folder), hashes(trial.undisturbed)
        lost += frames(trial.undisturbed) - frames(trial.folder)
        different += sum(found.get(name) != expected.get(name) for name in found.keys() | expected.keys())
    return FaultResult(fault, made, survived, kept, lost, different)


def shards(folder: Path) -> list[Path]:
    """Return the shards of all domains below a folder."""
    return sorted(folder.glob("*/frames-*.parquet"))


def frames(folder: Path) -> int:
    """Return the number of frames below a folder."""
    import pyarrow.parquet as pq

    return sum(pq.read_metadata(path).num_rows for path in shards(folder))


def hashes(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every file of the domains below a folder."""
    files = [path for path in folder.glob("*/*") if path.is_file()]
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def _ends_well(child: subprocess.Popen) -> bool:
    try:
        child.communicate(timeout=DEADLINE_S)
    except subprocess.TimeoutExpired:
        os.killpg(child.pid, signal.SIGKILL)
        child.communicate()
    return child.returncode == 0


def _kill_worker(trial: Trial) -> bool:
    import psutil

    child = trial.start_and_wait()
    family = psutil.Process(child.pid).children(recursive=True)
    workers = [process.pid for process in family if "spawn_main" in " ".join(process.cmdline())]
    for worker in workers[:1]:
        os.kill(worker, signal.SIGKILL)
    return _ends_well(child)


def _kill_client(trial: Trial) -> bool:
    child = trial.start_and_wait()
    os.kill(child.pid, signal.SIGKILL)
    return _ends_well(child)


def _interrupt(trial: Trial) -> bool:
    child = trial.start_and_wait()
    os.killpg(child.pid, signal.SIGINT)
    return _ends_well(child)


def _kill_scheduler(trial: Trial) -> bool:
    with _separate_cluster() as (address, scheduler):
        child = trial.start_and_wait(address)
        scheduler.kill()
        return _ends_well(child)


@contextmanager
def _separate_cluster() -> Iterator[tuple[str, subprocess.Popen]]:
    """A scheduler and two workers as processes of their own, on loopback."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"

    def dask(*arguments: str) -> subprocess.Popen:
        command = [sys.executable, "-m", "dask", *arguments, "--no-dashboard"]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    scheduler = dask("scheduler", "--host", "127.0.0.1", "--port", str(port))
    members = [*(dask("worker", address, "--nthreads", "1") for _ in range(2)), scheduler]
    try:
        yield address, scheduler
    finally:
        for process in members:
            process.terminate()
        for process in members:
            try:
                process.wait(timeout=20)
            except subprocess.TimeoutExpired:
                process.kill()


def _fill_disk(trial: Trial) -> bool:
    """Generate into a small file system of its own until it is full; then move what is there to where there is room."""
    disk = trial.folder.with_name("small-disk")
    disk.mkdir(exist_ok=True)
    total = sum(path.stat().st_size for path in shards(trial.undisturbed))
    size = f"size={int(DISK_SHARES[trial.number] * total) // 1024}k"
    mounting = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", size, "tmpfs", str(disk)], capture_output=True, text=True, check=False
    )
    if mounting.returncode:
        raise ImpossibleHere(f"no small file system could be mounted ({mounting.stderr.strip()})")
    try:
        survived = _ends_well(trial.start("synchronous", folder=disk))
        shutil.copytree(disk, trial.folder)
    finally:
        subprocess.run(["umount", str(disk)], check=True)
        disk.rmdir()
    return survived


def _refuse_writes(trial: Trial) -> bool:
    """Limit the size of a file that the process may write: the kernel then refuses a write as on a full disk."""
    limit = min(path.stat().st_size for path in shards(trial.undisturbed)) // 2
    setup = f"import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))"
    return _ends_well(trial.start("synchronous", setup))


def _two_generators(trial: Trial) -> bool:
    children = [trial.start("synchronous"), trial.start("synchronous")]
    return sorted(_ends_well(child) for child in children) == [False, True]


def _damage(change: Callable[[bytes], bytes | None]) -> Callable[[Trial], bool]:
    """Return a fault that changes the bytes of a finished shard, or removes it; survived if that is detected."""

    def strike(trial: Trial) -> bool:
        from gelgap.domains import DomainFolder

        shutil.copytree(trial.undisturbed, trial.folder)
        victim = shards(trial.folder)[trial.number]
        changed = change(victim.read_bytes())
        if changed is None:
            victim.unlink()
        else:
            victim.write_bytes(changed)
        return bool(DomainFolder(victim.parent).damages())

    return strike


def _one_bit_flipped(data: bytes) -> bytes:
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


FAULTS: dict[str, Callable[[Trial], bool]] = {
    "kill -9 of a worker": _kill_worker,
    "kill -9 of the scheduler": _kill_scheduler,
    "kill -9 of the client": _kill_client,
    "Ctrl-C": _interrupt,
    "full disk (small file system)": _fill_disk,
    "write refused (file size limit)": _refuse_writes,
    "two generators on one folder": _two_generators,
    "truncated shard (survived: detected)": _damage(lambda data: data[: len(data) // 3]),
    "bit-flipped shard (survived: detected)": _damage(_one_bit_flipped),
    "missing shard (survived: detected)": _damage(lambda data: None),
}
QUICK_FAULTS = (
    "kill -9 of a worker",
    "write refused (file size limit)",
    "two generators on one folder",
    "bit-flipped shard (survived: detected)",
)
