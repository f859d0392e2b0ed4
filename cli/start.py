"""The `gelgap` script: one that is stopped while it still loads its parts ends with a sentence as well."""

import time

from gelgap.cli.interruption import before_any_work


def start() -> None:
    """Load the command line and run it."""
    started = time.perf_counter()
    with before_any_work():
        from gelgap.cli.main import main
    main(started=started)


if __name__ == "__main__":
    start()
