"""A stop that comes before a command has begun: it ends with a sentence, too."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

EXIT_INTERRUPTED = 130


@contextmanager
def before_any_work() -> Iterator[None]:
    """While entered, nothing has been done: a stop says so and ends the process."""
    try:
        yield
    except KeyboardInterrupt:
        print("gelgap: interrupted before anything was done; run the same command again", file=sys.stderr)
        raise SystemExit(EXIT_INTERRUPTED) from None
