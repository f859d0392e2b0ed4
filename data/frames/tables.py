"""Tables as people write them: columns found by usual names, units converted to gelgap's, cells checked row by row."""

import codecs
import csv
import io
import re
from collections.abc import Collection, Iterable
from pathlib import Path

import numpy as np

from gelgap.assets.image_file import SUFFIXES
from gelgap.assets.names import quoted
from gelgap.assets.toml_file import named_in_errors
from gelgap.data.frames.labels import QUANTITIES, known_labels

MOST_BYTES = 2**28

# Names under which people write the same thing; case does not count, nor what stands between their parts.
NUMBERS = {
    "fx_n": ("f x", "force x", "x force"),
    "fy_n": ("f y", "force y", "y force"),
    "fz_n": ("f z", "force z", "z force"),
    "mx_nmm": ("m x", "t x", "torque x", "moment x", "x torque"),
    "my_nmm": ("m y", "t y", "torque y", "moment y", "y torque"),
    "mz_nmm": ("m z", "t z", "torque z", "moment z", "z torque"),
    "x_mm": ("x",),
    "y_mm": ("y",),
    "depth_mm": ("depth",),
    "time_s": ("times", "time stamps", "ts", "time stamp", "time", "stamp", "t"),
}
WHOLE_NUMBERS = {
    "contact_class": ("contact class", "class", "label"),
    "point_id": ("point id", "point"),
    "trajectory_id": ("trajectory id", "trajectory"),
    "step": ("step",),
}
GROUPS = {"clip": ("clip",), "object": ("object",), "session": ("session",)}
TEXTS = GROUPS | {
    "split": ("split",),
    "reference": ("reference",),
    "picture": ("image", "picture", "frame", "img", "file", "path",
                "image path", "image file", "image name", "img path", "file path", "file name"),
}  # fmt: skip
COLUMNS = NUMBERS | WHOLE_NUMBERS | TEXTS
# Parts of a time in ROS: `header.stamp.sec` and `.nanosec`, in ROS 1 `secs` and `nsecs`.
_PART_OF_STAMP = re.compile(r"(?:.*[./_])?(nanosecs?|nsecs?|secs?)", re.IGNORECASE)
# What a table without labels may hold as such: one force of several axes, or of none that is known.
_FORCE_LIKE = re.compile(r"(?<![a-z])(forces?|kraft|wrench|ft|load|f[\W_]?[xyzn]?)(?![a-z])", re.IGNORECASE)
# Programs name what an axis belongs to before it: `wrench.force.z`, `/ft/wrench/force/z`, `Force.Fz`.
_OF_ROS = re.compile(r"(wrench|torque)[./_]*(torque)?[./]", re.IGNORECASE)
_BEFORE_AXIS = r"(?:(?:.*\W)?(?:wrench|force|torque|ft)[./])?"

UNITS = {
    "N": {"N": 1, "mN": 1e-3, "cN": 1e-2, "µN": 1e-6, "kN": 1e3,
          "g": 9.80665e-3, "kg": 9.80665, "lb": 4.4482216, "oz": 0.27801385},
    "N·mm": {"N·mm": 1, "N·m": 1e3, "N·cm": 10, "mN·m": 1, "mN·mm": 1e-3, "kg·cm": 98.0665,
             "in·lb": 112.98483, "lb·in": 112.98483, "in·oz": 7.0615518, "oz·in": 7.0615518},
    "mm": {"mm": 1, "cm": 10, "m": 1e3, "µm": 1e-3, "nm": 1e-6, "in": 25.4, "inch": 25.4},
    "s": {"s": 1, "ms": 1e-3, "µs": 1e-6, "ns": 1e-9, "min": 60},
}  # fmt: skip
"""What one of each unit is in gelgap's."""
_LONG_UNITS = {
    "newton": "n", "newtons": "n", "grams": "g", "inches": "in", "microns": "um",
    "sec": "s", "second": "s", "seconds": "s", "msec": "ms", "usec": "us",
}  # fmt: skip
_UNIT = r"\s*(?:[(\[{<](?P<bracketed>.*)[)\]}>]|[/,](?P<listed>.+)|(?P<gap>[\s_.-]*)(?:in[\s_]+)?(?P<appended>.+))?"
# What people and programs write where there is no value.
EMPTY = ("", "-", "nan", "na", "n/a", "#n/a", "#nv", "null", "none")
# Times without a unit are seconds if they are closer than this; milliseconds of a log at 1 kHz are 1 apart.
_LONGEST_LIKELY_STEP_S = 0.5
_LARGEST_LIKELY_N = 150.0

