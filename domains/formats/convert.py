"""Recordings of a real sensor made into picture folders: pictures in time, and forces measured beside them.

The folder holds for each clip `<clip>.csv` with `time_s` and labels by the names of a picture folder (`fz_n`, …), and
`<clip>.mp4` (or another video) or `<clip>/` with pictures and a table `picture, time_s` of its own. The two clocks
differ by a lag that no file states. It is estimated from the clip alone, by cross-correlation: at which lag does the
change of the pictures go best with the force? No model is trained for it, and no other clip is used.
"""

import logging
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import groupby, islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from gelgap.assets.image_file import read_image
from gelgap.assets.names import is_plain_name
from gelgap.domains.formats.domain_folder import new_folder
from gelgap.domains.formats.pictures import encode_png, resized
from gelgap.domains.frames.folders import picture_path
from gelgap.domains.frames.labels import FORCE_COLUMNS, QUANTITIES, known_labels
from gelgap.domains.frames.tables import GROUPS, known_columns

if TYPE_CHECKING:
    from cv2 import VideoCapture

LOG = logging.getLogger(__name__)
CONTACT_N = 0.3
"""What is pressed harder than this is in contact."""
TABLE = "frames.csv"
COLUMNS = ("picture", "reference", *QUANTITIES, *GROUPS, "time_s", "split")
"""What a row of the table may hold. Pictures are paths inside the folder; forces are those on the sensor."""
VIDEOS = (".avi", ".mp4", ".mov", ".mkv", ".webm")
_LAYOUT = (
    "expected for each clip a table of times and forces (press.csv with time_s, fz_n) beside a video (press.mp4) or a "
    "folder of pictures (press/) with a table picture, time_s in it"
)
_LAGS = range(-15, 16)
_REFERENCE_FRAMES = 5
_FEWEST_FRAMES = 10
_SIGNAL_PX = (80, 60)
_NUMBER = re.compile(r"[\s_-]*(t=)?\d+$")


@dataclass(frozen=True)
class ConvertedClip:
    """What became of one clip, or of one series of presses.

    `pictures` and `in_contact` count pictures of the recording, `dropped` errors of the gauge and wrong marks,
    `written` rows of the new table. The lag is in frames, positive where forces trail pictures; the correlation of
    pictures and force there and at lag 0 says how sure it is. It is None where nothing is measured in time.
    """

    domain: str
    session: str
    name: str
    pictures: int
    in_contact: int
    dropped: int
    written: int
    reference_rgb: tuple[float, float, float]
    lag: int | None = None
    correlation: float | None = None
    correlation_at_0: float | None = None
    lag_at_limit: bool = False
    begins_in_contact: bool = False


@dataclass(frozen=True)
class Selection:
    """What is written of a clip: its facts, its reference (h, w, 3), and its pictures.

    `pictures` gives all of them (h, w, 3) uint8 from the first, each time that it is called. `table` has a row for each
    that is written, its number as index, with labels, `clip`, `object` and, where it is known, `time_s`.
    """

    facts: ConvertedClip
    reference: np.ndarray
    pictures: Callable[[], Iterable[np.ndarray]]
    table: pd.DataFrame


Layout = Callable[[Path, int], Iterable[Selection]]
"""Reads what is in a folder, the recordings of a domain one after the other; selects every n-th picture in contact."""


def convert(
    folder: Path | str, layout: str | Layout, out_dir: Path | str, every: int = 1
) -> tuple[ConvertedClip, ...]:
    """Write recordings as picture folders, one a domain, below a new folder, and return what became of each clip.

    Of the pictures in contact every n-th is written (n = `every`), and the few before that make a clip's reference.
    The layout is `recordings`, a user's folder, or a function of the folder and n that reads another one:
    `gelgap.benchmarks.real.published_sets.LAYOUTS` has those of two public repositories, by name.

    Raises
    ------
    ValueError
        If the layout is unknown, the folder has another, a file of it is not as it should be, a clip is too short, its
        clocks have no time in common, its force or pictures do not change, or the output exists.
    """
    if isinstance(layout, str):
        if layout not in LAYOUTS:
            raise ValueError(f"layout {layout!r} is unknown; known layouts: {', '.join(LAYOUTS)}")
        layout = LAYOUTS[layout]
    with new_folder(Path(out_dir)) as building:
        return tuple(_write(layout(Path(folder), every), building))


