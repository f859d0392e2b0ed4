"""Writing a folder of PNG pictures with one CSV table, as gelgap's reader of picture folders takes it."""

import csv
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np

from gelgap.domains.picture_codec import encode_png

TABLE = "frames.csv"


@dataclass(frozen=True)
class PictureRow:
    """One row of the table: a picture, its reference, what was measured, and where it comes from.

    Pictures are paths inside the folder. Forces are those of the indenter on the sensor, Fz ≤ 0 in compression; x
    points right and y down, from the picture's centre. What is None in all rows has no column.
    """

    picture: str
    reference: str | None = None
    fx_n: float | None = None
    fy_n: float | None = None
    fz_n: float | None = None
    mx_nmm: float | None = None
    my_nmm: float | None = None
    mz_nmm: float | None = None
    x_mm: float | None = None
    y_mm: float | None = None
    depth_mm: float | None = None
    clip: str | None = None
    object: str | None = None
    session: str | None = None
    time_s: float | None = None
    split: str | None = None


COLUMNS = tuple(field.name for field in fields(PictureRow))


def write_picture(folder: Path, name: str, picture: np.ndarray) -> str:
    """Write a picture (h, w, 3) as PNG below the folder and return its name."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(encode_png(picture))
    return name


def write_picture_table(folder: Path, rows: Sequence[PictureRow]) -> None:
    """Write the folder's table.

    Raises
    ------
    ValueError
        If there are no rows, or a column has a value in some rows only.
    """
    if not rows:
        raise ValueError(f"{folder.name}: no frame is left to be written")
    given = np.array([[value is not None for value in astuple(row)] for row in rows])
    if partly := [name for name, own in zip(COLUMNS, given.T, strict=True) if own.any() and not own.all()]:
        raise ValueError(
            f"{folder.name}: only some frames have {', '.join(partly)}; all or none must have them"
        )
    kept = [name for name, own in zip(COLUMNS, given.T, strict=True) if own.all()]
    with (folder / TABLE).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(kept)
        writer.writerows([_cell(getattr(row, name)) for name in kept] for row in rows)


def _cell(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.7g}"
