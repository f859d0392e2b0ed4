"""Tables as people write them: columns found by the names that are usual, cells checked row by row."""

import csv
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from gelgap.assets.names import quoted

# Names under which people write the same thing; letters and digits alone count.
PICTURE_NAMES = ("image", "file", "filename", "path", "picture", "frame", "img", "imagepath", "imagefile")
NUMBERS = {
    **{f"f{axis}_n": (f"f{axis}", f"f{axis}n", f"force{axis}", f"force{axis}n") for axis in "xyz"},
    **{f"m{axis}_nmm": (f"m{axis}", f"m{axis}nmm", f"torque{axis}", f"torque{axis}nmm") for axis in "xyz"},
    "x_mm": ("xmm", "x"),
    "y_mm": ("ymm", "y"),
    "depth_mm": ("depthmm", "depth"),
    "time_s": ("times",),
}
WHOLE_NUMBERS = {"contact_class": ("contactclass", "class", "label"), "point_id": ("pointid", "point")}
GROUPS = {"clip": ("clip",), "object": ("object",), "session": ("session",)}
TEXTS = GROUPS | {"split": ("split",), "reference": ("reference",), "picture": PICTURE_NAMES}
COLUMNS = NUMBERS | WHOLE_NUMBERS | TEXTS
# What people and programs write where there is no value.
EMPTY = ("", "-", "nan", "na", "n/a", "#n/a", "null", "none")


def read_table(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV table by the names of its columns, without spaces around names and values."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            header = reader.fieldnames or ()
            if len(header) == 1 and any(mark in header[0] for mark in ";\t"):
                raise ValueError(
                    f"{path} has no comma in its header {quoted(header[0])}: separate columns by commas"
                )
            return [
                {name.strip(): (value or "").strip() for name, value in row.items() if name is not None}
                for row in reader
            ]
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not a CSV table in UTF-8: {error}") from None


def known_columns(
    table: Path, wanted: Iterable[str] = COLUMNS, needed: Iterable[str] = ()
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return the wanted columns that a table has, (n,) each by our name, and sentences on what is unusual about them.

    Where a cell has no value, a number is NaN, that of a class or point −1. A column without any value is left out, and
    so is one that holds something else than its name says, unless it is needed.

    Raises
    ------
    ValueError
        If there is no row, a cell is not what its column needs, or a needed column is absent.
    """
    rows = read_table(table)
    if not rows:
        raise ValueError(f"{table} has no rows")
    found: dict[str, np.ndarray] = {}
    notes: list[str] = []
    unread = dict.fromkeys(name for name in rows[0] if name)
    for ours in wanted:
        theirs = next((name for name in rows[0] if name and plain_name(name) in COLUMNS[ours]), None)
        if theirs is None:
            continue
        unread.pop(theirs)
        values, where = [row[theirs] for row in rows], f"{table}, column {theirs!r}"
        if ours in TEXTS:
            if ours in GROUPS and not all(values):
                raise ValueError(f"{where}: every row must hold a name")
            found[ours] = np.array(values, dtype=object)
            continue
        numbers = _numbers(values, where)
        lacking = int(np.isnan(numbers).sum())
        if lacking == len(numbers):
            notes.append(f"no row has a value of {theirs!r}: the column is left out")
            continue
        if lacking:
            notes.append(f"{lacking} of {len(numbers)} rows have no value of {theirs!r}")
        found[ours] = numbers if ours in NUMBERS else whole_numbers(numbers, where)
    if missing := [name for name in needed if name not in found]:
        raise ValueError(
            f"{table} must have the column {missing[0]}; it has {', '.join(name for name in rows[0] if name)}"
        )
    if unread:
        notes.append(f"columns that are not read: {', '.join(unread)}")
    return found, notes


def _numbers(values: list[str], where: str) -> np.ndarray:
    """Return numbers (n,), NaN where a cell has no value."""
    numbers = np.full(len(values), np.nan)
    for row, value in enumerate(values):
        if value.lower() in EMPTY:
            continue
        try:
            numbers[row] = float(value)
        except ValueError:
            numbers[row] = np.inf
        if np.isinf(numbers[row]):
            raise ValueError(
                f"{where}: every row must hold a finite number or nothing, and row {row + 1} below the header holds "
                f"{quoted(value)}"
            )
    return numbers


def whole_numbers(numbers: np.ndarray, where: str) -> np.ndarray:
    """Return numbers (n,) as integers, −1 where one is NaN."""
    numbers = np.nan_to_num(numbers, nan=-1)
    if not (np.abs(numbers) < 2**31).all():
        raise ValueError(f"{where}: every row must hold a whole number")
    return numbers.astype(np.int64)


def plain_name(name: str) -> str:
    return "".join(letter for letter in name.lower().split("(")[0] if letter.isalnum())
