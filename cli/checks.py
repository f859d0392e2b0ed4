"""The checks that stand in the annotations of a command's options, run before anything starts."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import FunctionType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import tyro

from gelgap.assets.names import quoted
from gelgap.cli.options import Command, OutputFile

_POSITIONAL = get_args(tyro.conf.Positional[int])[1]


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
                raise ValueError(
                    f"{first} and {name} name the same file, {path.resolve()}: give each its own"
                )


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
    own = hint.__metadata__ if get_origin(hint) is Annotated else ()
    return [*own, *(note for part in get_args(hint) for note in _notes(part))]
