"""`gelgap`: parse the command line, run one command, turn errors into one line and an exit code."""

import contextlib
import inspect
import os
import re
import shlex
import sys
import time
from collections.abc import Sequence
from importlib.metadata import version
from typing import Annotated, Any, NoReturn, Union

import tyro

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
from gelgap.cli.keys import advice_on, keys_listing
from gelgap.cli.options import Command, check_values, output_folder, removed
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

COMMANDS: dict[str, type[Command]] = {
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
    "predict": Predict,
    "export-model": ExportModel,
    "report": Report,
    "benchmark": Benchmark,
    "presets": Presets,
    "cache": Cache,
}
# As MuJoCo, OpenCV, torch, NumPy and the loader of shared libraries say it, each by an error of its own.
_OUT_OF_MEMORY = re.compile(r"\ballocate\b|failed to map segment", re.IGNORECASE)


def parse(words: Sequence[str]) -> Command:
    """Return the command that the words describe; on bad ones print what is wrong and exit with code 2."""
    # As a shell's variable that is not set leaves it; as a path it would be the working folder.
    if any(re.fullmatch(r"(--[\w-]+=)?", word) for word in words):
        fail(f"a value is empty: gelgap {shlex.join(words)}", EXIT_BAD_INPUT)
    # The parser would take the last alone, without a word; of --set it takes all.
    spelled_out = ["--out" if word == "-o" else word for word in words]
    options = [word.partition("=")[0] for word in spelled_out if re.match("--[a-z]", word)]
    if twice := [option for option in options if options.count(option) > 1 and option != "--set"]:
        fail(f"{twice[0]} is given twice; give it once, with all its values", EXIT_BAD_INPUT)
    name = next(iter(words), None)
    if name in COMMANDS:
        return _parse_command(name, tuple(words[1:]))
    # Of the list of commands each has a line; its own --help has all.
    listed = [
        Annotated[command, tyro.conf.subcommand(name, description=inspect.getdoc(command).partition("\n")[0])]
        for name, command in COMMANDS.items()
    ]
    any_command: Any = Union[tuple(listed)]  # noqa: UP007
    return tyro.cli(any_command, prog="gelgap", description=DESCRIPTION, args=words)


def _parse_command(name: str, words: tuple[str, ...]) -> Command:
    command = COMMANDS[name]
    if sentence := removed(words, command.former):
        fail(sentence, EXIT_BAD_INPUT)
    # Keys are fields of models, which take their time to load.
    asks_for_help = not {"-h", "--help"}.isdisjoint(words)
    keys = command.keys() if asks_for_help else {}
    description = f"{inspect.cleandoc(command.__doc__)}\n{keys_listing(keys)}" if keys else None
    try:
        return tyro.cli(command, prog=f"gelgap {name}", args=words, description=description)
    except SystemExit as stop:
        if stop.code == EXIT_BAD_INPUT and (advice := advice_on(words, command.keys())):
            fail(advice, EXIT_BAD_INPUT)
        raise


def fail(message: str, exit_code: int) -> NoReturn:
    """Print one line to standard error and exit."""
    with contextlib.suppress(OSError):
        print(f"gelgap: {' '.join(message.split())}", file=sys.stderr)
    raise SystemExit(exit_code)


def check_cache() -> None:
    """Raise ValueError unless files can be made in the cache's folder."""
    from gelgap.assets.locks import cache_folder

    folder = cache_folder()
    try:
        output_folder(folder)
    except ValueError as error:
        raise ValueError(f"the folder of the cache, {str(folder)!r}: {error} in GELGAP_CACHE") from None


def _drop_lost_output() -> None:
    """Drop what standard output does not take, of which Python would complain as it ends."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def main(
    arguments: Sequence[str] | None = None, started: float | None = None, stops: Sequence[int] = ()
) -> None:
    """Run the command line.

    `started` is when the process began, by `time.perf_counter`; `stops` has an entry for each Ctrl-C, which libraries
    sometimes turn into errors of their own.
    """
    started = time.perf_counter() if started is None else started
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    command = None
    at_work = False
    try:
        try:
            if arguments == ["--version"]:
                print(f"gelgap {version('gelgap')}")
                return
            command = parse([argument for argument in arguments if argument != "--debug"] or ["--help"])
            check_values(command)
            if command.fills_cache:
                check_cache()
            at_work = True
            with Speaker():
                command.run(started)
            at_work = False
        finally:
            sys.stdout.flush()
    except (KeyboardInterrupt, Exception) as error:
        after = command.when_stopped if command else "run the same command again"
        if stops or isinstance(error, KeyboardInterrupt):
            fail(f"interrupted; {after}", EXIT_INTERRUPTED)
        _drop_lost_output()
        if isinstance(error, BrokenPipeError) and not at_work:
            return  # Whoever reads what is printed has seen enough.
        if "--debug" in arguments:
            raise
        message = str(error) or type(error).__name__
        if isinstance(error, MemoryError) or _OUT_OF_MEMORY.search(message):
            fail(f"out of memory ({message}): a coarser quality or fewer workers need less", EXIT_FAILED_RUN)
        if isinstance(error, OSError) and error.errno and error.filename is None:
            fail(f"what is printed cannot be written ({error.strerror}); {after}", EXIT_FAILED_RUN)
        is_bad_input = isinstance(error, ValueError | FileNotFoundError | PermissionError)
        fail(message, EXIT_BAD_INPUT if is_bad_input else EXIT_FAILED_RUN)
