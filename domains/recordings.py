"""A user's recordings: clips as videos or folders of pictures, and for each a table of times and forces.

The folder holds for each clip `<clip>.csv` with `time_s` and labels by the names of a picture folder (`fz_n`, …), and
`<clip>.mp4` (or another video) or `<clip>/` with pictures and a table `picture, time_s` of its own.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from gelgap.assets.names import stays_inside
from gelgap.domains.clip import Clip, pressing_n
from gelgap.domains.clip_names import object_of
from gelgap.domains.labels import FORCE_COLUMNS, known_labels
from gelgap.domains.picture_codec import as_colour, decode_picture
from gelgap.domains.stored import read_table
from gelgap.domains.video import VIDEOS, video_pictures, video_times_s

_LAYOUT = (
    "expected for each clip a table of times and forces (press.csv with time_s, fz_n) beside a video (press.mp4) or a "
    "folder of pictures (press/) with a table picture, time_s in it"
)
_TIME = "time_s"
_LAGS = range(-15, 16)


def recorded_clips(folder: Path) -> Iterator[Clip]:
    """Yield the clips of a folder; the folder is their session.

    Raises
    ------
    ValueError
        If the folder holds no clips, or one of its files is not as it should be.
    """
    tables = sorted(folder.glob("*.csv"))
    if not tables:
        raise ValueError(f"{folder} holds no recordings: {_LAYOUT}")
    return (_clip(table) for table in tables)


def _clip(table: Path) -> Clip:
    label_time_s, labels = _labels(table)
    source = _source(table)
    if source.is_dir():
        names, time_s = _picture_times(source)
        pictures = partial(_pictures, source, names)
    else:
        time_s, pictures = video_times_s(source), partial(video_pictures, source)
    return Clip(
        name=table.stem,
        object=object_of(table.stem),
        session=table.parent.resolve().name,
        pictures=pictures,
        time_s=_increasing(time_s, source),
        label_time_s=_increasing(label_time_s, table),
        labels=labels,
        lags=_LAGS,
    )


def _source(table: Path) -> Path:
    """Return the video or the folder of pictures that belongs to a table."""
    beside = [table.with_suffix(suffix) for suffix in ("", *VIDEOS)]
    found = [path for path in beside if path.exists()]
    if len(found) != 1:
        many = f" has several: {', '.join(path.name for path in found)}" if found else " has no pictures"
        raise ValueError(f"the clip of {table}{many}; {_LAYOUT}")
    return found[0]


def _labels(table: Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    rows = read_table(table)
    header = list(rows[0]) if rows else []
    names = known_labels(header)
    if _TIME not in header or not set(names) & set(FORCE_COLUMNS):
        raise ValueError(
            f"{table} must have the column {_TIME} and one of {', '.join(FORCE_COLUMNS)} at least; "
            f"it has {', '.join(header)}"
        )
    time_s, *values = (_numbers(rows, name, table) for name in (_TIME, *names))
    labels = dict(zip(names, values, strict=True))
    pressed_n = pressing_n(labels)
    if pressed_n.max() < -pressed_n.min():
        raise ValueError(
            f"{table}: fz_n reaches {-pressed_n.min():.3g} N and no less than {-pressed_n.max():.3g} N; in compression "
            "Fz must be negative (the force of the indenter on the sensor): turn its sign"
        )
    return time_s, labels


def _numbers(rows: list[dict[str, str]], name: str, table: Path) -> np.ndarray:
    try:
        values = np.array([float(row[name]) for row in rows])
    except ValueError:
        values = np.array([np.nan])
    if not np.isfinite(values).all():
        raise ValueError(f"{table}, column {name!r}: every row must hold a finite number")
    return values


def _picture_times(folder: Path) -> tuple[list[str], np.ndarray]:
    tables = sorted(folder.glob("*.csv"))
    rows = read_table(tables[0]) if len(tables) == 1 else []
    if not rows or not {"picture", _TIME} <= rows[0].keys():
        raise ValueError(f"{folder} must hold one table with the columns picture, {_TIME}")
    names = [row["picture"] for row in rows]
    if wrong := [name for name in names if not stays_inside(name) or not (folder / name).is_file()]:
        raise ValueError(f"{tables[0]} names the picture {wrong[0]!r}, which is not in {folder}")
    return names, _numbers(rows, _TIME, tables[0])


def _pictures(folder: Path, names: list[str]) -> Iterator[np.ndarray]:
    for name in names:
        try:
            yield as_colour(decode_picture((folder / name).read_bytes()))
        except ValueError as error:
            raise ValueError(f"{folder / name} is not readable: {error}") from None


def _increasing(time_s: np.ndarray, source: Path) -> np.ndarray:
    if (np.diff(time_s) <= 0).any():
        row = int(np.argmax(np.diff(time_s) <= 0)) + 1
        raise ValueError(f"{source}: times must increase; that of row {row} does not")
    return time_s
