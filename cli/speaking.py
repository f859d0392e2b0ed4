"""A command that works longer than two seconds says on standard error what it does; standard output stays clean."""

import contextlib
import logging
import sys
import threading
import time
from typing import Self, TextIO

# What lasts no longer than the first is not worth a line; a line about the same work comes now and then.
QUIET_S = 1.6
SECONDS_BETWEEN_LINES = 10.0
_LOOK_S = 0.2
_ROOMS = logging.getLogger("gelgap")


class Speaker(logging.Handler):
    """While entered, prints warnings of the rooms at once, and what they say they are doing as soon as it takes long.

    `what` is said of work that they do not name.
    """

    def __init__(self, what: str, stream: TextIO | None = None) -> None:
        super().__init__(logging.INFO)
        self._stream = stream
        self._doing, self._kind = what, ""
        self._begun = self._said_at = time.monotonic()
        self._said: str | None = None
        self._ended = threading.Event()

    def __enter__(self) -> Self:
        self._level = _ROOMS.level
        _ROOMS.setLevel(logging.INFO)
        _ROOMS.addHandler(self)
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._watcher.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        # Else its last line might come within the sentence that ends the command.
        self._watcher.join()
        _ROOMS.removeHandler(self)
        _ROOMS.setLevel(self._level)

    def emit(self, record: logging.LogRecord) -> None:
        if record.levelno >= logging.WARNING:
            self._print(record.getMessage())
            return
        kind = str(record.msg)
        if kind != self._kind:
            self._begun = time.monotonic()
        self._doing, self._kind = record.getMessage(), kind

    def _watch(self) -> None:
        while not self._ended.wait(_LOOK_S):
            is_new = self._kind != self._said
            since, patience = (self._begun, QUIET_S) if is_new else (self._said_at, SECONDS_BETWEEN_LINES)
            if self._doing and time.monotonic() - since >= patience:
                self._said, doing = self._kind, self._doing
                # The same words twice say nothing.
                self._doing = ""
                self._print(doing)

    def _print(self, line: str) -> None:
        self._said_at = time.monotonic()
        with contextlib.suppress(OSError, ValueError):
            # The line break comes with it: other threads print, too.
            print(f"gelgap: {line}\n", end="", file=self._stream or sys.stderr, flush=True)
