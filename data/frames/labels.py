"""What a network predicts: which columns of a data set are labels, their units, and the range of each."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gelgap.assets.names import unknown_name

Range = tuple[float, float]

FORCE_COLUMNS = ("fx_n", "fy_n", "fz_n")

PAPER_FORCE_RANGE_N = ((-0.75, 0.75), (-0.75, 0.75), (-3.0, 0.0))
"""The paper's fixed ranges of Fx, Fy, Fz in N, by which forces are normalised."""
PAPER_RANGES = dict(zip(FORCE_COLUMNS, PAPER_FORCE_RANGE_N, strict=True))
"""The same by name."""

_PER_UNIT = 10
"""Ranges found in the data end at tenths of the label's unit."""


class Quantity(NamedTuple):
    """How a label is written: its symbol and its unit."""

    symbol: str
    unit: str

    def __str__(self) -> str:
        return f"{self.symbol}, {self.unit}"


QUANTITIES = {
    "fx_n": Quantity("Fx", "N"),
    "fy_n": Quantity("Fy", "N"),
    "fz_n": Quantity("Fz", "N"),
    "mx_nmm": Quantity("Mx", "N·mm"),
    "my_nmm": Quantity("My", "N·mm"),
    "mz_nmm": Quantity("Mz", "N·mm"),
    "x_mm": Quantity("x", "mm"),
    "y_mm": Quantity("y", "mm"),
    "depth_mm": Quantity("depth", "mm"),
}
"""Every label there is, by the name of its column: force, torque, contact point, depth."""


@dataclass(frozen=True)
class Labels:
    """The labels of a data set or a model: names of columns, and for each its range (low, high) in its unit.

    Labels are normalised by their range; one outside it is an error and never clipped. By default the three axes of
    the force in the paper's ranges. Pictures alone have none, `Labels((), ())`.

    Raises
    ------
    ValueError
        If a name is unknown or stands twice, or a lower bound is not below the upper one.
    """

    names: tuple[str, ...] = FORCE_COLUMNS
    ranges: tuple[Range, ...] = PAPER_FORCE_RANGE_N

    def __post_init__(self) -> None:
        if self.names:
            check_names(self.names)
        for name, (low, high) in zip(self.names, self.ranges, strict=True):
            if not (np.isfinite([low, high]).all() and low < high):
                raise ValueError(
                    f"range of {name} is [{low:g}, {high:g}]: the lower bound must be below the upper"
                )

    @classmethod
    def of(cls, ranges: Mapping[str, Iterable[float]]) -> "Labels":
        """Return the labels with these ranges by name."""
        return cls(tuple(ranges), tuple((float(low), float(high)) for low, high in ranges.values()))

    @property
    def low(self) -> np.ndarray:
        """Lower bounds (k,)."""
        return np.array(self.ranges, float).reshape(-1, 2)[:, 0]

    @property
    def high(self) -> np.ndarray:
        """Upper bounds (k,)."""
        return np.array(self.ranges, float).reshape(-1, 2)[:, 1]

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Symbol and unit of each label."""
        return tuple(QUANTITIES[name] for name in self.names)

    def __len__(self) -> int:
        return len(self.names)

    def __str__(self) -> str:
        """Return the ranges as --range takes them."""
        ranges = zip(self.names, self.ranges, strict=True)
        return " ".join(f"{name}={low:g}:{high:g}" for name, (low, high) in ranges)


def check_names(names: Iterable[str]) -> None:
    """Raise a ValueError unless these are different labels, one at least."""
    names = tuple(names)
    if not names:
        raise ValueError(f"no label was named; known labels: {', '.join(QUANTITIES)}")
    for name in names:
        if name not in QUANTITIES:
            raise ValueError(unknown_name("label", name, QUANTITIES, "known labels"))
    if len(set(names)) < len(names):
        raise ValueError(f"labels {', '.join(names)}: one stands twice")


def known_labels(columns: Iterable[str]) -> tuple[str, ...]:
    """Return those of some columns that are labels."""
    columns = set(columns)
    return tuple(name for name in QUANTITIES if name in columns)


def usual_labels(columns: Iterable[str]) -> tuple[str, ...]:
    """Return which columns are labels unless others are named: the force's axes, or without any all that there are."""
    known = known_labels(columns)
    return tuple(name for name in known if name in FORCE_COLUMNS) or known


def hull(ranges: Iterable[Range | None]) -> Range | None:
    """Return the range that spans all given ones; None if there is none."""
    known = [own for own in ranges if own is not None]
    return (min(low for low, _ in known), max(high for _, high in known)) if known else None


def covering(values: np.ndarray, start: Range | None) -> Range:
    """Return a range that covers all finite values: `start`, with its bounds moved to the next 0.1 where it does not.

    Without a range to start from both bounds are found, and are never equal.
    """
    values = values[np.isfinite(values)]
    lowest, highest = start or ((values.min(), values.max()) if len(values) else (0.0, 0.0))
    low = float(np.floor(values.min(initial=lowest) * _PER_UNIT) / _PER_UNIT)
    high = float(np.ceil(values.max(initial=highest) * _PER_UNIT) / _PER_UNIT)
    if start is None:
        return (low, high) if low < high else (low - 1 / _PER_UNIT, high + 1 / _PER_UNIT)
    return low if (values < lowest).any() else lowest, high if (values > highest).any() else highest
