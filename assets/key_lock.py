"""One process at a time for each key of a cache: the others wait for what the first one makes.

All keys share one lock file: each is a byte of it, locked by the kernel, which gives the lock back however a process
ends, and of which no file is left behind.
"""

import contextlib
import fcntl
import hashlib
import os
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

LOCKS = ".locks"
# struct flock of Linux: type, whence, start, length, process (0 for a lock of the open file, which threads share not).
_FLOCK = "hhqqi4x"


def _nobody_waits() -> None:
    """Say nothing."""


@contextlib.contextmanager
def key_lock(folder: Path, key: str, waiting: Callable[[], None] = _nobody_waits) -> Iterator[None]:
    """Hold the lock of a key of the cache in `folder`; `waiting` is called once if another process has it.

    Where the folder takes no lock (it cannot be written to, or its file system has none) nothing is locked: at worst,
    work is done twice.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder / LOCKS, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError:
        yield
        return
    try:
        _lock(descriptor, _place(key), waiting)
        yield
    finally:
        # Closing the file gives the lock back.
        os.close(descriptor)


def _lock(descriptor: int, place: int, waiting: Callable[[], None]) -> None:
    lock = struct.pack(_FLOCK, fcntl.F_WRLCK, os.SEEK_SET, place, 1, 0)
    try:
        fcntl.fcntl(descriptor, fcntl.F_OFD_SETLK, lock)
        return
    except (BlockingIOError, PermissionError):
        waiting()
    except OSError:
        return
    with contextlib.suppress(OSError):
        fcntl.fcntl(descriptor, fcntl.F_OFD_SETLKW, lock)


def _place(key: str) -> int:
    """Return the byte that stands for a key; that two keys share one is next to impossible, and would do no harm."""
    return int.from_bytes(hashlib.sha256(key.encode()).digest()[:7], "big")
