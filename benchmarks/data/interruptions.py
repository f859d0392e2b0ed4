"""Commands stopped at random moments: whether what they say is kept is, and a second run ends as an undisturbed one."""

import contextlib
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from gelgap.assets.checksums import SUMS, checksum_problem
from gelgap.benchmarks.common.python_process import start_python
from gelgap.benchmarks.common.records import Ledger
from gelgap.benchmarks.common.tables import print_table, write_json

TIMES = 50
DEADLINE_S = 300.0
END_S = 60.0
"""Time in which a stopped command and its workers must have ended."""
SIGNALS = {"kill -INT": signal.SIGINT, "kill -9": signal.SIGKILL}
COLUMNS = (
    *("command", "stopped by", "times", "starting", "at work", "over", "sentences", "tracebacks"),
    *("left running", "parts kept", "made again", "reruns that failed", "files different"),
)
NOTE = (
    "starting: Python itself had not started yet; over: the work was done, or the command had ended; "
    "sentences and tracebacks: of those at work"
)
_BEGUN, _ALL_DONE = "has begun", "all is done"
_CHILD = """
try:
    print("has begun", flush=True)
    import sys
    from pathlib import Path
    from gelgap.benchmarks.data.interruptions import COMMANDS
    from gelgap.cli.start import start
    sys.argv[1:] = COMMANDS[{name!r}].arguments(Path({folder!r}), Path({data!r}))
except KeyboardInterrupt:
    sys.exit("gelgap: interrupted before it began")
start()
print("all is done", flush=True)
"""
POINTS = """points_x_mm = [-1.0, 1.0]
points_y_mm = [0.0]
depths_mm = [0.15, 0.2]
radii_mm = [0.1]
angles_deg = [0.0, 60.0, 120.0, 180.0, 240.0, 300.0]
"""


@dataclass(frozen=True)
class Stop:
    """What came of one signal to a command, and of the same command run again.

    `phase`: "starting" if the signal came before Python ran the command's first line, "over" if its work was done or it
    had ended, else "at work". `sentence`: it ended with one sentence that says what is kept, or that nothing had begun.
    `parts_kept`: finished parts that the second run left as they were; `parts_again`: those that it made again.
    `different`: files that differ from an undisturbed run's in the end.
    """

    phase: str
    sentence: bool
    traceback: bool
    left_running: bool
    parts_kept: int
    parts_again: int
    failed: bool
    different: int


@dataclass(frozen=True)
class Interrupted:
    """What came of stopping one command by one signal several times: counts of `Stop`.

    Sentences and tracebacks are those of commands at work: what is printed while Python itself starts or ends is not
    the command's.
    """

    command: str
    stopped_by: str
    times: int
    starting: int
    at_work: int
    over: int
    sentences: int
    tracebacks: int
    left_running: int
    parts_kept: int
    parts_again: int
    failed: int
    different: int


@dataclass(frozen=True)
class Stopped:
    """A command that can be stopped: its arguments, and below its folder the files that are finished parts.

    `arguments` is called in the process of the command, which it makes small, with the folders of output and data.
    """

    name: str
    arguments: Callable[[Path, Path], list[str]]
    parts: str


def _arguments_of_generate(folder: Path, data: Path) -> list[str]:
    """Generate two domains of a few frames in shards of eight, their physics solved anew."""
    from gelgap.domains import plan

    os.environ["GELGAP_CACHE"] = str(folder / "cache")
    plan.FRAMES_PER_SHARD = 8
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "path.toml"
    if not path.is_file():
        path.write_text(POINTS)
    small = ("--path", str(path), "--quality", "draft", "--size", "80", "60", "--scheduler", "synchronous")
    return ["generate", "mb0i0", "wmb0i0", *small, "--out", str(folder)]


def _arguments_of_adapt(folder: Path, data: Path) -> list[str]:
    """Adapt between these two domains, with three epochs a stage."""
    from gelgap.adapt import Profile

    smoke = Profile.preset("smoke").replace(source_epochs=3, adapt_epochs=3, image_size_px=(64, 48))
    Profile.preset = classmethod(lambda cls, name: smoke)
    domains = ("--source", str(data / "mb0i0"), "--target", str(data / "wmb0i0"))
    return ["adapt", *domains, "--method", "source-only", "coral", "--out", str(folder)]


def _arguments_of_physics(folder: Path, data: Path) -> list[str]:
    """Solve what a small `benchmark physics --quick` would solve, and keep it as the benchmark does."""
    from gelgap.benchmarks.physics import accuracy

    accuracy.run = _solve_shallow_presses
    return ["benchmark", "physics", "--quick", "--out", str(folder)]


