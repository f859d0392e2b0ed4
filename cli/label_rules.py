"""Labels and their ranges as the command line takes them."""

import re
from dataclasses import dataclass

from gelgap.assets.names import closest_name, quoted

_RANGE = re.compile(r"(?P<name>\w+)=(?P<low>[^:]+):(?P<high>[^:]+)")


def label_names() -> tuple[str, ...]:
    """Return the names of all labels."""
    from gelgap.domains import QUANTITIES

    return tuple(QUANTITIES)


def parsed_range(text: str) -> tuple[str, tuple[float, float]]:
    """Return label and range of `fz_n=-30:0`; a ValueError if it is not of that form."""
    found = _RANGE.fullmatch(text)
    if found is None:
        raise ValueError(f"{text} is not of the form name=low:high")
    return found["name"], (float(found["low"]), float(found["high"]))


@dataclass(frozen=True)
class LabelRanges:
    """Ranges of labels, each once."""

    def problem(self, value: tuple[str, ...]) -> str | None:
        """Return what is wrong with the ranges."""
        if not value:
            return "name a label, its lower and its upper bound, as fz_n=-30:0"
        names = []
        for text in value:
            try:
                name, (low, high) = parsed_range(text)
            except ValueError:
                return f"{quoted(text)} must be a label, its lower and its upper bound, as fz_n=-30:0"
            if name not in label_names():
                known = label_names()
                return f"{quoted(name)} is unknown;{closest_name(name, known)} known: {', '.join(known)}"
            if not low < high:
                return f"the lower bound of {quoted(text)} must be below the upper one"
            names.append(name)
        return "a label stands twice" if len(set(names)) < len(names) else None
