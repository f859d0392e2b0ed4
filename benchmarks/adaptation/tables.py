"""The texts of the adaptation benchmark's tables: numbers, means with their spread, intervals, groups."""

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from gelgap.adapt import ResultTable

AXES = ("x", "y", "z")


def number(value: float, form: str = ".3f", unit: str = "") -> str:
    """Return a number's text, a dash for NaN."""
    return "–" if math.isnan(value) else f"{value:{form}}{unit}"


def numbers(values: Iterable[float], form: str = ".3f", unit: str = "") -> list[str]:
    """Return the texts of some numbers."""
    return [number(value, form, unit) for value in values]


def spread(values: np.ndarray) -> str:
    """Return mean ± standard deviation over seeds; how many are NaN (not run), if any are."""
    good = values[~np.isnan(values)]
    if not len(good):
        return "–"
    text = f"{good.mean():.3f}" + (f" ± {good.std(ddof=1):.3f}" if len(good) > 1 else "")
    return text + (f" ({len(values) - len(good)} missing)" if len(good) < len(values) else "")


def interval(ends: tuple[float, float], form: str = ".3f") -> str:
    """Return an interval's text, a dash for NaN."""
    low, high = ends
    return "–" if math.isnan(low) else f"{low:{form}}…{high:{form}}"


def by_column(
    title: str, first: str, names: Iterable[str], columns: Mapping[str, Sequence[str]], note: str = ""
) -> ResultTable:
    """Return the table whose first column holds names and whose others are given as texts."""
    rows = [list(row) for row in zip(names, *columns.values(), strict=True)]
    return ResultTable(title, [first, *columns], rows, note)


def group_name(group: tuple[str, str]) -> str:
    """Return a group's name, such as "mb0i0 → wmb1i1"."""
    return " → ".join(group)