def _solve_shallow_presses(quick: bool, out_dir: Path) -> None:
    from gelgap.benchmarks.physics.cases import Case, Workers
    from gelgap.sim import Elastomer, Pose

    gel = Elastomer(young_modulus_mpa=0.3, poisson_ratio=0.49, friction=0.8)
    cases = [Case(f"{d:g} mm", gel, (Pose(depth_mm=d),), "draft") for d in (0.05, 0.1, 0.15, 0.2)]
    solved = Workers(2, out_dir / "physics-solves").solve(cases)
    write_json(out_dir / "physics.json", [[state.force_n for state in one.states] for one in solved])


COMMANDS = {
    command.name: command
    for command in (
        Stopped("generate", _arguments_of_generate, "*/frames-*.parquet"),
        Stopped("adapt", _arguments_of_adapt, "*/run.json"),
        Stopped("benchmark physics --quick", _arguments_of_physics, "physics-solves/*.result"),
    )
}
Cells = Sequence[tuple[str, str]]
"""Names of commands, each with that of the signal that stops it."""
CELLS = [(name, stopped_by) for name in COMMANDS for stopped_by in SIGNALS]
QUICK_CELLS = [("generate", "kill -INT"), ("benchmark physics --quick", "kill -9")]


def run(quick: bool, out_dir: Path) -> None:
    """Stop every command many times, run it again each time, compare; print the table, write `interruptions.json`.

    The quick form stops `generate` and `benchmark physics --quick` once each, by kill -INT and kill -9.
    Each stop is noted: a benchmark that was stopped itself goes on with the next one.
    """
    from gelgap.domains import package_versions

    folder = out_dir / "interruptions"
    ledger = Ledger(folder / "unfinished.jsonl", package_versions())
    results = (
        measure_all(folder, QUICK_CELLS, 1, ledger) if quick else measure_all(folder, CELLS, TIMES, ledger)
    )
    title = "Commands stopped at random moments, and run again"
    print_table(title, COLUMNS, [astuple(result) for result in results], NOTE)
    write_json(out_dir / "interruptions.json", results)
    ledger.close()


def measure_all(folder: Path, cells: Cells, times: int, ledger: Ledger) -> list[Interrupted]:
    """Stop the commands by their signals as often as asked for, in turn, less what the ledger has."""
    data = _undisturbed(folder, "generate")
    names = dict.fromkeys(name for name, _ in cells)
    durations_s = {name: undisturbed_s(COMMANDS[name], folder, data) for name in names}
    shares = {cell: random.Random(", ".join(cell)) for cell in cells}
    for number in range(times):
        for name, stopped_by in cells:
            moment_s, label = durations_s[name] * shares[name, stopped_by].random(), f"{name}, {stopped_by}"
            if number < len(ledger.values(label, Stop)):
                continue
            place = (COMMANDS[name], _undisturbed(folder, name), folder / "stopped", data)
            ledger.note(label, stop(*place, SIGNALS[stopped_by], lambda child, s=moment_s: _pass(child, s)))
        print(f"each stopped {number + 1} of {times} times", flush=True)
    return [counted(*cell, ledger.values(", ".join(cell), Stop)[:times]) for cell in cells]


def undisturbed_s(command: Stopped, folder: Path, data: Path) -> float:
    """Run a command undisturbed and return how long it took."""
    undisturbed, start = _undisturbed(folder, command.name), time.monotonic()
    shutil.rmtree(undisturbed, ignore_errors=True)
    if not _ends_well(begin(command, undisturbed, data)):
        raise RuntimeError(f"{command.name} fails undisturbed: {_said(undisturbed)[-300:]}")
    duration_s = time.monotonic() - start
    print(f"{command.name}: undisturbed {duration_s:.1f} s", flush=True)
    return duration_s


def _undisturbed(folder: Path, name: str) -> Path:
    return folder / f"{name.split()[-1].strip('-')}-undisturbed"


def counted(command: str, stopped_by: str, stops: Sequence[Stop]) -> Interrupted:
    """Return the counts of some stops."""
    phases = [stop.phase for stop in stops]
    at_work = [stop for stop in stops if stop.phase == "at work"]
    return Interrupted(
        command,
        stopped_by,
        len(stops),
        *(phases.count(phase) for phase in ("starting", "at work", "over")),
        sum(stop.sentence for stop in at_work),
        sum(stop.traceback for stop in at_work),
        *(sum(getattr(stop, field.name) for stop in stops) for field in fields(Stop)[3:]),
    )


