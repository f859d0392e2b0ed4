"""Faults during generation: what is lost, and whether the finished data set has the bytes of an undisturbed run."""

import hashlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from gelgap.benchmarks.common.tables import write_json

DOMAINS = ("mb0i0", "wmb0i0")
_CHILD = """
import sys
from gelgap.domains import generate
from gelgap.sim import ContactPath
out, scheduler = sys.argv[1], sys.argv[2] or None
if __name__ == "__main__":
    points_x, points_y = (-3.0, -1.8, -0.6, 0.6, 1.8, 3.0), (-2.4, -1.2, 0.0, 1.2, 2.4)
    # One level and one radius: a single solve, and many frames.
    path = ContactPath("faults", points_x, points_y, (0.2,), (0.1,), tuple(20.0 * k for k in range(18)))
    report = generate(%r, path, out, quality="draft", render_quality="draft", size_px=(160, 120),
                      scheduler=scheduler, workers=None if scheduler else 2)
    print("written", report.frames_written, "of", report.frames)
"""
_DEADLINE_S = 300.0
# The data set takes some 28 MB: the disk is full early, midway and near the end.
_SMALL_DISK_MB = (2, 9, 20)


class ImpossibleHere(Exception):
    """The machine does not let a fault be made, for want of rights."""


@dataclass(frozen=True)
class FaultResult:
    """One fault: tries, in how many the run itself survived, and what a rerun of the same command left.

    No tries: this machine does not let the fault be made.
    """

    fault: str
    tries: int
    survived: int
    shards_kept: int
    frames_lost: int
    files_different: int


def run(quick: bool, out_dir: Path) -> tuple[FaultResult, ...]:
    """Try every fault, finish the data set by running the same command again, compare; print the table."""
    out_dir.mkdir(parents=True, exist_ok=True)
    whole = out_dir / "undisturbed"
    shutil.rmtree(whole, ignore_errors=True)
    start = time.perf_counter()
    _finish(whole)
    print(f"undisturbed run: {time.perf_counter() - start:.1f} s (solves included unless cached)")
    expected = _hashes(whole)
    tries = 1 if quick else 3
    results = []
    for fault, strike in FAULTS.items():
        survived = kept = lost = different = made = 0
        for attempt in range(tries):
            folder = out_dir / "struck"
            shutil.rmtree(folder, ignore_errors=True)
            try:
                survived += strike(folder, whole, attempt)
            except ImpossibleHere as reason:
                print(f"{fault}: {reason}")
                break
            made += 1
            safe = sum(path.stat().st_size > 0 for path in folder.glob("*/frames-*.parquet"))
            kept += safe
            _finish(folder)
            found = _hashes(folder)
            lost += _frames(whole) - _frames(folder)
            different += sum(found.get(name) != value for name, value in expected.items())
            different += len(found.keys() - expected.keys())
        results.append(FaultResult(fault, made, survived, kept, lost, different))
        print(_row(results[-1]), flush=True)
    print("\n" + _HEADER)
    for result in results:
        print(_row(result))
    write_json(out_dir / "faults.json", results)
    return tuple(results)


_HEADER = f"{'fault':38} {'tries':>6} {'survived':>9} {'shards kept':>12} {'frames lost':>12} {'files different':>16}"


def _row(result: FaultResult) -> str:
    return (
        f"{result.fault:38} {result.tries:6d} {result.survived:9d} {result.shards_kept:12d} "
        f"{result.frames_lost:12d} {result.files_different:16d}"
    )


def _hashes(folder: Path) -> dict[str, str]:
    files = [path for path in folder.glob("*/*") if path.is_file()]
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def _frames(folder: Path) -> int:
    import pyarrow.parquet as pq

    return sum(pq.read_metadata(path).num_rows for path in folder.glob("*/frames-*.parquet"))


def _start(folder: Path, scheduler: str = "") -> subprocess.Popen:
    command = [sys.executable, "-c", _CHILD % (DOMAINS,), str(folder), scheduler]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )


def _finish(folder: Path) -> None:
    child = _start(folder)
    output, _ = child.communicate(timeout=_DEADLINE_S)
    if child.returncode:
        raise RuntimeError(f"generation failed: {output.splitlines()[-1] if output else 'no output'}")


def _wait_for_shards(folder: Path, count: int, child: subprocess.Popen) -> None:
    deadline = time.monotonic() + _DEADLINE_S
    while len(list(folder.glob("*/frames-*.parquet"))) < count:
        if child.poll() is not None or time.monotonic() > deadline:
            return
        time.sleep(0.02)


def _end(child: subprocess.Popen) -> bool:
    """Wait for a child and tell whether it succeeded."""
    try:
        child.communicate(timeout=_DEADLINE_S)
    except subprocess.TimeoutExpired:
        os.killpg(child.pid, signal.SIGKILL)
        child.communicate()
    return child.returncode == 0


