"""One process at a time in an output folder; the kernel gives the lock back however the process ends."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

LOCK = ".lock"


@contextlib.contextmanager
def sole_use(folder: Path, name: str = LOCK) -> Iterator[None]:
    """Hold the folder's lock, or one of the folder's several by its name, which says whose it is.

    Raises
    ------
    RuntimeError
        If another process is writing to the folder.
    """
    from filelock import FileLock, Timeout

    folder.mkdir(parents=True, exist_ok=True)
    owner = folder / f"{name}.owner"
    lock = FileLock(folder / name, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        who = owner.read_text().strip() if owner.is_file() else "unknown"
        raise RuntimeError(
            f"another process ({who}) is writing to {folder}; wait for it to end or choose another folder"
        ) from None
    try:
        owner.write_text(f"pid {os.getpid()}")
        yield
    finally:
        owner.unlink(missing_ok=True)
        lock.release()
