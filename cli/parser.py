"""From words to a command: its options by its dataclass, their checks, and one sentence for words that do not parse."""

import contextlib
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from itertools import takewhile
from pathlib import Path
from types import FunctionType, NoneType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import tyro

from gelgap.assets.names import closest_name, quoted, unknown_name
from gelgap.cli.options import Check, Command

_POSITIONAL = get_args(tyro.conf.Positional[int])[1]
_BOX_AND_COLOUR = re.compile(r"\x1b\[[0-9;]*m|[│╭╮╰╯─┃━]")
_WRONG_VALUE = re.compile(r"(?:Error parsing|(?:Missing value|invalid choice .*) for argument) '?([\w-]+)'?")
_UNKNOWN = re.compile(r"Unrecognized(?: or misplaced)? options: ([^\s,]+)")


@dataclass(frozen=True)
class Option:
    """One option of a command, or one value without a name (`positional`), called by its first name in messages."""

    field: str
    names: tuple[str, ...]
    type: Any
    positional: bool
    checks: tuple[Check, ...]

    @property
    def name(self) -> str:
        return self.field if self.positional else self.names[0]

    @property
    def is_switch(self) -> bool:
        return self.type is bool


def options_of(command: type) -> tuple[Option, ...]:
    """Return the options of a command's dataclass and of those inside it, in their order."""
    hints = get_type_hints(command, include_extras=True)
    return tuple(option for field in fields(command) for option in _options(field.name, hints[field.name]))


def _options(field: str, hint: Any) -> tuple[Option, ...]:
    kind, metadata = hint, []
    while get_origin(kind) is Annotated or NoneType in get_args(kind):
        kind, *more = (part for part in get_args(kind) if part is not NoneType)
        metadata += more
    if is_dataclass(kind):
        return options_of(kind)
    settings = [item for item in metadata if hasattr(item, "aliases")]
    name = next((item.name for item in settings if item.name), field)
    aliases = [alias for item in settings for alias in item.aliases or ()]
    names = (f"--{name.replace('_', '-')}", *aliases)
    checks = tuple(item for item in metadata if isinstance(item, FunctionType))
    return (Option(field, names, kind, _POSITIONAL in metadata, checks),)


def check_values(command: Any) -> None:
    """Run the checks of a command's options.

    Raises
    ------
    ValueError
        If some fail; the message names each option, its value, and what is allowed.
    """
    if problems := list(_problems(command)):
        raise ValueError("; ".join(problems))


def _problems(command: Any) -> Iterator[str]:
    for field in fields(command):
        if is_dataclass(value := getattr(command, field.name)):
            yield from _problems(value)
    for option in options_of(type(command)):
        value = getattr(command, option.field, None)
        for check in option.checks if value is not None else ():
            try:
                check(value)
            except (ValueError, OSError) as error:
                typed = " ".join(map(str, value)) if isinstance(value, tuple) else str(value)
                reason = getattr(error, "strerror", None)
                problem = f"cannot be used ({reason})" if reason else error
                yield f"{option.name} = {quoted(typed)}: {problem}"


def parse_words(words: Sequence[str], commands: Mapping[str, type[Command]], description: str) -> Command:
    """Return the command that the words describe; --help prints and exits.

    Raises
    ------
    ValueError
        For words that do not parse: one sentence with option, value and what is allowed, or the name that was
        probably meant.
    """
    name = next((word for word in words if not word.startswith("-")), None)
    if name is not None and name not in commands:
        raise ValueError(unknown_name("command", name, commands, "commands"))
    options = options_of(commands[name]) if name else ()
    _refuse_empty(words, options)
    listed = []
    for known, command in commands.items():
        # In the summary of all commands each has the first line of its docstring alone.
        summary = command.__doc__.partition("\n")[0] if name is None else None
        listed.append(Annotated[command, tyro.conf.subcommand(known, description=summary)])
    errors = io.StringIO()
    try:
        with contextlib.redirect_stderr(errors):
            return tyro.cli(Union[tuple(listed)], prog="gelgap", description=description, args=list(words))  # noqa: UP007
    except SystemExit as stop:
        if stop.code in (0, None):
            raise
    raise ValueError(_refusal(words, name, options, _one_line(errors.getvalue())))


def _refuse_empty(words: Sequence[str], options: Sequence[Option]) -> None:
    """Refuse an empty value, as an unset variable of a shell leaves it."""
    for place, word in enumerate(words):
        if word == "" or re.fullmatch(r"--[\w-]+=", word):
            before = next((other for other in reversed(words[:place]) if other.startswith("-")), None)
            first = next((option.name for option in options if option.positional), "a value")
            raise ValueError(f"{word[:-1] or before or first} = '': must not be empty")


def _one_line(parser_message: str) -> str:
    """Flatten the parser's boxed error into one sentence, without the pointer to --help that closes it."""
    without_title = parser_message.partition("\n")[2]
    text = re.sub("-{5,}", "", " ".join(_BOX_AND_COLOUR.sub(" ", without_title).split())).strip()
    return text.split(" For full helptext, ")[0]


def _refusal(words: Sequence[str], command: str | None, options: Sequence[Option], text: str) -> str:
    """Return what is wrong with words that the parser refused, saying `text`."""
    for option in options:
        if option.is_switch and (given := [word for word in words if word.startswith(f"{option.name}=")]):
            return f"{given[0]}: {option.name} takes no value"
    if found := _WRONG_VALUE.match(text):
        # The parser calls an option by any of its names, and a value without a name by its field or metavar.
        for option in options:
            if found[1] in (*option.names, option.field) or f"--{found[1].lower()}" in option.names:
                return _wrong_value(option, words)
    if found := _UNKNOWN.match(text):
        word = found[1]
        if not word.startswith("-"):
            return f"{quoted(word)} is one value too many for gelgap {command}; see: gelgap {command} --help"
        names = [name for option in options if not option.positional for name in option.names]
        known = closest_name(word, names) or f" options: {', '.join(names)};"
        return f"option {quoted(word)} is unknown;{known} see: gelgap {command} --help"
    return text


def _wrong_value(option: Option, words: Sequence[str]) -> str:
    given = _typed(option, words)
    if not given:
        return f"{option.name}: its value is missing; must be {_needs(option.type)}"
    choices = get_args(option.type) if get_origin(option.type) is Literal else ()
    near = closest_name(given, choices)
    return f"{option.name} = {quoted(given)}: must be {_needs(option.type)}{';' + near if near else ''}"


def _typed(option: Option, words: Sequence[str]) -> str:
    """Return what was typed after an option, or all values without a name."""
    if option.positional:
        return " ".join(words[1:])
    place = next(
        (place for place, word in enumerate(words) if word.partition("=")[0] in option.names), len(words)
    )
    behind_equals = [value for word in words[place : place + 1] if (value := word.partition("=")[2])]
    following = takewhile(lambda word: not word.startswith("--"), words[place + 1 :])
    return " ".join([*behind_equals, *following])


def _needs(kind: Any) -> str:
    """Return what a value of a type must be, in words."""
    parts = get_args(kind)
    if get_origin(kind) is Literal:
        return f"one of {', '.join(parts)}"
    if get_origin(kind) is tuple and parts[-1] is Ellipsis:
        return f"{_needs(parts[0])}, or several"
    if get_origin(kind) is tuple and len(set(parts)) > 1:
        return " and ".join(map(_needs, parts))
    if get_origin(kind) is tuple:
        return f"{len(parts)} {_needs(parts[0]).removeprefix('a ')}s"
    return {int: "a whole number", float: "a number", Path: "a path", str: "a name"}[kind]
