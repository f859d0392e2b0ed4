"""Damaged files: every kind that gelgap reads, mutated by seed and read by the function that its command reads it with.

A try may end in the right content, or in one sentence that names the file. Anything else is counted as what it is.
"""

import contextlib
import logging
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from gelgap.adapt import ResultTable
from gelgap.benchmarks.common.limited_process import run_limited
from gelgap.benchmarks.common.tables import write_json
from gelgap.benchmarks.data.file_kinds import KINDS, content_digest
from gelgap.benchmarks.data.mutations import mutated
from gelgap.benchmarks.data.sound_files import make_sound_files

TRIES, QUICK_TRIES = 500, 20
SEED = 0
LIMIT_S = 20.0
"""The longest that one try may take."""
MEMORY_FACTOR, MEMORY_CONSTANT_MIB = 2, 64
"""Reading may take this many times the file's size and this much more, over what reading the sound file took."""
MIB = 2**20
COLUMNS = (
    *("kind", "bytes", "mutations", "right content", "refused", "not noticed", "unnamed", "wrong exception"),
    *("hang", "longest, s", "growth, MiB"),
)
ALLOWED = ("right content", "refused")


@dataclass(frozen=True)
class Question:
    """What a process is to try: how many mutations of the files of one kind, among the sound ones in a folder."""

    kind: str
    folder: Path
    tries: int


@dataclass(frozen=True)
class KindResult:
    """How the tries of one kind ended, the longest of them, and by how much the process's memory grew at most."""

    kind: str
    file_bytes: int
    tries: int
    outcomes: dict[str, int]
    longest_s: float
    growth_mib: float
    examples: dict[str, str] = field(default_factory=dict)

    @property
    def failures(self) -> list[str]:
        """What is not allowed, in words."""
        allowed = ALLOWED if KINDS[self.kind].has_checksum else (*ALLOWED, "not noticed")
        found = [f"{count} × {name}" for name, count in self.outcomes.items() if name not in allowed]
        if self.growth_mib > MEMORY_CONSTANT_MIB + MEMORY_FACTOR * self.file_bytes / MIB:
            found.append(f"memory grew by {self.growth_mib:.0f} MiB")
        return found


def run(quick: bool, out_dir: Path) -> None:
    """Mutate and read files of every kind, print the table and write `faults-files.json`.

    Raises
    ------
    RuntimeError
        If a try ended in another way than it may.
    """
    folder, tries = out_dir / "faults-files", QUICK_TRIES if quick else TRIES
    shutil.rmtree(folder, ignore_errors=True)
    print("making one sound file of every kind", flush=True)
    made = run_limited(make_sound_files, (folder / "sound").resolve(), 600)
    if made.failure:
        raise RuntimeError(f"the sound files could not be made: {made.failure}")
    results, failures = [], []
    for kind in KINDS:
        attempt = run_limited(try_kind, Question(kind, folder.resolve(), tries), 60 + 2 * tries)
        if attempt.failure:
            failures.append(f"{kind}: {attempt.failure}")
            continue
        results.append(attempt.value)
        failures += [f"{kind}: {failure}" for failure in attempt.value.failures]
        print(f"{kind}: {dict(attempt.value.outcomes)}", flush=True)
    ResultTable("Damaged files", COLUMNS, [_row(result) for result in results], _note()).show()
    failures += _through_commands(folder.resolve())
    write_json(out_dir / "faults-files.json", results)
    shutil.rmtree(folder)
    if failures:
        raise RuntimeError(
            f"damaged files: {'; '.join(failures)}; see examples in {out_dir}/faults-files.json"
        )


def try_kind(question: Question) -> KindResult:
    """Read every mutation of a kind's file, in this process."""
    kind = KINDS[question.kind]
    part = question.folder / "tried" / kind.part
    shutil.rmtree(part, ignore_errors=True)
    shutil.copytree(question.folder / "sound" / kind.part, part)
    for name in ("runs", "cache", "records"):
        if kind.part == name:
            _add_copies(part, question.folder / "sound")
    os.environ["GELGAP_CACHE"] = str(question.folder / "tried" / "cache")
    logging.getLogger("gelgap").setLevel(logging.CRITICAL)
    expected = content_digest(kind.read(part))
    victim = _victim(part, kind.file)
    sound = victim.read_bytes()
    # Once without counting: what is imported to make a damaged file again is no need of the file.
    victim.write_bytes(b"")
    _outcome(kind.read, part, victim, expected)
    _restore(victim, sound)
    before_kib = _peak_kib()
    outcomes: Counter[str] = Counter()
    examples: dict[str, str] = {}
    longest_s = 0.0
    for number in range(question.tries):
        name, damaged = mutated(sound, number, SEED)
        victim.write_bytes(damaged)
        started = time.perf_counter()
        outcome, detail = _outcome(kind.read, part, victim, expected)
        longest_s = max(longest_s, time.perf_counter() - started)
        outcomes[outcome] += 1
        examples.setdefault(f"{outcome} ({name})", f"mutation {number}: {detail}"[:300])
        _restore(victim, sound)
    growth_mib = (_peak_kib() - before_kib) / 1024
    return KindResult(
        question.kind, len(sound), question.tries, dict(outcomes), longest_s, growth_mib, examples
    )


