"""Names and values in error sentences and in the one line of a repr, and names that become names of files."""

import reprlib
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any

LONGEST_QUOTED = 80
LAST_VERSION = "0.3.0"
"""The last release: names that have left since are in it."""
_MOST_LISTED = 12
_PROSE = {"description", "known", "assumed"}


def unknown_name(what: str, name: str, known: Iterable[str], of_known: str = "known") -> str:
    """Return the sentence for a name that nothing has: the nearest known name, and all that are known.

    >>> unknown_name("profile preset", "cpus", ["cpu", "paper"])
    "profile preset 'cpus' is unknown; known: cpu, paper; did you mean cpu?"
    """
    known = tuple(known)
    return f"{what} {quoted(name)} is unknown; {of_known}: {', '.join(known)}{closest_name(name, known)}"


def left(what: str, name: str, instead: str = "") -> str:
    """Return the sentence for a name that has left gelgap: the last version that has it, and what to do instead.

    >>> left("method", "rsd")
    "method 'rsd' has left: gelgap 0.3.0 is the last version that has it"
    """
    told = f"{what} {quoted(name)} has left: gelgap {LAST_VERSION} is the last version that has it"
    return f"{told}; {instead}" if instead else told


def closest_name(name: str, known: Iterable[str]) -> str:
    """Return the question whether the nearest of the known names was meant, for the end of a sentence, if one is."""
    near = get_close_matches(name[:LONGEST_QUOTED], tuple(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""


def quoted(value: object) -> str:
    """Return a value as an error message shows it; the middle of a long one is left out."""
    text = repr(value)
    if len(text) <= LONGEST_QUOTED:
        return text
    return f"{text[: LONGEST_QUOTED // 2]}…{text[-LONGEST_QUOTED // 4 :]}"


def comma_list(names: Sequence[str]) -> str:
    """Return names side by side; of more than twelve the first two, the last, and how many there are.

    >>> comma_list([f"d{number}" for number in range(60)])
    'd0, d1, … d59 (60)'
    """
    if len(names) <= _MOST_LISTED:
        return ", ".join(names)
    return f"{names[0]}, {names[1]}, … {names[-1]} ({len(names)})"


def is_plain_name(name: object) -> bool:
    """Return whether a value is a text that names one file or folder, without control characters."""
    return (
        isinstance(name, str)
        and 0 < len(name) <= 255
        and name not in (".", "..")
        and not any(letter in "/\\" or not letter.isprintable() for letter in name)
    )


def stays_inside(name: str) -> bool:
    """Return whether a relative path leads to nothing outside of the folder it starts from."""
    paths = PurePosixPath(name), PureWindowsPath(name)
    return (
        bool(name)
        and "\0" not in name
        and not any(path.is_absolute() or path.anchor or ".." in path.parts for path in paths)
    )


def one_line(self: object) -> str:
    """Return the public attributes of an object in a line, as its `__repr__`: of large ones what they are."""
    # Fields of models and dataclasses say by `repr=False` that they are not shown.
    fields = getattr(type(self), "model_fields", None) or getattr(type(self), "__dataclass_fields__", {})
    silent = _PROSE | {name for name, field in fields.items() if not field.repr}
    shown = {name: value for name, value in vars(self).items() if name[0] != "_" and name not in silent}
    told = [f"{name}={_brief(value)}" for name, value in shown.items()]
    return f"{type(self).__name__}({', '.join(told)})"


def _brief(value: Any) -> str:
    """Return an array's shape, a preset's name, how many entries something long has, and of other objects the type."""
    if hasattr(value, "ndim") and value.ndim > 0:
        return f"array {value.shape}" if value.size > 3 else str(value.round(4).tolist())
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple) and value:
        # The first may be None.
        if hasattr(value[-1], "__dict__"):
            return f"{len(value)} × {type(value[-1]).__name__}"
        if isinstance(value[0], tuple) and len(repr(value)) > LONGEST_QUOTED:
            return f"{len(value)} × {len(value[0])} numbers"
    if hasattr(value, "__dict__"):
        return repr(value.name) if getattr(value, "name", "") else f"{type(value).__name__}(…)"
    return f"{len(value)} entries" if isinstance(value, dict) else reprlib.repr(value)
