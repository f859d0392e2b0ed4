"""Public names that have left their room: who imports one the old way reads where it is."""

from collections.abc import Callable
from typing import Any


def answering_moved(
    attribute_of: Callable[[str], Any], old_room: str, new_room: str, names: tuple[str, ...], since: str
) -> Callable[[str], Any]:
    """Return a package's `__getattr__` that says of moved names where they are, and finds the others as before."""

    def attribute(name: str) -> Any:
        if name in names:
            # Of an AttributeError, `from … import …` would drop the sentence.
            raise ImportError(f"{old_room}.{name} is {new_room}.{name} since gelgap {since}")
        return attribute_of(name)

    return attribute