_COMMENTS = re.compile(r'\A(?:\s*"?(?:#|sep=).*\n)+')
_SEPARATOR = re.compile("[,;\t]")
_NUMBER = re.compile(r"[-+−]?(?:\d+|\d*([.,])\d+)(?:[eE][-+]?\d+)?")
_WHOLE, _LIKE_THOUSANDS = re.compile(r"[-+−]?[1-9]\d*"), re.compile(r"[-+−]?[1-9]\d{0,2}[.,]\d{3}")


class _UnusableError(ValueError):
    """A column holds something else than its name says."""


def read_table(path: Path) -> list[tuple[str, list[str]]]:
    """Return the columns of a CSV table, (header, cells), without spaces around them.

    Tabs or semicolons separate its columns if the header has one, else commas. It is in UTF-8, or UTF-16 with a mark.
    Comments (`# …`, and Excel's `sep=;`) are skipped, and units in a row below the header are put into it. Where
    tabs or semicolons separate columns, decimal commas are read, unless there are decimal points too.

    Raises
    ------
    ValueError
        If it is too large, no such table, has a row of another length than the header, or 1,000 may be a thousand.
    """
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size >> 20} MiB; at most {MOST_BYTES >> 20} are read")
    data = path.read_bytes()
    is_utf_16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = data.decode("utf-16" if is_utf_16 else "utf-8-sig")
        if "\0" in text:
            raise csv.Error("it holds zero bytes, as UTF-16 without a mark does")
        text = _without_comments(text)
        separator = next((mark for mark in "\t;" if mark in text.partition("\n")[0]), ",")
        lines = csv.reader(io.StringIO(text, newline=""), delimiter=separator, skipinitialspace=True)
        rows = [row for row in ([cell.strip() for cell in line] for line in lines) if any(row)]
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not a CSV table in UTF-8 (Excel's 'CSV UTF-8'): {error}") from None
    if len(rows) < 2:
        raise ValueError(f"{path} has no rows")
    header = [name.removeprefix("%") for name in rows.pop(0)]  # `rostopic echo -p` writes %time
    if len(header) == 1 and len(rows[0]) == 1 and re.search(r"[|\s][-+\d.]+$", rows[0][0]):
        raise ValueError(
            f"{path}: commas, semicolons or tabs must separate columns; its header is {quoted(header[0])}"
        )
    # A comment has another number of cells, or nothing but empty ones behind it.
    width = len(header)
    rows = [row for row in rows if row[0][:1] != "#" or (len(row) == width and (width == 1 or any(row[1:])))]
    for number, row in enumerate(rows, 1):
        if len(row) < len(header) or any(row[len(header) :]):
            raise ValueError(
                f"{path}: row {number} below the header has {len(row)} cells, and the header {len(header)}; the first "
                "line is the header, numbers are written with a decimal point, and texts with a comma in quotes"
            )
    if separator != ",":
        rows = _with_decimal_points(header, rows)
    if len(rows) > 1 and (of_columns := _row_of_units(rows[0])):
        header = [
            f"{name} ({unit})" if unit else name for name, unit in zip(header, of_columns, strict=False)
        ]
        del rows[0]
    return [(name, [row[place] for row in rows]) for place, name in enumerate(header)]


def _without_comments(text: str) -> str:
    """Return a table without the comments above its header, which itself may be one, as numpy.savetxt writes it."""
    found = _COMMENTS.match(text)
    if found is None:
        return text
    rows = text[found.end() :]
    last = found[0].rstrip().rpartition("\n")[2].lstrip("#% ")
    names, first = (_SEPARATOR.split(row) for row in (last, rows.partition("\n")[0]))
    is_header = len(names) == len(first) > 1 and any(_NUMBER.fullmatch(cell.strip()) for cell in first)
    return f"{last}\n{rows}" if is_header else rows


def _with_decimal_points(header: list[str], rows: list[list[str]]) -> list[list[str]]:
    """Return rows with points in numbers for decimal commas; as they are if some have points.

    A ValueError if no mark is surely a decimal one, and there are commas, or points in a column with whole numbers.
    """
    marked = {cell for row in rows for cell in row if (found := _NUMBER.fullmatch(cell)) and found[1]}
    if all(map(_LIKE_THOUSANDS.fullmatch, marked)):
        for name, cells in zip(header, zip(*rows, strict=False), strict=False):
            cell = next((cell for cell in cells if cell in marked), "")
            if "," in cell or (cell and any(map(_WHOLE.fullmatch, cells))):
                two = f"{re.sub('[.,]', '', cell)} or {cell.replace(',', '.')}0"
                raise ValueError(f"column {name!r}: {quoted(cell)} may be a thousand or not: write {two}")
    if any("." in cell for cell in marked):
        return rows
    return [[cell.replace(",", ".") if cell in marked else cell for cell in row] for row in rows]


def _row_of_units(row: list[str]) -> list[str] | None:
    """Return the units in a row that holds nothing else; None for another row."""
    units = [cell.strip("()[]{}<>-") for cell in row]
    known = {_plain_unit(unit) for of_one in UNITS.values() for unit in of_one}
    return units if any(units) and all(_plain_unit(unit) in known for unit in units if unit) else None


def known_columns(
    table: Path, wanted: Iterable[str] = COLUMNS, needed: Collection[str] = ()
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return the wanted columns that a table has, (n,) each by our name, and sentences on what is unusual about them.

    Units that headers state are converted. Where a cell has no value, a number is NaN, that of a class or point −1. A
    column without any value is left out, and so is one that holds something else than its name says, unless it is
    needed or the only label.

    Raises
    ------
    ValueError
        If a cell is not what its column needs, a header states an unknown unit, two headers mean the same label, or a
        needed column is absent; the message names the header and the row.
    """
    with named_in_errors(table):
        return _known_columns(_with_whole_stamps(read_table(table)), wanted, needed)


def _with_whole_stamps(columns: list[tuple[str, list[str]]]) -> list[tuple[str, list[str]]]:
    """Return columns with seconds and nanoseconds of a stamp, as ROS writes them, made one of nanoseconds."""
    seconds: int | None = None
    nanoseconds: int | None = None
    for place, (header, cells) in enumerate(columns):
        part = _PART_OF_STAMP.fullmatch(header)
        if part is None or not all(cell.isdigit() for cell in cells):
            continue
        if part[1].lower().startswith("n"):
            nanoseconds = place
        else:
            seconds = place
    has_time = any(_unit(name, COLUMNS["time_s"], "s") is not None for name, _ in columns)
    if seconds is None or nanoseconds is None or has_time:
        return columns
    pairs = zip(columns[seconds][1], columns[nanoseconds][1], strict=True)
    stamps = [str(int(whole) * 10**9 + int(part)) for whole, part in pairs]
    others = [column for place, column in enumerate(columns) if place not in (seconds, nanoseconds)]
    return [("time_ns", stamps), *others]


def _known_columns(
    columns: list[tuple[str, list[str]]], wanted: Iterable[str], needed: Collection[str]
) -> tuple[dict[str, np.ndarray], list[str]]:
    found: dict[str, np.ndarray] = {}
    unusable: dict[str, str] = {}
    notes: list[str] = []
    without_unit: dict[str, str] = {}
    unread = [header for header, _ in columns if header]
    for ours in wanted:
        usable = []
        for header, cells in columns:
            unit = _unit(header, COLUMNS[ours], _own_unit(ours))
            if unit is None:
                continue
            unread = [other for other in unread if other != header]
            if all(cell.lower() in EMPTY for cell in cells):
                notes.append(f"no row has a value of {header!r}: the column is left out")
                continue
            try:
                usable.append((header, unit, _values(ours, header, cells, unit)))
            except _UnusableError as problem:
                unusable[ours] = str(problem)
        if len(usable) > 1:
            named_alike = " and ".join(repr(header) for header, *_ in usable)
            unusable[ours] = f"the columns {named_alike} mean the same, {ours}: take one out, or rename it"
            if ours in QUANTITIES:
                raise ValueError(unusable[ours])
        for header, unit, values in usable[:1] if len(usable) == 1 else ():
            found[ours] = values
            if ours not in NUMBERS:
                continue
            if lacking := int(np.isnan(values).sum()):
                notes.append(f"{lacking} of {len(values)} rows have no value of {header!r}")
            if not unit and _own_unit(ours) == "N·mm" and _OF_ROS.search(header):
                found[ours] = values * UNITS["N·mm"]["N·m"]
                notes.append(f"{header!r} is converted to N·mm: torques of ROS are in N·m")
            elif not unit:
                without_unit[header] = _own_unit(ours)
            elif UNITS[_own_unit(ours)][unit] != 1:
                notes.append(f"{header!r} is converted to {_own_unit(ours)}")
            largest = np.nanmax(np.abs(values))
            if _own_unit(ours) == "N" and largest > _LARGEST_LIKELY_N:
                notes.append(f"{header!r} reaches {largest:g} N, beyond any sensor: is it mN, or no reading?")
    for name in needed:
        if name not in found:
            there = ", ".join(header for header, _ in columns if header)
            raise ValueError(unusable.get(name, f"the column {name} is needed; there are {there}"))
    if not known_labels(found):
        _check_unlabelled(unusable, unread)
    notes += [f"{problem}; not read" for problem in unusable.values()]
    for unit in dict.fromkeys(without_unit.values()):
        headers = [header for header, taken in without_unit.items() if taken == unit]
        notes.append(
            f"no unit is stated: {', '.join(headers)} {'are' if headers[1:] else 'is'} read in {unit}"
        )
    if unread:
        notes.append(f"columns that are not read: {', '.join(unread)}")
    return found, notes


def _check_unlabelled(unusable: dict[str, str], unread: Iterable[str]) -> None:
    """Raise a ValueError if a table without a usable label has a column that was meant as one."""
    for name in known_labels(unusable):
        raise ValueError(unusable[name])
    for header in unread:
        if _FORCE_LIKE.search(header):
            raise ValueError(
                f"column {header!r} does not say which axis of the force it is: write a column for each that was "
                "measured, fx_n, fy_n, fz_n in N (pressing gives a negative fz_n), or take it out"
            )


def _own_unit(ours: str) -> str:
    return QUANTITIES[ours].unit if ours in QUANTITIES else "s" if ours == "time_s" else ""


def _unit(header: str, names: Iterable[str], own_unit: str) -> str | None:
    """Return the unit that a header states, a key of `UNITS[own_unit]` or another name, empty where it states none.

    None if it is none of the names. `Fz [mN]`, `Force Z, mN`, `fz/mN`, `Fz_mN` and `FzmN` state one.

    Raises
    ------
    ValueError
        If the unit is unknown, or one of another quantity.
    """
    # Longest first: `time stamp` is no `time` with a unit.
    any_name = "|".join(name.replace(" ", r"[\W_]*") for name in sorted(names, key=len, reverse=True))
    before = _BEFORE_AXIS if own_unit.startswith("N") else ""
    stated = re.fullmatch(f"{before}(?:{any_name}){_UNIT}", header, re.IGNORECASE)
    if stated is None:
        return None
    told = stated["bracketed"] or stated["listed"] or stated["appended"] or ""
    known = {_plain_unit(unit): unit for unit in UNITS.get(own_unit, ())}
    if not told or _plain_unit(told) in known:
        return known.get(_plain_unit(told), "")
    is_unit = stated["gap"] and _row_of_units([told])
    if not known or (stated["appended"] and not is_unit):
        return None
    raise ValueError(f"column {header!r} states the unit {told!r}: known are {', '.join(UNITS[own_unit])}")


def _plain_unit(told: str) -> str:
    """Return a unit in lower case, without what stands between its parts and without the f of gf, kgf, lbf, ozf."""
    plain = re.sub(r"[\s·⋅*.^_-]", "", told.lower().replace("µ", "u").replace("μ", "u"))
    return _LONG_UNITS.get(plain, re.sub("(?<=[gbz])f", "", plain))


def _values(ours: str, header: str, cells: list[str], unit: str) -> np.ndarray:
    """Return the values (n,) of a column.

    Raises
    ------
    _UnusableError, ValueError
        If it holds something else than its name says; if it is broken.
    """
    if ours in TEXTS:
        return _texts(ours, header, cells)
    numbers = _numbers(header, cells)
    if ours in WHOLE_NUMBERS:
        numbers = np.nan_to_num(numbers, nan=-1)
        for row in np.flatnonzero((numbers != np.rint(numbers)) | (np.abs(numbers) >= 2**31)).tolist():
            raise ValueError(
                f"column {header!r}: every row must hold a whole number, and row {row + 1} below the header holds "
                f"{quoted(cells[row])}"
            )
        return numbers.astype(np.int64)
    steps = np.abs(np.diff(numbers[np.isfinite(numbers)]))
    if ours == "time_s" and not unit and len(steps) and np.median(steps) > _LONGEST_LIKELY_STEP_S:
        raise _UnusableError(
            f"column {header!r} states no unit, and its values are {np.median(steps):g} apart, much for seconds: state "
            "the unit, as in time_s or time_ns"
        )
    return numbers * UNITS[_own_unit(ours)].get(unit, 1)


def _texts(ours: str, header: str, cells: list[str]) -> np.ndarray:
    for row, cell in enumerate(cells, 1):
        held = quoted(cell) if cell else "nothing"
        if ours == "picture" and Path(cell).suffix.lower() not in SUFFIXES:
            raise _UnusableError(
                f"column {header!r}: row {row} below the header holds {held}, and names of pictures end in "
                f"{', '.join(SUFFIXES)}"
            )
        if not cell:
            kind = ValueError if ours == "reference" else _UnusableError
            raise kind(
                f"column {header!r}: every row must hold a name, and row {row} below the header holds {held}"
            )
    return np.array([cell.replace("\\", "/") for cell in cells] if ours == "picture" else cells, dtype=object)


def _numbers(header: str, cells: list[str]) -> np.ndarray:
    """Return numbers (n,), NaN where a cell has no value."""
    numbers = np.full(len(cells), np.nan)
    wrong = {}
    for row, cell in enumerate(cells):
        if cell.lower() in EMPTY:
            continue
        try:
            numbers[row] = float(cell.replace("−", "-"))
        except ValueError:
            wrong[row] = cell
        if np.isinf(numbers[row]):
            wrong[row] = cell
    for row, cell in wrong.items():
        remedy = "; write a decimal point, and no commas between thousands" if "," in cell else ""
        kind = _UnusableError if np.isnan(numbers).all() else ValueError
        raise kind(
            f"column {header!r}: every row must hold a finite number or nothing, and row {row + 1} below the header "
            f"holds {quoted(cell)}{remedy}"
        )
    return numbers


def plain_name(name: str) -> str:
    return "".join(letter for letter in name.lower() if letter.isalnum())