class _TookTooLong(BaseException):
    """A try that did not end in time; no `except Exception` stops it."""


def _outcome(read, part: Path, victim: Path, expected: str) -> tuple[str, str]:
    """Return how reading a damaged file ends, and the sentence or exception."""
    try:
        with _time_limit():
            found = content_digest(read(part))
    except _TookTooLong:
        return "hang", f"no end within {LIMIT_S:g} s"
    except (ValueError, RuntimeError, FileNotFoundError) as error:
        sentence = str(error)
        named = victim.name in sentence and "\n" not in sentence and type(error).__module__ == "builtins"
        return "refused" if named else "unnamed", f"{type(error).__name__}: {sentence}"
    except Exception as error:
        return "wrong exception", f"{type(error).__name__}: {error}"
    return ("right content" if found == expected else "not noticed"), ""


@contextlib.contextmanager
def _time_limit() -> Iterator[None]:
    def stop(*_: object) -> None:
        raise _TookTooLong

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def _add_copies(part: Path, sound: Path) -> None:
    """Put beside the files what a reader needs to make a damaged one again."""
    if part.name == "runs":
        shutil.copytree(sound / "pictures", part / "pictures")
    else:
        shutil.copytree(sound / part.name, part / "copy")


def _victim(part: Path, pattern: str) -> Path:
    found = sorted(part.glob(pattern))
    if not found:
        raise FileNotFoundError(f"no {pattern} in {part}")
    return found[0]


def _restore(victim: Path, sound: bytes) -> None:
    for left in victim.parent.glob("*.damaged"):
        left.unlink()
    victim.write_bytes(sound)


def _peak_kib() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _row(result: KindResult) -> list[object]:
    counts = [result.outcomes.get(name, 0) for name in COLUMNS[3:9]]
    return [
        result.kind,
        result.file_bytes,
        result.tries,
        *counts,
        round(result.longest_s, 2),
        round(result.growth_mib, 1),
    ]


def _note() -> str:
    free = ", ".join(name for name, kind in KINDS.items() if not kind.has_checksum)
    return (
        f"Without a checksum, because other people write them: {free}; there a change may pass as other content. "
        "Caches and records are made again: right content."
    )


def _through_commands(folder: Path) -> list[str]:
    """Run commands on truncated files in processes of their own; return what does not end in one sentence."""
    sound, failures = folder / "sound", []
    truncations = {
        sound / "membrane" / "state.npz": ["render", str(sound / "membrane" / "state.npz"), "-o", "x.png"],
        sound / "data" / "mb0i0" / "manifest.json": ["inspect", str(sound / "data" / "mb0i0")],
        sound / "pictures" / "3.png": ["inspect", str(sound / "pictures"), "--verify"],
        sound / "runs" / "run" / "run.json": ["report", str(sound / "runs")],
    }
    for victim, arguments in truncations.items():
        whole = victim.read_bytes()
        victim.write_bytes(whole[: len(whole) // 2])
        command = [sys.executable, "-m", "gelgap.cli.main", *arguments]
        ended = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
        victim.write_bytes(whole)
        if ended.returncode not in (1, 2) or not is_one_sentence(ended.stderr, victim.name):
            failures.append(
                f"gelgap {arguments[0]} with a truncated {victim.name}: {ended.stderr.strip()[-200:]}"
            )
    return failures


def is_one_sentence(said: str, name: str) -> bool:
    """Return whether a command ended with one sentence about a file; on a slow machine it says before what it does."""
    *doing, last = said.strip().splitlines() or [""]
    return all(line.startswith("gelgap: ") and name not in line for line in doing) and name in last
