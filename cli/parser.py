"""From words to a command, and one sentence about words that do not parse or values that cannot be used."""

import contextlib
import io
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from types import FunctionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import tyro

from gelgap.assets.names import quoted, unknown_name
from gelgap.cli.options import Command

_BOX_AND_STYLE = re.compile(r"\x1b\[[0-9;]*m|\[/?bold\]|-{5,}|[│╭╮╰╯─┃━]")
# What tyro says of a value of a type `X | None` is about None as well.
_NEITHER_NOR = re.compile(r"no type matching {None}\|(.+) could be instantiated from (.+)\. Got errors: .*")
_POSITIONAL = get_args(tyro.conf.Positional[int])[1]
_LONGEST = 800


def parse_words(words: Sequence[str], commands: Mapping[str, type[Command]], description: str) -> Command:
    """Return the command that the words describe; --help prints and exits.

    Raises
    ------
    ValueError
        For words that do not parse; the sentence names the option, what was typed and what it takes.
    """
    name = next((word for word in words if not word.startswith("-")), None)
    if name is not None and name not in commands:
        raise ValueError(unknown_name("command", name, commands, "commands"))
    # As a shell's variable that is not set leaves it.
    if any(re.fullmatch(r"(--[\w-]+=)?", word) for word in words):
        raise ValueError(f"a value is empty: gelgap {shlex.join(words)}")
    if name is None:
        listed = [
            Annotated[command, tyro.conf.subcommand(known, description=command.__doc__.partition("\n")[0])]
            for known, command in commands.items()
        ]
        wanted, prog, about = Union[tuple(listed)], "gelgap", description  # noqa: UP007
    else:
        words = [word for place, word in enumerate(words) if place != words.index(name)]
        wanted, prog, about = commands[name], f"gelgap {name}", None
    errors = io.StringIO()
    try:
        with contextlib.redirect_stderr(errors):
            return tyro.cli(wanted, prog=prog, description=about, args=words)
    except SystemExit as stop:
        if stop.code in (0, None):
            raise
    raise ValueError(_one_sentence(errors.getvalue(), words))


def _one_sentence(said: str, words: Sequence[str]) -> str:
    """Return what tyro says in a box as one sentence, without title and frame, and no longer than a screen."""
    text = " ".join(_BOX_AND_STYLE.sub(" ", said.partition("\n")[2]).split())
    text, _, pointer = text.partition(" For full helptext, ")
    if unknown := re.match(r"Unrecognized[\w ]* options: (\S+)", text):
        switch = next((word for word in words if word.endswith(f"={unknown[1]}")), None)
        text = f"{switch}: takes no value" if switch else f"{text}; {pointer}"
    text, _, usage = text.partition(" Argument helptext: ")
    text = _NEITHER_NOR.sub(r"\2 is not \1", text) + (f"; {usage}" if usage else "")
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST // 2]}…{text[-_LONGEST // 2 :]}"


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