def _write(selections: Iterable[Selection], out_dir: Path) -> Iterator[ConvertedClip]:
    """Write what is selected, a folder for each domain, and yield the facts of each clip."""
    for domain, members in groupby(selections, key=lambda own: own.facts.domain):
        if not is_plain_name(domain):
            raise ValueError(f"the session's name {domain!r} is not one of a folder")
        tables = []
        for own in members:
            facts, folder = own.facts, out_dir / domain / own.facts.name
            LOG.info("writing %s/%s", facts.session, facts.name)
            folder.mkdir(parents=True)
            (folder / "reference.png").write_bytes(encode_png(own.reference))
            for number, picture in enumerate(own.pictures()):
                if number in own.table.index:
                    (folder / f"{number:05d}.png").write_bytes(encode_png(picture))
            places = {
                "picture": [f"{facts.name}/{number:05d}.png" for number in own.table.index],
                "reference": f"{facts.name}/reference.png",
                "session": facts.session,
            }
            tables.append(own.table.assign(**places))
            yield facts
        write_picture_table(out_dir / domain, pd.concat(tables))


def write_picture_table(folder: Path, table: pd.DataFrame) -> None:
    """Write the table of a picture folder, a row for each picture; columns are those of `COLUMNS` that it has."""
    if table.empty:
        raise ValueError(f"{folder.name}: no frame is left to be written")
    kept = table[[name for name in COLUMNS if name in table]].dropna(axis="columns", how="all")
    if partly := kept.columns[kept.isna().any()].tolist():
        raise ValueError(
            f"{folder.name}: only some frames have {', '.join(partly)}; all or none must have them"
        )
    kept.to_csv(folder / TABLE, index=False, float_format="%.7g", lineterminator="\r\n")


