"""The `gelgap` script: standard streams, and Ctrl-C from the first moment."""

import atexit
import gc
import os
import sys
import time

from gelgap.assets.locks import counted_stops

# OpenBLAS' threads wait for one another, spinning, at matrices as small as ours: with two, a press whose solution is
# known takes 1.7 core seconds instead of 0.9. It reads this as NumPy is loaded.
_ONE_THREAD = "OPENBLAS_NUM_THREADS"


def start() -> None:
    """Load the command line and run it."""
    started = time.perf_counter()
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    if sys.stdout is None:
        print("gelgap: standard output is closed, and results are printed there; open it", file=sys.stderr)
        raise SystemExit(2)
    # Where the terminal is ASCII, a result with a µ is still a result.
    sys.stdout.reconfigure(errors="backslashreplace")
    os.environ.setdefault(_ONE_THREAD, os.environ.get("OMP_NUM_THREADS", "1"))
    # As Python ends it looks through all that is loaded for garbage: a `draft` press takes 0.87 of the time without.
    atexit.register(gc.freeze)
    with counted_stops() as stops:
        try:
            from gelgap.cli.main import main

            main(started=started, stops=stops)
        except KeyboardInterrupt:
            print("gelgap: interrupted before anything was done; run the same command again", file=sys.stderr)
            raise SystemExit(130) from None  # EXIT_INTERRUPTED of a module that may not be loaded yet


if __name__ == "__main__":
    start()
