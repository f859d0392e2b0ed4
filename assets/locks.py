"""Processes side by side: who writes to a folder, who fills a cache, and when Ctrl-C takes effect.

The kernel gives a lock back however its process ends.
"""

import contextlib
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

from gelgap.assets.checksums import sha256

LOG = logging.getLogger(__name__)
LOCK = ".lock"
_SECONDS_BETWEEN_STOPS = 0.2


def cache_folder() -> Path:
    """Return the user's cache folder: $GELGAP_CACHE, or `gelgap` where the system keeps caches.

    Raises
    ------
    ValueError
        If $GELGAP_CACHE names a file, or a place below one.
    """
    chosen = os.environ.get("GELGAP_CACHE")
    if chosen:
        there = next((path for path in (Path(chosen), *Path(chosen).parents) if path.exists()), None)
        if there is not None and not there.is_dir():
            raise ValueError(f"GELGAP_CACHE = {chosen!r}: {there} is a file; name a folder")
        return Path(chosen)
    from platformdirs import user_cache_path

    return user_cache_path("gelgap", appauthor=False)


@contextlib.contextmanager
def sole_use(folder: Path, name: str = LOCK) -> Iterator[None]:
    """Hold the lock of an output folder, or one of its several by its name.

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


@contextlib.contextmanager
def key_lock(folder: Path, key: str, waiting: Callable[[], None] | None = None) -> Iterator[None]:
    """Hold the lock of one key of a cache; `waiting` is called once if another process or thread has it.

    A folder that cannot be written to is used without a lock, as nothing is kept there. So is one whose file system
    has no locks: a warning says that work may then be done twice.
    """
    from filelock import FileLock, Timeout

    with contextlib.ExitStack() as held:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path = folder / f".{sha256(key.encode())[:16]}{LOCK}"
            lock = FileLock(path)
            try:
                lock.acquire(timeout=0)
            except Timeout:
                if waiting is not None:
                    waiting()
                lock.acquire()
            held.callback(lock.release)
            # Who waits for a file that is gone makes a new one.
            held.callback(path.unlink, missing_ok=True)
        except OSError as error:
            if os.access(folder, os.W_OK):
                LOG.warning(
                    f"{folder} takes no locks ({error}): processes that share it may do the same work twice"
                )
        yield


@contextlib.contextmanager
def defer_signals() -> Iterator[None]:
    """Let kill -INT wait for the end of the block: a process that it cuts off from its parent prints a traceback.

    Processes that are started meanwhile never heed it; they end with their parent.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    deferred: list[int] = []
    handler = signal.signal(signal.SIGINT, lambda number, _: deferred.append(number))
    unblocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, unblocked)
        signal.signal(signal.SIGINT, handler)
        if deferred:
            signal.raise_signal(signal.SIGINT)


@contextlib.contextmanager
def counted_stops() -> Iterator[list[int]]:
    """Let Ctrl-C raise KeyboardInterrupt until the block ends, and yield a list that gets an entry each time.

    The list tells a stop from an error that a library makes of it. A KeyboardInterrupt that is lost, as in a callback
    from C, is raised again a moment later. None is raised within an import, which torch would answer by aborting the
    process, nor while one is handled, so that what has to be cleaned up is.
    """
    stops: list[int] = []
    # Where it is ignored, as in a background job, it stays ignored.
    in_main_thread = threading.current_thread() is threading.main_thread()
    if not in_main_thread or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield stops
        return

    def stop(number: int, frame: FrameType | None) -> None:
        stops.append(number)
        again = threading.Timer(_SECONDS_BETWEEN_STOPS, os.kill, (os.getpid(), number))
        again.daemon = True
        again.start()
        if not _ends_already(sys.exc_info()[1]) and not _within_import(frame):
            raise KeyboardInterrupt

    hook = sys.unraisablehook
    # What is broken off complains, and the stop itself where it is lost.
    sys.unraisablehook = lambda lost: None if stops else hook(lost)
    signal.signal(signal.SIGINT, stop)
    try:
        yield stops
    finally:
        # One that comes now has nothing left to stop.
        signal.signal(signal.SIGINT, signal.SIG_IGN if stops else signal.default_int_handler)
        sys.unraisablehook = hook


def _ends_already(handled: BaseException | None) -> bool:
    """Return whether an exception that is handled is a KeyboardInterrupt, or came while one was handled."""
    while handled is not None and not isinstance(handled, KeyboardInterrupt):
        handled = handled.__context__
    return handled is not None


def _within_import(frame: FrameType | None) -> bool:
    while frame is not None and not frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    return frame is not None
