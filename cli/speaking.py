"""What the rooms log while a command works, as lines on standard error; standard output stays clean."""

import contextlib
import logging
import math
import sys
import time
from typing import Self

SPOKEN = logging.INFO
SECONDS_BETWEEN_LINES = 10.0
_ROOMS = logging.getLogger("gelgap")


class Speaker(logging.Handler):
    """While entered, prints each warning of the rooms once, and now and then what they begin to do."""

    def __enter__(self) -> Self:
        self._said_at: dict[str, float] = {}
        self._level = _ROOMS.level
        _ROOMS.setLevel(SPOKEN)
        _ROOMS.addHandler(self)
        return self

    def __exit__(self, *_: object) -> None:
        _ROOMS.removeHandler(self)
        _ROOMS.setLevel(self._level)

    def emit(self, record: logging.LogRecord) -> None:
        now = time.monotonic()
        kind = str(record.msg)
        wait_s = SECONDS_BETWEEN_LINES
        if record.levelno >= logging.WARNING:
            kind, wait_s = record.getMessage(), math.inf
        if now - self._said_at.get(kind, -math.inf) < wait_s:
            return
        self._said_at[kind] = now
        with contextlib.suppress(OSError):
            print(f"gelgap: {record.getMessage()}", file=sys.stderr, flush=True)