@dataclass(frozen=True)
class Clip:
    """One recording: pictures at `time_s` (n,) and labels, each by a clock of its own.

    Attributes
    ----------
    pictures
        Gives all pictures (h, w, 3) uint8 from the first, each time that it is called.
    labels
        What was measured, by the time in s as index: columns by their names, forces among them; NaN where a value is a
        glitch.
    lags
        The lags in frames that are possible, 0 among them; positive where the labels trail the pictures.
    """

    name: str
    session: str
    pictures: Callable[[], Iterable[np.ndarray]]
    time_s: np.ndarray
    labels: pd.DataFrame
    lags: range = _LAGS

    def selected(self, every: int) -> Selection:
        """Find the lag and the reference, and select pictures in contact and those before; its session is a domain."""
        LOG.info("converting %s/%s", self.session, self.name)
        correlations = self._correlations()
        best = int(np.nanargmax(correlations))
        lag = self.lags[best]
        labels = self.labels_at(lag)
        pressed_n, known = _pressing_n(labels), np.isfinite(labels).all(axis=1).to_numpy()
        touches = pressed_n > CONTACT_N
        # The reference is made of the pictures before the contact, less one as a lag may be wrong by one.
        before = int(np.argmax(touches)) if touches.any() else len(touches)
        n_at_rest = min(max(before - 1, 1), _REFERENCE_FRAMES)
        reference = np.median(list(islice(self.pictures(), n_at_rest)), axis=0).round().astype(np.uint8)
        at_rest, in_contact = np.flatnonzero(known & ~touches), np.flatnonzero(known & touches)
        chosen = np.union1d(at_rest[:n_at_rest], in_contact[::every])
        # What was pressed: the name without the number at its end, `golf_ball` of `golf_ball_2`.
        pressed = _NUMBER.sub("", self.name) or self.name
        table = labels.assign(clip=self.name, object=pressed, time_s=self.time_s).iloc[chosen]
        facts = ConvertedClip(
            domain=self.session,
            session=self.session,
            name=self.name,
            pictures=len(self.time_s),
            in_contact=int(touches.sum()),
            dropped=int((~np.isfinite(self.labels)).any(axis=1).sum()),
            written=len(chosen),
            reference_rgb=mean_rgb(reference),
            lag=lag,
            correlation=correlations[best],
            correlation_at_0=correlations[self.lags.index(0)],
            lag_at_limit=lag != 0 and lag in (self.lags[0], self.lags[-1]),
            begins_in_contact=bool(pressed_n[np.isfinite(pressed_n)][0] > CONTACT_N),
        )
        return Selection(facts, reference, self.pictures, table)

    def labels_at(self, lag: int) -> pd.DataFrame:
        """Return the labels of each picture at a lag in frames, interpolated in time.

        NaN where there are none, or the nearest value is NaN or more than half a frame away.
        """
        frame_s = float(np.median(np.diff(self.time_s)))
        time_s, measured_s = self.time_s + lag * frame_s, self.labels.index.to_numpy()
        nearest = np.searchsorted((measured_s[1:] + measured_s[:-1]) / 2, time_s)
        inside = (time_s >= measured_s[0] - frame_s / 2) & (time_s <= measured_s[-1] + frame_s / 2)
        finite, found = np.isfinite(self.labels.to_numpy()), {}
        for known, (name, values) in zip(finite.T, self.labels.items(), strict=True):
            between = np.interp(time_s, measured_s[known], values[known]) if known.any() else np.nan
            found[name] = np.where(known[nearest] & inside, between, np.nan)
        return pd.DataFrame(found)

    def _correlations(self) -> list[float]:
        """Return Pearson's correlation of change and force at each lag; NaN where one of the two is constant."""
        measured_s, n, m = self.labels.index, len(self.time_s), len(self.labels)
        if min(n, m) < _FEWEST_FRAMES:
            raise ValueError(
                f"clip {self.name} has {n} pictures and {m} rows of labels; at least {_FEWEST_FRAMES} of each are "
                "needed"
            )
        if self.time_s[0] > measured_s[-1] or measured_s[0] > self.time_s[-1]:
            raise ValueError(
                f"clip {self.name}: its pictures span {self.time_s[0]:g}…{self.time_s[-1]:g} s, its labels "
                f"{measured_s[0]:g}…{measured_s[-1]:g} s; count both from the same moment"
            )
        pictures = (resized(picture, _SIGNAL_PX).astype(np.int16) for picture in self.pictures())
        first = next(pictures, None)
        change = pd.Series(np.array([0.0, *(np.abs(picture - first).mean() for picture in pictures)]))
        if len(change) != n:
            raise ValueError(f"clip {self.name} has {len(change)} pictures and {n} times of pictures")
        pressed_n = (pd.Series(_pressing_n(self.labels_at(lag))) for lag in self.lags)
        found = [_correlation(change, own) for own in pressed_n]
        if np.isnan(found).all():
            raise ValueError(
                f"clip {self.name}: its force or its pictures do not change, or fewer than {_FEWEST_FRAMES} pictures "
                "have labels; take it out of the folder"
            )
        return found


def _correlation(change: pd.Series, own: pd.Series) -> float:
    """Return the correlation where both are known; NaN for too few, or if one does not change.

    Rounding would decide the latter.
    """
    known = own.notna()
    change, own = change[known], own[known]
    if len(own) < _FEWEST_FRAMES or np.ptp(change) == 0 or np.ptp(own) == 0:
        return float("nan")
    return float(change.corr(own))


