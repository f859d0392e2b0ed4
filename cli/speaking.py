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
    """While entered, prints warnings of the rooms, and what they begin to do: about the same work now and then."""

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
        now, kind = time.monotonic(), str(record.msg)
        if (
            record.levelno < logging.WARNING
            and now - self._said_at.get(kind, -math.inf) < SECONDS_BETWEEN_LINES
        ):
            return
        self._said_at[kind] = now
        with contextlib.suppress(OSError):
            print(f"gelgap: {record.getMessage()}", file=sys.stderr, flush=True)
