"""Seeded damage to the bytes of every kind of file: none passes unseen, and none ends in anything but a sentence."""

import resource
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest
from valid_files import KINDS, FileKind

LIMIT_S = 20.0
MIB = 2**20
# Reading may take this many times the file's size and this much more, over what reading the valid file took.
MEMORY_FACTOR, MEMORY_CONSTANT_MIB = 2, 64
# What is left out or missing is made again.
MADE_AGAIN: dict[str, Callable[[Any, Any], bool]] = {
    "solution": lambda found, valid: found is None,
    "records": lambda found, valid: set(found) <= set(valid),
    "array of a record": lambda found, valid: found == [],
}


def damaged(data: bytes, number: int) -> bytes:
    """Return one of the ways in which a file goes bad, another for each number."""
    rng = np.random.default_rng([0, number])
    while True:
        size = int(rng.integers(1, max(2, len(data) // 4)))
        start = int(rng.integers(0, len(data) - 2 * size + 1))
        end = start + size
        other = int(rng.integers(end, len(data) - size + 1))
        block, last = data[start:end], data[other : other + size]
        changed = (
            flipped(data, rng, 1),
            flipped(data, rng, int(rng.integers(2, 64))),
            data[: int(rng.integers(0, len(data)))],
            data[:start] + last + data[end:other] + block + data[other + size :],
            data + rng.bytes(int(rng.integers(1, 4096))),
            data[:start] + bytes(size) + data[end:],
            data[:end] + block + data[end:],
            data[:start] + data[end:],
            f"a file of another version {rng.integers(10**9)}\n".encode(),
            b"",
        )[number % 10]
        if changed != data:  # zeros over zeros, or two equal blocks
            return changed


def flipped(data: bytes, rng: np.random.Generator, count: int) -> bytes:
    changed = bytearray(data)
    for place in rng.integers(0, len(data), count):
        changed[place] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def problem(name: str, kind: FileKind, file: Path, valid: Any) -> str | None:
    """Return what is wrong about how reading a damaged file ends: it may give the right content, or name the file."""
    try:
        found = kind.read(file)
    except (ValueError, RuntimeError, FileNotFoundError) as error:
        sentence = str(error)
        named = file.name in sentence and "\n" not in sentence
        return None if named and type(error).__module__ == "builtins" else f"no name: {error!r}"
    except Exception as error:
        return f"wrong exception: {error!r}"
    right = not kind.has_checksum or joblib.hash(found) == joblib.hash(valid)
    return None if right or MADE_AGAIN.get(name, lambda *_: False)(found, valid) else "not noticed"


@pytest.fixture
def timer() -> Iterator[Callable[[], object]]:
    """A function from whose call on a try may take no longer than the limit."""

    def stop(*_: object) -> None:
        pytest.fail(f"no end within {LIMIT_S:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    yield lambda: signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("tries", [10, pytest.param(500, marks=pytest.mark.slow)])
# Of a table of presses, a changed name of a picture is another picture's.
@pytest.mark.parametrize("name", sorted(KINDS.keys() - {"presses"}))
def test_no_damage_passes_unseen(
    name: str, tries: int, files: Path, timer: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GELGAP_CACHE", str(files / "cache"))
    kind = KINDS[name]
    file = kind.file(files)
    data, valid = file.read_bytes(), kind.read(file)
    # Once without counting: what is imported to make a damaged file again is no need of the file.
    file.write_bytes(b"")
    problem(name, kind, file, valid)
    before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    problems = {}
    for number in range(tries):
        file.write_bytes(damaged(data, number))
        timer()
        if found := problem(name, kind, file, valid):
            problems[number] = found
        for left in file.parent.glob("*.damaged"):
            left.unlink()
    growth_mib = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kib) / 1024
    assert problems == {}
    assert growth_mib < MEMORY_CONSTANT_MIB + MEMORY_FACTOR * len(data) / MIB


def test_what_may_not_happen_is_found(files: Path) -> None:
    def fail(error: Exception) -> Callable[[Path], Any]:
        def read(file: Path) -> Any:
            raise error

        return read

    ends = {
        "not noticed": lambda file: "other",
        "no name": fail(ValueError("bad")),
        "wrong": fail(KeyError()),
    }
    for expected, read in ends.items():
        kind = FileKind("membrane/state.npz", read)
        assert problem("membrane", kind, kind.file(files), "valid").startswith(expected)
