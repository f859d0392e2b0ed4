"""A command that works longer than two seconds says on standard error what it does; standard output stays clean."""

import contextlib
import logging
import sys
import threading
import time
from collections.abc import Iterator
from typing import TextIO

# What lasts no longer than the first is not worth a line; a line about the same work comes now and then.
QUIET_S = 1.6
SECONDS_BETWEEN_LINES = 10.0
_LOOK_S = 0.2


class Speaker(logging.Handler):
    """Prints warnings of the rooms at once, and what they say they are doing as soon as it takes long."""

    def __init__(self, what: str, stream: TextIO | None = None) -> None:
        super().__init__(logging.INFO)
        self._stream = stream
        self._doing, self._kind = what, ""
        self._begun = self._said_at = time.monotonic()
        self._said: str | None = None
        self._silence = False
        self._ended = threading.Event()

    def emit(self, record: logging.LogRecord) -> None:
        if record.levelno >= logging.WARNING:
            self._print(record.getMessage())
            return
        kind = str(record.msg)
        if kind != self._kind:
            self._begun = time.monotonic()
        self._doing, self._kind = record.getMessage(), kind

    def watch(self) -> None:
        """Print what is due, until `end`."""
        while not self._ended.wait(_LOOK_S):
            now = time.monotonic()
            is_new = self._kind != self._said
            if self._doing and now - (self._begun if is_new else self._said_at) >= (
                QUIET_S if is_new else SECONDS_BETWEEN_LINES
            ):
                self._said, doing = self._kind, self._doing
                # The same words twice say nothing.
                self._doing = ""
                self._print(doing)

    def end(self) -> None:
        """Fall silent."""
        self._ended.set()

    def _print(self, line: str) -> None:
        self._said_at = time.monotonic()
        with contextlib.suppress(OSError, ValueError):
            print(f"gelgap: {line}", file=self._stream or sys.stderr, flush=True)


@contextlib.contextmanager
def speaking(what: str, stream: TextIO | None = None) -> Iterator[None]:
    """While entered, say what the rooms do if it takes long; `what` is said of work that they do not name."""
    speaker = Speaker(what, stream)
    rooms = logging.getLogger("gelgap")
    level = rooms.level
    rooms.setLevel(logging.INFO)
    rooms.addHandler(speaker)
    threading.Thread(target=speaker.watch, daemon=True).start()
    try:
        yield
    finally:
        speaker.end()
        rooms.removeHandler(speaker)
        rooms.setLevel(level)
