"""`gelgap`: parse the command line, run one command, turn errors into one line and an exit code."""

import contextlib
import io
import os
import signal
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from types import FrameType
from typing import Annotated, Any, Protocol, Union

import tyro

from gelgap.assets.locks import cache_folder
from gelgap.cli.adapt import Adapt
from gelgap.cli.benchmark import Benchmark
from gelgap.cli.cache import Cache
from gelgap.cli.calibrate import Calibrate
from gelgap.cli.convert import Convert
from gelgap.cli.demo import Demo
from gelgap.cli.export import Export
from gelgap.cli.finetune import Finetune
from gelgap.cli.generate import Generate
from gelgap.cli.inspect import Inspect
from gelgap.cli.interruption import EXIT_INTERRUPTED, before_any_work
from gelgap.cli.options import check_values
from gelgap.cli.parser_messages import command_name, empty_value, refusal
from gelgap.cli.presets import Presets
from gelgap.cli.press import Press
from gelgap.cli.pretrain import Pretrain
from gelgap.cli.render import Render
from gelgap.cli.report import Report
from gelgap.cli.rules import OutputFolder
from gelgap.cli.speaking import speaking
from gelgap.cli.view import View

EXIT_FAILED_RUN = 1
EXIT_BAD_INPUT = 2

DESCRIPTION = """Synthetic GelSight data with a domain gap that is known and under control.

For example:
  gelgap demo
  gelgap generate mb0i0 wmb1i1 --path cpu --out data
  gelgap adapt --source data/mb0i0 --target data/wmb1i1 --method source-only dsan --out runs

Every command explains itself with --help; --version says which gelgap this is. Add --debug to any command for a full
traceback."""

COMMANDS = {
    "demo": Demo,
    "press": Press,
    "render": Render,
    "view": View,
    "generate": Generate,
    "inspect": Inspect,
    "export": Export,
    "convert": Convert,
    "calibrate": Calibrate,
    "pretrain": Pretrain,
    "adapt": Adapt,
    "finetune": Finetune,
    "report": Report,
    "benchmark": Benchmark,
    "presets": Presets,
    "cache": Cache,
}


class Command(Protocol):
    """What the command line parses to."""

    def run(self, started: float) -> None: ...


_LOOK_AGAIN_S = 0.1
STARTED_OVER = "nothing is kept but solved physics; run the same command again to start over"


def _one_of(commands: Mapping[str, type], *, summary: bool) -> Any:
    """Return the type that tyro parses to; in a summary each command has the first line of its docstring alone."""
    listed = []
    for name, command in commands.items():
        description = command.__doc__.partition("\n")[0] if summary else None
        listed.append(Annotated[command, tyro.conf.subcommand(name, description=description)])
    return Union[tuple(listed)]  # noqa: UP007


def parse(arguments: Sequence[str]) -> Command:
    """Return the command that the arguments describe; on bad ones print one line and exit with code 2."""
    if arguments and (name := command_name(arguments)) is not None and name not in COMMANDS:
        fail(refusal(arguments, COMMANDS, ""), EXIT_BAD_INPUT)
    if empty := empty_value(arguments, COMMANDS):
        fail(empty, EXIT_BAD_INPUT)
    errors = io.StringIO()
    commands = _one_of(COMMANDS, summary=not COMMANDS.keys() & set(arguments))
    try:
        with contextlib.redirect_stderr(errors):
            return tyro.cli(commands, prog="gelgap", description=DESCRIPTION, args=list(arguments))
    except SystemExit as stop:
        if stop.code not in (0, None):
            fail(refusal(arguments, COMMANDS, errors.getvalue()), EXIT_BAD_INPUT)
        raise


def fail(message: str, exit_code: int) -> None:
    """Print one line to standard error and exit."""
    print(f"gelgap: {' '.join(message.split())}", file=sys.stderr)
    raise SystemExit(exit_code)


def explain(error: Exception) -> str:
    """Return one sentence for an error; pydantic's several lines become field, value and allowed range."""
    problems = getattr(error, "errors", None)
    if not callable(problems):
        return str(error) or type(error).__name__
    return "; ".join(
        f"{'.'.join(str(part) for part in problem['loc']) or 'value'} = {problem['input']!r}: {problem['msg']}"
        for problem in problems()
    )


def check_cache(writes: bool) -> None:
    """Raise ValueError if the cache's folder is none or, where a command writes to it, takes no file."""
    folder = cache_folder()
    if writes and (problem := OutputFolder().problem(folder)):
        raise ValueError(f"GELGAP_CACHE = {str(folder)!r}: {problem}")


def _fail_interrupted(command: Command) -> None:
    """Say what is kept of a command that was stopped, and exit."""
    fail(f"interrupted; {getattr(command, 'when_stopped', STARTED_OVER)}", EXIT_INTERRUPTED)


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
        print(f"gelgap {version('gelgap')}")
        return
    with before_any_work():
        command = parse([argument for argument in arguments if argument != "--debug"] or ["--help"])
    name = type(command).__name__.lower()
    stops = _counted_stops()
    try:
        check_values(command)
        check_cache(writes=isinstance(command, Benchmark | Demo | Generate | Press | Pretrain | View))
        with speaking(getattr(command, "doing", f"{name}: reading and preparing")):
            command.run(started)
    except KeyboardInterrupt:
        _fail_interrupted(command)
    except BrokenPipeError:
        raise SystemExit(EXIT_FAILED_RUN) from None
    except Exception as error:
        if stops:
            _fail_interrupted(command)
        if debug:
            raise
        fail(explain(error), EXIT_BAD_INPUT if isinstance(error, ValueError) else EXIT_FAILED_RUN)


if __name__ == "__main__":
    main()
