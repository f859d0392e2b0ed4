"""One part of the adaptation benchmark in pieces: `python -m gelgap.benchmarks.adaptation groups --minutes 4`."""

import argparse
import math
import time
from pathlib import Path

from gelgap.benchmarks.adaptation.jobs import Bench
from gelgap.benchmarks.registry import parts_of


def main() -> None:
    """Do the missing runs of a part within a time limit, for some seeds; the next call continues."""
    parts = {entry.part: entry for entry in parts_of("adaptation")}
    parser = argparse.ArgumentParser(prog="python -m gelgap.benchmarks.adaptation", description=main.__doc__)
    parser.add_argument("part", choices=list(parts))
    parser.add_argument("--seeds", type=int, nargs="+", help="default: the part's own")
    parser.add_argument("--workers", type=int, help="processes; default: one per core")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no run after this time")
    parser.add_argument("--out", type=Path, default=Path("benchmark-results/adaptation/cpu"))
    chosen = parser.parse_args()
    bench = Bench.at(
        chosen.out,
        seeds=tuple(chosen.seeds) if chosen.seeds else None,
        workers=chosen.workers,
        stop=time.time() + 60 * chosen.minutes,
    )
    parts[chosen.part].load().PART.carry_out(bench)


if __name__ == "__main__":
    main()
