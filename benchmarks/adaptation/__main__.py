"""One part of the adaptation benchmark in pieces: `python -m gelgap.benchmarks.adaptation groups --minutes 4`."""

import argparse
import math
import signal
import time
from pathlib import Path

from gelgap.benchmarks.adaptation.board import GROUPS, LIGHT_GROUPS, Group
from gelgap.benchmarks.adaptation.study import BOARD, Study
from gelgap.benchmarks.registry import parts_of

_BAD_INPUT, _INTERRUPTED = 2, 130


def group_of(text: str) -> Group:
    """Return the group of a text such as wmb0i0:wmb0i1."""
    source, _, target = text.partition(":")
    if text not in {":".join(group) for group in (*GROUPS, *LIGHT_GROUPS)}:
        known = ", ".join(":".join(group) for group in (*GROUPS, *LIGHT_GROUPS))
        raise argparse.ArgumentTypeError(f"{text!r} is no group of the board; known: {known}")
    return source, target


def main() -> None:
    """Do the missing runs of a part within a time limit, for some seeds or methods; the next call continues."""
    parts = {entry.part: entry for entry in parts_of("adaptation")}
    parser = argparse.ArgumentParser(prog="python -m gelgap.benchmarks.adaptation", description=main.__doc__)
    parser.add_argument("part", choices=list(parts))
    parser.add_argument("--seeds", type=int, nargs="+", help="default: the part's own")
    parser.add_argument(
        "--methods",
        nargs="+",
        help="names, or your own as module:Class or file.py:Class; default: the part's own",
    )
    parser.add_argument(
        "--groups", nargs="+", type=group_of, metavar="SOURCE:TARGET", help="default: the part's own"
    )
    parser.add_argument("--workers", type=int, help="processes; default: one per core")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no run after this time")
    parser.add_argument("--out", type=Path, default=Path("benchmark-results/adaptation") / BOARD)
    chosen = parser.parse_args()
    study = Study.at(
        chosen.out,
        seeds=tuple(chosen.seeds) if chosen.seeds else None,
        methods=tuple(chosen.methods) if chosen.methods else None,
        groups=tuple(chosen.groups) if chosen.groups else None,
        workers=chosen.workers,
        stop=time.time() + 60 * chosen.minutes,
    )
    stops: list[int] = []
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(
            signal.SIGINT,
            lambda number, frame: stops.append(number) or signal.default_int_handler(number, frame),
        )
    try:
        parts[chosen.part].load().carry_out(study)
    except (KeyboardInterrupt, Exception) as error:
        if stops:  # some libraries turn Ctrl-C into an error of their own
            parser.exit(
                _INTERRUPTED, "interrupted; finished runs are kept, run the same command again to go on\n"
            )
        if not isinstance(error, ValueError):
            raise
        parser.exit(_BAD_INPUT, f"{' '.join(str(error).split())}\n")


if __name__ == "__main__":
    main()
