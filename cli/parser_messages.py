"""What the parser refuses, in one sentence: option, value and what is allowed, or the name that was probably meant."""

import re
from collections.abc import Mapping, Sequence

from gelgap.assets.names import closest_name, quoted, unknown_name
from gelgap.cli.options import Option, options_of

_BOX_AND_COLOUR = re.compile(r"\x1b\[[0-9;]*m|[│╭╮╰╯─┃━]")
_WRONG_VALUE = re.compile(r"(?:Error parsing|(?:Missing value|invalid choice .*) for argument) '?([\w-]+)'?")
_UNKNOWN = re.compile(r"Unrecognized(?: or misplaced)? options: (\S+)")


def refusal(arguments: Sequence[str], commands: Mapping[str, type], parser_message: str) -> str:
    """Return the sentence for arguments that the parser refused, or found nothing wrong with but the command's name."""
    name = command_name(arguments)
    if name is None or name not in commands:
        return unknown_name("command", name or "", commands, "commands")
    text, options = _one_line(parser_message), options_of(commands[name])
    for option in options:
        if option.is_switch and (given := [a for a in arguments if a.startswith(f"{option.name}=")]):
            return f"{given[0]}: {option.name} takes no value"
    if found := _WRONG_VALUE.match(text):
        return _wrong_value(found[1], options, arguments, text)
    if found := _UNKNOWN.match(text):
        return _unknown_option(found[1], options, name)
    return text


def command_name(arguments: Sequence[str]) -> str | None:
    """Return the word that names the command."""
    return next((argument for argument in arguments if not argument.startswith("-")), None)


def empty_value(arguments: Sequence[str], commands: Mapping[str, type]) -> str | None:
    """Return the sentence for an empty value, as an unset variable of a shell leaves it; None if there is none."""
    for place, argument in enumerate(arguments):
        if argument == "" or re.fullmatch(r"--[\w-]+=", argument):
            before = next((a for a in reversed(arguments[:place]) if a.startswith("-")), None)
            return f"{argument[:-1] or before or _first_value(arguments, commands)} = '': must not be empty"
    return None


def _first_value(arguments: Sequence[str], commands: Mapping[str, type]) -> str:
    """Return the name of a command's values without a name."""
    options = options_of(commands[name]) if (name := command_name(arguments)) in commands else ()
    return next((option.name for option in options if option.positional), "a value")


def _one_line(parser_message: str) -> str:
    """Flatten the parser's boxed error into one sentence, without the pointer to --help that closes it."""
    without_title = parser_message.partition("\n")[2]
    text = re.sub("-{5,}", "", " ".join(_BOX_AND_COLOUR.sub(" ", without_title).split())).strip()
    return text.split(" For full helptext, ")[0]


def _wrong_value(called: str, options: Sequence[Option], arguments: Sequence[str], text: str) -> str:
    # The parser calls an option by any of its names, and a value without a name by its field or metavar.
    option = next(
        (o for o in options if called in (*o.names, o.field) or f"--{called.lower()}" in o.names), None
    )
    if option is None:
        return text
    given = _values_given(option, arguments)
    value = f" = {quoted(given)}" if given else ": its value is missing;"
    choices = getattr(option.type, "__args__", ())
    near = closest_name(given, [str(choice) for choice in choices]) if given else ""
    return f"{option.name}{value}{':' if given else ''} must be {option.needs()}{';' + near if near else ''}"


def _values_given(option: Option, arguments: Sequence[str]) -> str:
    """Return what was typed after an option, or all values without a name."""
    if option.positional:
        return " ".join(arguments[1:])
    for place, argument in enumerate(arguments):
        name, equals, value = argument.partition("=")
        if name in option.names:
            following = [value] if equals else []
            for word in arguments[place + 1 :]:
                if word.startswith("--"):
                    break
                following.append(word)
            return " ".join(following)
    return ""


def _unknown_option(word: str, options: Sequence[Option], command: str) -> str:
    word = word.rstrip(",")
    if not word.startswith("-"):
        return f"{quoted(word)} is one value too many for gelgap {command}; see: gelgap {command} --help"
    names = [name for option in options if not option.positional for name in option.names]
    near = closest_name(word, names)
    known = near or f" options: {', '.join(names)};"
    return f"option {quoted(word)} is unknown;{known} see: gelgap {command} --help"
