"""The `gelgap` script: one that is stopped while it loads its parts or reads its arguments ends with a sentence."""

import sys
import time

EXIT_INTERRUPTED = 130


def start() -> None:
    """Load the command line and run it."""
    started = time.perf_counter()
    try:
        from gelgap.cli.main import main

        main(started=started)
    except KeyboardInterrupt:
        print("gelgap: interrupted before anything was done; run the same command again", file=sys.stderr)
        raise SystemExit(EXIT_INTERRUPTED) from None


if __name__ == "__main__":
    start()
