"""The `gelgap` script, which ends with a sentence also where it is stopped while it still loads its parts."""

import sys
import time
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


def start() -> None:
    """Load the command line and run it."""
    started = time.perf_counter()
    with before_any_work():
        from gelgap.cli.main import main
    main(started=started)


if __name__ == "__main__":
    start()