def _workers_of(child: subprocess.Popen) -> list[int]:
    import psutil

    family = psutil.Process(child.pid).children(recursive=True)
    return [process.pid for process in family if "spawn_main" in " ".join(process.cmdline())]


def _kill_worker(folder: Path, whole: Path, attempt: int) -> bool:
    child = _start(folder)
    _wait_for_shards(folder, 2 + 4 * attempt, child)
    for worker in _workers_of(child)[:1]:
        os.kill(worker, signal.SIGKILL)
    return _end(child)


def _kill_client(folder: Path, whole: Path, attempt: int) -> bool:
    child = _start(folder)
    _wait_for_shards(folder, 2 + 4 * attempt, child)
    os.kill(child.pid, signal.SIGKILL)
    return _end(child)


def _interrupt(folder: Path, whole: Path, attempt: int) -> bool:
    child = _start(folder)
    _wait_for_shards(folder, 2 + 4 * attempt, child)
    os.killpg(child.pid, signal.SIGINT)
    return _end(child)


@contextmanager
def _separate_cluster() -> Iterator[tuple[str, subprocess.Popen]]:
    """A scheduler and two workers as processes of their own, on loopback."""
    port = 18786
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    address = f"tcp://127.0.0.1:{port}"
    scheduler = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "dask",
            "scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            str(port),
            "--no-dashboard",
        ],
        **quiet,
    )
    worker = [sys.executable, "-m", "dask", "worker", address, "--nthreads", "1", "--no-dashboard"]
    workers = [subprocess.Popen(worker, **quiet) for _ in range(2)]
    time.sleep(5)
    try:
        yield address, scheduler
    finally:
        for process in (*workers, scheduler):
            process.terminate()
        for process in (*workers, scheduler):
            try:
                process.wait(timeout=20)
            except subprocess.TimeoutExpired:
                process.kill()


def _kill_scheduler(folder: Path, whole: Path, attempt: int) -> bool:
    with _separate_cluster() as (address, scheduler):
        child = _start(folder, address)
        _wait_for_shards(folder, 2 + 4 * attempt, child)
        scheduler.kill()
        return _end(child)


def _fill_disk(folder: Path, whole: Path, attempt: int) -> bool:
    """Generate into a small file system of its own until it is full; then move what is there to where there is room."""
    disk = folder.with_name("small-disk")
    disk.mkdir(exist_ok=True)
    size = f"size={_SMALL_DISK_MB[attempt % len(_SMALL_DISK_MB)]}m"
    mounting = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", size, "tmpfs", str(disk)], capture_output=True, text=True, check=False
    )
    if mounting.returncode:
        raise ImpossibleHere(f"no small file system could be mounted ({mounting.stderr.strip()})")
    try:
        survived = _end(_start(disk))
        shutil.copytree(disk, folder)
    finally:
        subprocess.run(["umount", str(disk)], check=True)
        disk.rmdir()
    return survived


def _refuse_writes(folder: Path, whole: Path, attempt: int) -> bool:
    """Limit the size of a file that the process may write: the kernel then refuses a write as on a full disk."""
    child = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import resource, runpy\nresource.setrlimit(resource.RLIMIT_FSIZE, (1500000, 1500000))\n"
            + _CHILD % (DOMAINS,),
            str(folder),
            "",
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    return _end(child)


def _two_generators(folder: Path, whole: Path, attempt: int) -> bool:
    children = [_start(folder), _start(folder)]
    return sorted(_end(child) for child in children) == [False, True]


def _damage(change: Callable[[bytes], bytes | None]) -> Callable[[Path, Path, int], bool]:
    def strike(folder: Path, whole: Path, attempt: int) -> bool:
        from gelgap.domains import DomainFolder

        shutil.copytree(whole, folder)
        victim = sorted(folder.glob("*/frames-*.parquet"))[attempt]
        changed = change(victim.read_bytes())
        if changed is None:
            victim.unlink()
        else:
            victim.write_bytes(changed)
        return bool(DomainFolder(victim.parent).damages())

    return strike


FAULTS: dict[str, Callable[[Path, Path, int], bool]] = {
    "kill -9 of a worker": _kill_worker,
    "kill -9 of the scheduler": _kill_scheduler,
    "kill -9 of the client": _kill_client,
    "Ctrl-C": _interrupt,
    "full disk (small file system)": _fill_disk,
    "write refused (file size limit)": _refuse_writes,
    "two generators on one folder": _two_generators,
    "truncated shard (survived: detected)": _damage(lambda data: data[: len(data) // 3]),
    "bit-flipped shard (survived: detected)": _damage(
        lambda data: data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 1]) + data[len(data) // 2 + 1 :]
    ),
    "missing shard (survived: detected)": _damage(lambda data: None),
}
