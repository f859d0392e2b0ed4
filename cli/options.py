"""What the options of several commands share: types with their checks, how --help shows them, and settings by name."""

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import FunctionType, MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, get_args, get_origin, get_type_hints

import tyro

from gelgap.assets.names import quoted
from gelgap.cli.keys import Meanings

Check = Callable[[Any], object]
"""Raises ValueError or OSError for a value that cannot be used: what is wrong, and what would be right.

It stands in the annotation of an option, and `check_values` runs it before anything starts. Checks that a room makes
before its work need none here.
"""
_POSITIONAL = get_args(tyro.conf.Positional[int])[1]


class Former(NamedTuple):
    """The last version that took an option, or a value of one, and what there is instead."""

    version: str
    instead: str


def removed(words: Sequence[str], former: Mapping[str, Former]) -> str:
    """Return a sentence on the first option among words that former versions alone took; else nothing."""
    for number, word in enumerate(words):
        option, _, value = word.partition("=")
        value = value or next(iter(words[number + 1 :]), "")
        for taken in (option, f"{option} {value}"):
            if taken in former:
                version, instead = former[taken]
                return f"gelgap {version} was the last with {taken}: {instead}"
    return ""


class Command:
    """What the command line parses to: a frozen dataclass whose fields are its options."""

    when_stopped = "only solved physics is sure to be kept; run the same command again to start over"
    """What is left of it after Ctrl-C, and what to do; commands that resume say what."""
    fills_cache = False
    former: ClassVar[Mapping[str, Former]] = MappingProxyType({})
    """What former versions took and this one does not: options, and values as `--option value`."""

    @classmethod
    def keys(cls) -> dict[str, Meanings]:
        """Return what its --set takes, by what the keys belong to; a command without --set has none."""
        return {}

    def run(self, started: float) -> None:
        """Do it and print what came out; `started` is when the process began, by `time.perf_counter`."""
        raise NotImplementedError


def optional(metavar: str, default: str = "", help: str | None = None) -> Any:
    """Return the annotation of an option that may be left out, with what happens then as --help shows it."""
    hint = f"(default: {default})" if default else ""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=hint, help=help)


def between(low: float, high: float, unit: str = "") -> Check:
    """Return the check of a number in [low, high], or of several."""

    def check(value: float | tuple[float, ...]) -> None:
        if not all(low <= number <= high for number in (value if isinstance(value, tuple) else (value,))):
            raise ValueError(f"must lie in [{low}, {high}] {unit}".rstrip())

    return check


def input_folder(what: str) -> Check:
    """Return the check of a folder that is there."""

    def check(path: Path) -> None:
        if not path.is_dir():
            raise ValueError(f"{'is a file' if path.exists() else 'does not exist'}; {what} is needed")

    return check


class OutputFile:
    """The check of a file that can be written, in a folder that is there; no two of a command may be the same."""

    def __init__(self, *suffixes: str):
        self.suffixes = suffixes

    def __call__(self, path: Path) -> None:
        if self.suffixes and path.suffix.lower() not in self.suffixes:
            raise ValueError(f"the name must end in {', '.join(self.suffixes)}")
        if path.is_dir():
            raise ValueError("is a folder; name a file")
        if not path.parent.is_dir():
            raise ValueError(f"the folder {path.parent} does not exist; create it first")
        if path.exists() and not os.access(path, os.W_OK):
            raise ValueError("cannot be written to; name another file")
        _check_takes_files(path.parent)


def output_folder(path: Path) -> None:
    """Check a folder that can be written to, or can be made."""
    there = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
    if not there.is_dir():
        raise ValueError(f"{there} is a file; name a folder")
    _check_takes_files(there)


def _check_takes_files(folder: Path) -> None:
    """Raise ValueError if no file can be made in a folder; for root, permissions alone do not tell."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ValueError(f"{folder} cannot be written to ({error.strerror}); name another") from None


Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")]
"""A switch that is off unless it is given."""
Quality = Literal["draft", "standard", "fine"]
Seed = Annotated[int, between(0, 2**63 - 1)]
PictureSize = Annotated[
    tuple[int, int],
    between(16, 4096, "px"),
    tyro.conf.arg(help="Width and height of the pictures in pixels."),
]
ProfileName = Annotated[
    str, tyro.conf.arg(help="Hyperparameters: a preset (see: gelgap presets profiles) or a TOML file.")
]
OwnBackbone = Annotated[
    str | None,
    optional(
        "FILE.py:FUNCTION",
        help="The file, run here, of the model's feature extractor, where that is your own.",
    ),
]
LightName = Annotated[str | None, optional("NAME", "the sensor's own, or i0")]


def check_values(command: Command) -> None:
    """Run the checks of a command's options.

    Raises
    ------
    ValueError
        If some fail; the message names each option, its value, and what is allowed.
    """
    groups = [value for value in vars(command).values() if is_dataclass(value)]
    if problems := [problem for part in (command, *groups) for problem in _problems(part)]:
        raise ValueError("; ".join(problems))
    written: dict[Path, str] = {}
    for name, path, notes in _options(command):
        if path is not None and any(isinstance(note, OutputFile) for note in notes):
            first = written.setdefault(path.resolve(), name)
            if first != name:
                raise ValueError(f"{first} and {name} name the same file {path.resolve()}: give each its own")


def _options(options: Any) -> Iterator[tuple[str, Any, list[Any]]]:
    """Yield the options of a command or of a group: how each is typed, its value, and the notes in its annotation."""
    hints = get_type_hints(type(options), include_extras=True)
    for field in fields(options):
        notes = _notes(hints[field.name])
        name = field.name if _POSITIONAL in notes else f"--{field.name.replace('_', '-')}"
        yield name, getattr(options, field.name), notes


def _problems(options: Any) -> Iterator[str]:
    for name, value, notes in _options(options):
        for check in notes if value is not None else ():
            if isinstance(check, FunctionType | OutputFile):
                try:
                    check(value)
                except (ValueError, OSError) as error:
                    typed = " ".join(map(str, value)) if isinstance(value, tuple) else str(value)
                    reason = getattr(error, "strerror", None)
                    yield f"{name} = {quoted(typed)}: {f'cannot be used ({reason})' if reason else error}"


def _notes(hint: Any) -> list[Any]:
    """Return what stands in an annotation beside the type, also inside `X | None`."""
    notes = hint.__metadata__ if get_origin(hint) is Annotated else ()
    return [*notes, *(note for part in get_args(hint) for note in _notes(part))]
