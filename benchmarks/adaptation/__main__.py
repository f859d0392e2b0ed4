"""One part of the adaptation benchmark in pieces: `python -m gelgap.benchmarks.adaptation groups --minutes 4`."""

import math
import sys
import time
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gelgap.assets.locks import counted_stops
from gelgap.benchmarks.adaptation.board import GROUPS, LIGHT_GROUPS
from gelgap.benchmarks.adaptation.inputs_and_lights import BOARD_INPUTS
from gelgap.benchmarks.adaptation.leaderboard import SOURCES
from gelgap.benchmarks.adaptation.report import PARTS, measure
from gelgap.benchmarks.adaptation.study import BOARD, Study

_BAD_INPUT, _INTERRUPTED = 2, 130
KNOWN = {f"{source}:{target}": (source, target) for source, target in (*GROUPS, *LIGHT_GROUPS)}
SHOWN = (*BOARD_INPUTS, *SOURCES)


def run(
    part: Annotated[Literal[*PARTS], tyro.conf.Positional],
    seeds: tuple[int, ...] = (),
    methods: tuple[str, ...] = (),
    groups: tuple[Literal[*KNOWN], ...] = (),
    inputs: tuple[Literal[*SHOWN], ...] = (),
    workers: int | None = None,
    minutes: float = math.inf,
    out: Path = Path("benchmark-results/adaptation") / BOARD,
) -> None:
    """Do the missing runs of a part within a time limit, for some seeds or methods; the next call continues.

    Args:
        part: What is measured.
        seeds: By default the part's own.
        methods: Names, or your own as FILE.py:CLASS, each with its controls; by default the part's own.
        groups: SOURCE:TARGET; by default the part's own.
        inputs: What the parts `inputs` (by default all) and `leaderboard` (pictures) show, there also random lights.
            For `touch` a straight touch of each point comes first, which is not judged.
        workers: Processes; by default one per core.
        minutes: Begin no run after this time.
        out: Folder of the records, named after the profile; its data lie beside it.
    """
    study = Study.at(
        out,
        seeds=seeds,
        methods=methods,
        groups=tuple(KNOWN[group] for group in groups),
        inputs=inputs,
        workers=workers,
        stop=time.time() + 60 * minutes,
    )
    measure(part, study)


def main() -> None:
    """Run what the command line asks for; bad input and Ctrl-C end with one sentence."""
    with counted_stops() as stops:
        try:
            tyro.cli(run, prog="python -m gelgap.benchmarks.adaptation")
        except (KeyboardInterrupt, Exception) as error:
            if stops:  # some libraries turn Ctrl-C into an error of their own
                print(
                    "interrupted; finished runs are kept, run the same command again to go on",
                    file=sys.stderr,
                )
                sys.exit(_INTERRUPTED)
            if not isinstance(error, ValueError):
                raise
            print(" ".join(str(error).split()), file=sys.stderr)
            sys.exit(_BAD_INPUT)


if __name__ == "__main__":
    main()
