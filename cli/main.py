"""`gelgap`: parse the command line, run one command, turn errors into one line and an exit code."""

import os
import re
import signal
import sys
import threading
import time
from collections.abc import Sequence
from types import FrameType
from typing import NoReturn

from gelgap.cli.adapt import Adapt
from gelgap.cli.benchmark import Benchmark
from gelgap.cli.cache import Cache
from gelgap.cli.calibrate import Calibrate
from gelgap.cli.convert import Convert
from gelgap.cli.demo import Demo
from gelgap.cli.export import Export
from gelgap.cli.export_model import ExportModel
from gelgap.cli.finetune import Finetune
from gelgap.cli.generate import Generate
from gelgap.cli.inspect import Inspect
from gelgap.cli.options import Command, output_folder
from gelgap.cli.parser import check_values, parse_words
from gelgap.cli.predict import Predict
from gelgap.cli.presets import Presets
from gelgap.cli.press import Press
from gelgap.cli.pretrain import Pretrain
from gelgap.cli.render import Render
from gelgap.cli.report import Report
from gelgap.cli.speaking import Speaker
from gelgap.cli.view import View

EXIT_FAILED_RUN = 1
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130

DESCRIPTION = """Synthetic GelSight data with a domain gap that is known and under control.

For example:
  gelgap demo
  gelgap generate mb0i0 wmb1i1 --path cpu-random --quality draft --out data
  gelgap adapt --source data/mb0i0 --target data/wmb1i1 --method source-only dsan --profile cpu --classes from-force 20

Every command explains itself with --help; --version says which gelgap this is. Add --debug to any command for a full
traceback."""

MAKE = (Demo, Press, Render, View, Generate)
USE = (Inspect, Export, Convert, Calibrate, Pretrain, Adapt, Finetune, Predict, ExportModel)
LOOK = (Report, Benchmark, Presets, Cache)
COMMANDS = {
    re.sub(r"(?<=[a-z])(?=[A-Z])", "-", command.__name__).lower(): command for command in (*MAKE, *USE, *LOOK)
}
_LOOK_AGAIN_S = 0.1


def parse(words: Sequence[str]) -> Command:
    """Return the command that the words describe; on bad ones print one line and exit with code 2."""
    try:
        return parse_words(words, COMMANDS, DESCRIPTION)
    except ValueError as error:
        fail(str(error), EXIT_BAD_INPUT)


def fail(message: str, exit_code: int) -> NoReturn:
    """Print one line to standard error and exit."""
    print(f"gelgap: {' '.join(message.split())}", file=sys.stderr)
    raise SystemExit(exit_code)


def check_cache() -> None:
    """Raise ValueError unless files can be made in the cache's folder."""
    from gelgap.assets.locks import cache_folder

    folder = cache_folder()
    try:
        output_folder(folder)
    except ValueError as error:
        raise ValueError(f"GELGAP_CACHE = {str(folder)!r}: {error}") from None


def _counted_stops() -> list[int]:
    """Return a list that gets an entry for each Ctrl-C, which libraries sometimes turn into errors of their own.

    One that comes within an import waits for its end: some packages catch it, and torch would abort the process.
    """
    stops: list[int] = []

    def stop(number: int, frame: FrameType | None) -> None:
        stops.append(number)
        if _within_import(frame):
            threading.Timer(_LOOK_AGAIN_S, os.kill, (os.getpid(), number)).start()
            return
        raise KeyboardInterrupt

    # Where it is ignored, as in a background job, it stays ignored.
    in_main_thread = threading.current_thread() is threading.main_thread()
    if in_main_thread and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, stop)
    return stops


def _within_import(frame: FrameType | None) -> bool:
    while frame is not None and not frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    return frame is not None


def main(arguments: Sequence[str] | None = None, started: float | None = None) -> None:
    """Run the command line; `started` is when the process began, by `time.perf_counter`."""
    started = time.perf_counter() if started is None else started
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in arguments
    if arguments == ["--version"]:
        from importlib.metadata import version

        print(f"gelgap {version('gelgap')}")
        return
    command = parse([argument for argument in arguments if argument != "--debug"] or ["--help"])
    stops = _counted_stops()
    try:
        check_values(command)
        if command.fills_cache:
            check_cache()
        with Speaker(command.doing):
            command.run(started)
    except BrokenPipeError:
        raise SystemExit(EXIT_FAILED_RUN) from None
    except (KeyboardInterrupt, Exception) as error:
        if stops or isinstance(error, KeyboardInterrupt):
            fail(f"interrupted; {command.when_stopped}", EXIT_INTERRUPTED)
        if debug:
            raise
        is_bad_input = isinstance(error, ValueError | FileNotFoundError | PermissionError)
        fail(str(error) or type(error).__name__, EXIT_BAD_INPUT if is_bad_input else EXIT_FAILED_RUN)


if __name__ == "__main__":
    main()
