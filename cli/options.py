"""The options of a command as its dataclass defines them: names, types and rules."""

from dataclasses import dataclass, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import tyro

from gelgap.assets.names import quoted
from gelgap.cli.rules import Rule

_POSITIONAL = get_args(tyro.conf.Positional[int])[1]


@dataclass(frozen=True)
class Option:
    """One option, or one value without a name (`positional`)."""

    field: str
    names: tuple[str, ...]
    type: Any
    positional: bool
    rules: tuple[Rule, ...]

    @property
    def name(self) -> str:
        """The name by which messages call it."""
        return self.field if self.positional else self.names[0]

    @property
    def is_switch(self) -> bool:
        """Whether it takes no value."""
        return self.type is bool

    def needs(self) -> str:
        """Return what a value must be, in words."""
        return _needs(self.type)


def options_of(command: type) -> tuple[Option, ...]:
    """Return the options of a command's dataclass, in their order."""
    hints = get_type_hints(command, include_extras=True)
    return tuple(_option(field.name, hints[field.name]) for field in fields(command))


def check_values(command: Any) -> None:
    """Check a parsed command against the rules of its options.

    Raises
    ------
    ValueError
        If values break some; the message names each option, its value, and what is allowed.
    """
    problems = [
        f"{option.name} = {_as_given(value)}: {problem}"
        for option in options_of(type(command))
        if (value := getattr(command, option.field)) is not None
        for rule in option.rules
        if (problem := rule.problem(value))
    ]
    if problems:
        raise ValueError("; ".join(problems))


def _as_given(value: Any) -> str:
    """Return a value as it was typed."""
    return quoted(" ".join(map(str, value)) if isinstance(value, tuple) else str(value))


def _option(field: str, hint: Any) -> Option:
    metadata: tuple = ()
    while get_origin(hint) is Annotated:
        metadata += hint.__metadata__
        hint = hint.__origin__
    if get_origin(hint) in (Union, UnionType):
        (hint,) = (kind for kind in get_args(hint) if kind is not NoneType)
    settings = [item for item in metadata if hasattr(item, "aliases")]
    name = next((item.name for item in settings if item.name), field)
    aliases = [alias for item in settings for alias in item.aliases or ()]
    return Option(
        field,
        (f"--{name.replace('_', '-')}", *aliases),
        hint,
        _POSITIONAL in metadata,
        tuple(item for item in metadata if isinstance(item, Rule)),
    )


def _needs(kind: Any) -> str:
    match get_origin(kind):
        case value if value is Literal:
            return f"one of {', '.join(get_args(kind))}"
        case value if value is tuple and get_args(kind)[-1] is Ellipsis:
            return f"{_needs(get_args(kind)[0])}, or several"
        case value if value is tuple and len(set(get_args(kind))) > 1:
            return " and ".join(map(_needs, get_args(kind)))
        case value if value is tuple:
            return f"{len(get_args(kind))} {_needs(get_args(kind)[0]).removeprefix('a ')}s"
    return {int: "a whole number", float: "a number", Path: "a path", str: "a name"}[kind]