def _pressing_n(labels: pd.DataFrame) -> np.ndarray:
    """Return how hard was pressed (n,): −Fz, or the size of what else of the force was measured, N."""
    if "fz_n" in labels:
        return -labels["fz_n"].to_numpy()
    return np.linalg.norm(labels[[name for name in ("fx_n", "fy_n") if name in labels]], axis=1)


def mean_rgb(picture: np.ndarray) -> tuple[float, float, float]:
    red, green, blue = picture.mean(axis=(0, 1)).tolist()
    return red, green, blue


def _recordings(folder: Path, every: int) -> Iterator[Selection]:
    """Select from the clips of a user's folder; the folder is their session."""
    tables = sorted(folder.glob("*.csv"))
    if not tables:
        raise ValueError(f"{folder} holds no recordings: {_LAYOUT}")
    return (_recorded_clip(table).selected(every) for table in tables)


def _recorded_clip(table: Path) -> Clip:
    columns, _ = known_columns(table, ("time_s", *QUANTITIES))
    names = known_labels(columns)
    if "time_s" not in columns or not set(names) & set(FORCE_COLUMNS):
        raise ValueError(
            f"{table} must have the column time_s and one of {', '.join(FORCE_COLUMNS)} at least"
        )
    labels = pd.DataFrame({name: columns[name] for name in names}, columns["time_s"])
    if not np.isfinite(labels).all(axis=None):
        raise ValueError(f"{table}: every label must be a finite number")
    pressed_n = _pressing_n(labels)
    if pressed_n.max() < -pressed_n.min():
        raise ValueError(
            f"{table}: fz_n reaches {-pressed_n.min():.3g} N and no less than {-pressed_n.max():.3g} N; in compression "
            "Fz must be negative (the force of the indenter on the sensor): turn its sign"
        )
    beside = [table.with_suffix(suffix) for suffix in ("", *VIDEOS)]
    sources = [path for path in beside if path.exists()]
    if len(sources) != 1:
        many = f" has several: {', '.join(path.name for path in sources)}" if sources else " has no pictures"
        raise ValueError(f"the clip of {table}{many}; {_LAYOUT}")
    (source,) = sources
    if source.is_dir():
        tables = sorted(source.glob("*.csv"))
        of_pictures, _ = known_columns(tables[0], ("picture", "time_s")) if len(tables) == 1 else ({}, [])
        if not {"picture", "time_s"} <= of_pictures.keys():
            raise ValueError(f"{source} must hold one table with the columns picture, time_s")
        paths = [picture_path(tables[0], name) for name in of_pictures["picture"]]
        time_s = of_pictures["time_s"]
        pictures: Callable[[], Iterable[np.ndarray]] = partial(map, read_image, paths)
    else:
        # 0 is OpenCV's CAP_PROP_POS_MSEC.
        time_s = np.array([video.get(0) / 1000 for video in _grabbed(source)])
        pictures = partial(video_pictures, source)
    for times, place in ((time_s, source), (columns["time_s"], table)):
        if not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
            raise ValueError(f"{place}: times must be finite and increase from row to row")
    return Clip(table.stem, table.parent.resolve().name, pictures, time_s, labels)


def video_pictures(path: Path) -> Iterator[np.ndarray]:
    """Yield the pictures (h, w, 3) uint8 RGB of a video; a ValueError if OpenCV's FFmpeg cannot read it."""
    for video in _grabbed(path):
        done, picture = video.retrieve()
        if not done:
            return
        yield np.ascontiguousarray(picture[..., ::-1])


def _grabbed(path: Path) -> "Iterator[VideoCapture]":
    """Yield a video at each of its pictures, before it is decoded."""
    import cv2

    video = cv2.VideoCapture(str(path.resolve()), cv2.CAP_FFMPEG)
    try:
        if not video.isOpened():
            raise ValueError(f"{path} is not a video that can be read")
        while video.grab():
            yield video
    finally:
        video.release()


LAYOUTS: dict[str, Layout] = {"recordings": _recordings}
"""What is converted, by name."""
