"""Ctrl-C that waits for the end of a step which it would cut in two."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def stops_held_back() -> Iterator[None]:
    """Let kill -INT wait for the end of the block: a process that it cuts off from its parent prints a traceback.

    Processes that are started meanwhile never heed it; they end with their parent.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    stops: list[int] = []
    heeded = signal.signal(signal.SIGINT, lambda number, _: stops.append(number))
    unblocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, unblocked)
        signal.signal(signal.SIGINT, heeded)
        if stops:
            signal.raise_signal(signal.SIGINT)
