"""The `gelgap` script, which ends with a sentence also where it is stopped while it still loads its parts."""

import sys
import time


def start() -> None:
    """Load the command line and run it; a stop that does not come from a running command came before any work."""
    started = time.perf_counter()
    try:
        from gelgap.cli.main import main

        main(started=started)
    except KeyboardInterrupt:
        print("gelgap: interrupted before anything was done; run the same command again", file=sys.stderr)
        raise SystemExit(130) from None  # EXIT_INTERRUPTED of a module that is not loaded yet


if __name__ == "__main__":
    start()
