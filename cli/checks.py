"""The checks that stand in the annotations of a command's options, run before anything starts."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import FunctionType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import tyro

from gelgap.assets.names import quoted
from gelgap.cli.options import Command

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
    for name, path in _output_files(command):
        if path in written:
            raise ValueError(f"{written[path]} and {name} name the same file, {path}: give each its own")
        written[path] = name


def _output_files(command: Command) -> Iterator[tuple[str, Path]]:
    hints = get_type_hints(type(command), include_extras=True)
    for field in fields(command):
        path, notes = getattr(command, field.name), _notes(hints[field.name])
        if path is not None and any(
            getattr(note, "__qualname__", "").startswith("output_file.") for note in notes
        ):
            yield f"--{field.name.replace('_', '-')}", path.resolve()


def _problems(options: Any) -> Iterator[str]:
    hints = get_type_hints(type(options), include_extras=True)
    for field in fields(options):
        value, notes = getattr(options, field.name), _notes(hints[field.name])
        for check in notes if value is not None else ():
            if isinstance(check, FunctionType):
                try:
                    check(value)
                except (ValueError, OSError) as error:
                    name = field.name if _POSITIONAL in notes else f"--{field.name.replace('_', '-')}"
                    typed = " ".join(map(str, value)) if isinstance(value, tuple) else str(value)
                    reason = getattr(error, "strerror", None)
                    yield f"{name} = {quoted(typed)}: {f'cannot be used ({reason})' if reason else error}"


def _notes(hint: Any) -> list[Any]:
    """Return what stands in an annotation beside the type, also inside `X | None`."""
    own = hint.__metadata__ if get_origin(hint) is Annotated else ()
    return [*own, *(note for part in get_args(hint) for note in _notes(part))]
