"""Names and values in error sentences: what is unknown, what was probably meant, and no value at full length."""

from collections.abc import Iterable, Sequence
from difflib import get_close_matches

LONGEST_SHOWN = 80
_MOST_LISTED = 12


def unknown_name(what: str, name: str, known: Iterable[str], of_known: str = "known") -> str:
    """Return the sentence for a name that nothing has: the nearest known name, and all that are known.

    >>> unknown_name("profile preset", "cpus", ["cpu", "paper"])
    "profile preset 'cpus' is unknown; known: cpu, paper; did you mean cpu?"
    """
    known = tuple(known)
    near = meant(name, known)
    return f"{what} {shown(name)} is unknown; {of_known}: {', '.join(known)}{';' if near else ''}{near}"


def meant(name: str, known: Iterable[str]) -> str:
    """Return the question whether the nearest of the known names was meant; nothing if none is near."""
    near = get_close_matches(name[:LONGEST_SHOWN], tuple(known), n=1)
    return f" did you mean {near[0]}?" if near else ""


def shown(value: object) -> str:
    """Return a value as an error message shows it; the middle of a long one is left out."""
    text = repr(value)
    if len(text) <= LONGEST_SHOWN:
        return text
    return f"{text[: LONGEST_SHOWN // 2]}…{text[-LONGEST_SHOWN // 4 :]}"


def listed(names: Sequence[str]) -> str:
    """Return names side by side; of more than twelve the first two, the last, and how many there are.

    >>> listed([f"d{number}" for number in range(60)])
    'd0, d1, … d59 (60)'
    """
    if len(names) <= _MOST_LISTED:
        return ", ".join(names)
    return f"{names[0]}, {names[1]}, … {names[-1]} ({len(names)})"