def stop(
    command: Stopped,
    undisturbed: Path,
    folder: Path,
    data: Path,
    number: int,
    wait: Callable[[subprocess.Popen], None],
) -> Stop:
    """Begin a command, send it a signal once `wait` returns, run it again and compare with the undisturbed run."""
    shutil.rmtree(folder, ignore_errors=True)
    child = begin(command, folder, data)
    wait(child)
    if child.poll() is None:
        os.kill(child.pid, number)
    left_running = not _all_end(child)
    said, printed = _said(folder), _file(folder, "stdout").read_text()
    # A process whose work is over, and which only has to end, has nothing to say.
    phase = "over" if _ALL_DONE in printed else "at work" if _BEGUN in printed else "starting"
    sentence = child.returncode in (1, 130) and said.count("gelgap: interrupted") == 1
    if phase == "at work" and number == signal.SIGINT and not sentence:
        print(f"  ended with code {child.returncode}: {said[-2000:].strip()}", flush=True)
    finished = {path: path.stat().st_mtime_ns for path in folder.glob(command.parts)}
    failed = not _ends_well(begin(command, folder, data))
    if failed:
        print(f"  run again, it failed: {_said(folder)[-2000:].strip()}", flush=True)
    unchanged = sum(path.is_file() and path.stat().st_mtime_ns == old for path, old in finished.items())
    found, expected = digests(folder), digests(undisturbed)
    differ = [name for name in found.keys() | expected.keys() if found.get(name) != expected.get(name)]
    if differ:
        print(f"  different: {', '.join(differ)}", flush=True)
    return Stop(
        phase=phase,
        sentence=sentence,
        traceback="Traceback" in said,
        left_running=left_running,
        parts_kept=unchanged,
        parts_again=len(finished) - unchanged,
        failed=failed,
        different=len(differ),
    )


def _pass(child: subprocess.Popen, seconds: float) -> None:
    """Let some time pass, less if the process ends before."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        child.wait(seconds)


def _ends_well(child: subprocess.Popen) -> bool:
    """Wait for the end of a process; one that hangs is ended."""
    _pass(child, DEADLINE_S)
    if child.poll() is None:
        _all_end(child)
    return child.returncode == 0


def begin(command: Stopped, folder: Path, data: Path) -> subprocess.Popen:
    """Start a command in a process and a session of its own; what it says goes beside its folder."""
    code = _CHILD.format(name=command.name, folder=str(folder), data=str(data))
    folder.parent.mkdir(parents=True, exist_ok=True)
    with _file(folder, "stderr").open("w") as said, _file(folder, "stdout").open("w") as printed:
        return start_python(code, printed, said)


def digests(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of what a command is for; times, logs, locks and caches are left out.

    Lists of checksums, which differ with the times in the files listed, count by whether they are right.
    """
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if (
            hidden
            or not path.is_file()
            or name == "run.jsonl"
            or name.startswith(("cache/", "physics-solves/"))
        ):
            continue
        found[name] = hashlib.sha256(_content(path)).hexdigest()
    return found


def _content(path: Path) -> bytes:
    """Return what of a file is the same in every run."""
    if path.name == SUMS:
        return " ".join(filter(None, map(checksum_problem, sorted(path.parent.iterdir())))).encode()
    if path.suffix == ".pt":
        return _weights(path)
    content = path.read_bytes()
    if path.name == "run.json":
        content = json.dumps({**json.loads(content), "wall_s": None, "history": None}).encode()
    return content


def _weights(checkpoint: Path) -> bytes:
    """Return the numbers of a checkpoint's network; the rest of the file has times of the epochs."""
    import torch

    state = torch.load(checkpoint, weights_only=True)["state"]
    return b"".join(name.encode() + state[name].numpy().tobytes() for name in sorted(state))


def _file(folder: Path, stream: str) -> Path:
    return folder.with_name(f"{folder.name}.{stream}")


def _said(folder: Path) -> str:
    return _file(folder, "stderr").read_text(errors="replace")


def _all_end(child: subprocess.Popen) -> bool:
    """Wait until a stopped command and all that it started have ended; end by force what has not."""
    deadline = time.monotonic() + END_S
    with contextlib.suppress(subprocess.TimeoutExpired):
        child.wait(END_S)
    while _session(child.pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    left = _session(child.pid)
    for process in left:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)
    child.wait()
    return not left


def _session(leader: int) -> list[int]:
    """Return the processes of a session that still run."""
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        with contextlib.suppress(OSError):
            state, *rest = (entry / "stat").read_text().rpartition(")")[2].split()
            if int(rest[2]) == leader and state != "Z":
                found.append(int(entry.name))
    return found
