"""Recordings of a real sensor made into picture folders: pictures in time, and forces measured beside them.

The folder holds for each clip `<clip>.csv` with `time_s` and labels by the names of a picture folder (`fz_n`, …), and
`<clip>.mp4` (or another video) or `<clip>/` with pictures and a table `picture, time_s` of its own. The two clocks
differ by a lag that no file states. It is estimated from the clip alone, by cross-correlation: at which lag does the
change of the pictures go best with the force? No model is trained for it, and no other clip is used; a user may state
it instead.
"""

import logging
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import groupby, islice
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.assets.image_file import picture_files, read_image, visible_files
from gelgap.assets.names import comma_list, is_plain_name
from gelgap.data.formats.domain_folder import new_folder
from gelgap.data.formats.pictures import encode_png, resized
from gelgap.data.formats.video import VIDEOS, picture_times_s, video_pictures
from gelgap.data.frames.folders import IMAGES, picture_paths, tables_in
from gelgap.data.frames.labels import FORCE_COLUMNS, QUANTITIES, known_labels
from gelgap.data.frames.tables import GROUPS, known_columns

LOG = logging.getLogger(__name__)
CONTACT_N = 0.3
"""What is pressed harder than this is in contact."""
TABLE = "frames.csv"
COLUMNS = ("picture", "reference", *QUANTITIES, *GROUPS, "time_s", "trajectory_id", "step", "split")
"""What a row of the table may hold. Pictures are paths inside the folder; forces are those on the sensor."""
_LAYOUT = (
    "expected for each clip a table of times and forces (press.csv with time_s, fz_n) beside a video (press.mp4) or a "
    "folder of pictures (press/) with a table picture, time_s in it"
)
_LAGS = range(-15, 16)
_REFERENCE_FRAMES = 5
_FEWEST_FRAMES = 10
_SIGNAL_PX = (80, 60)
_LONGEST_GAP = 3.5
"""A hole of a log is longer than this many of its usual periods: three, with some jitter."""
_NUMBER = re.compile(r"[\s_-]*(t=)?\d+$")


@dataclass(frozen=True)
class ConvertedClip:
    """What became of one clip, or of one series of presses.

    `pictures` and `in_contact` count pictures of the recording, `dropped` errors of the gauge and wrong marks,
    `written` rows of the new table, `in_holes` pictures without labels because the log has a hole there. The lag is in
    frames, positive where forces trail pictures, None where nothing is measured in time; `lag_range` are the least and
    the greatest that fit as well, None where the user stated it. `notes` say what is unusual about the tables.
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
    lag_range: tuple[int, int] | None = None
    lag_at_limit: bool = False
    begins_in_contact: bool = False
    in_holes: int = 0
    notes: tuple[str, ...] = ()


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


Layout = Callable[[Path, int, int | None], Iterable[Selection]]
"""Reads what is in a folder, the recordings of a domain one after the other; selects every n-th picture in contact.

The last argument is the lag in frames, None where each clip's is estimated.
"""


def convert(
    folder: Path | str, layout: str | Layout, out_dir: Path | str, every: int = 1, lag: int | None = None
) -> tuple[ConvertedClip, ...]:
    """Write recordings as picture folders, one a domain, below a new folder, and return what became of each clip.

    Of the pictures in contact every n-th is written (n = `every`), and the few before that make a clip's reference.
    Without a `lag` in frames each clip's is estimated; 0 takes the clocks as they are. The layout is `recordings`, a
    user's folder, or a function of the folder, n and the lag that reads another one:
    `gelgap.data.formats.published_sets.LAYOUTS` has those of two public repositories, by name.

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
        return tuple(_write(layout(Path(folder), every, lag), building))


def _write(selections: Iterable[Selection], out_dir: Path) -> Iterator[ConvertedClip]:
    """Write what is selected, a folder for each domain, and yield the facts of each clip."""
    for domain, members in groupby(selections, key=lambda own: own.facts.domain):
        if not is_plain_name(domain):
            raise ValueError(f"the session's name {domain!r} is not one of a folder")
        tables = []
        for clip, own in enumerate(members):
            facts, folder = own.facts, out_dir / domain / own.facts.name
            LOG.info("writing %s/%s", facts.session, facts.name)
            folder.mkdir(parents=True)
            (folder / "reference.png").write_bytes(encode_png(own.reference))
            for number, picture in enumerate(own.pictures()):
                if number in own.table.index:
                    (folder / f"{number:05d}.png").write_bytes(encode_png(picture))
            if number < own.table.index.max():
                raise ValueError(f"clip {facts.name} has {number + 1} of {facts.pictures} pictures")
            places = {
                "picture": [f"{facts.name}/{number:05d}.png" for number in own.table.index],
                "reference": f"{facts.name}/reference.png",
                "session": facts.session,
            }
            table = own.table.assign(**places)
            is_recorded = "time_s" in table
            tables.append(table.assign(trajectory_id=clip, step=table.index) if is_recorded else table)
            yield facts
        write_picture_table(out_dir / domain, pd.concat(tables))


def write_picture_table(folder: Path, table: pd.DataFrame) -> None:
    """Write the table of a picture folder, a row for each picture; columns are those of `COLUMNS` that it has."""
    if table.empty:
        raise ValueError(f"{folder.name}: no frame is left to be written")
    kept = table[[name for name in COLUMNS if name in table]].dropna(axis="columns", how="all")
    if partly := kept.columns[kept.isna().any()].tolist():
        raise ValueError(f"{folder.name}: only some frames have {', '.join(partly)}; all or none must")
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
    notes: tuple[str, ...] = ()

    def selected(self, every: int, lag: int | None) -> Selection:
        """Find the lag, unless it is given, and the reference, and select pictures in contact and those before."""
        LOG.info("converting %s/%s", self.session, self.name)
        self._check_times()
        found = LagEstimate(lag) if lag is not None else self._estimated_lag()
        labels = self.labels_at(found.lag)
        pressed_n, known = _pressing_n(labels), np.isfinite(labels).all(axis=1).to_numpy()
        if not known.any():
            raise ValueError(f"clip {self.name}: no picture has labels at a lag of {found.lag} frames")
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
            lag=found.lag,
            correlation=found.correlation,
            correlation_at_0=found.correlation_at_0,
            lag_range=found.range,
            lag_at_limit=lag is None and found.lag != 0 and found.lag in (self.lags[0], self.lags[-1]),
            begins_in_contact=bool(pressed_n[np.isfinite(pressed_n)][0] > CONTACT_N),
            in_holes=int(self._in_holes(found.lag).any(axis=1).sum()),
            notes=self.notes,
        )
        return Selection(facts, reference, self.pictures, table)

    def labels_at(self, lag: int) -> pd.DataFrame:
        """Return the labels of each picture at a lag in frames, interpolated in time.

        NaN where there are none, in a hole, or where the nearest value is NaN or more than half a frame away.
        """
        time_s, measured_s = self._shifted_s(lag), self.labels.index.to_numpy()
        nearest = np.searchsorted((measured_s[1:] + measured_s[:-1]) / 2, time_s)
        half_s = self._frame_s / 2
        inside = (time_s >= measured_s[0] - half_s) & (time_s <= measured_s[-1] + half_s)
        finite, found = np.isfinite(self.labels.to_numpy()), self._in_holes(lag)
        for known, (name, values) in zip(finite.T, self.labels.items(), strict=True):
            between = np.interp(time_s, measured_s[known], values[known]) if known.any() else np.nan
            found[name] = np.where(known[nearest] & inside & ~found[name], between, np.nan)
        return found

    @property
    def _frame_s(self) -> float:
        return float(np.median(np.diff(self.time_s)))

    def _shifted_s(self, lag: int) -> np.ndarray:
        return self.time_s + lag * self._frame_s

    def _in_holes(self, lag: int) -> pd.DataFrame:
        """Return for each picture and label whether the log has a hole there: values are missing for longer than usual.

        Longer than a picture too, as values that come in bunches leave such gaps; and further than half a usual period
        from the hole's ends.
        """
        time_s, measured_s = self._shifted_s(lag), self.labels.index.to_numpy()
        period_s = float(np.median(np.diff(measured_s)))
        longest_s, found = max(_LONGEST_GAP * period_s, self._frame_s), {}
        for name, values in self.labels.items():
            known_s = np.array([-np.inf, *measured_s[np.isfinite(values)], np.inf])
            behind = np.clip(np.searchsorted(known_s, time_s), 1, len(known_s) - 1)
            before_s, after_s = known_s[behind - 1], known_s[behind]
            is_far = np.minimum(time_s - before_s, after_s - time_s) > period_s / 2
            found[name] = is_far & (after_s - before_s > longest_s) & np.isfinite(after_s - before_s)
        return pd.DataFrame(found)

    def _check_times(self) -> None:
        measured_s, n, m = self.labels.index, len(self.time_s), len(self.labels)
        if min(n, m) < _FEWEST_FRAMES:
            raise ValueError(
                f"clip {self.name} has {n} pictures and {m} rows of labels; at least {_FEWEST_FRAMES} of each are "
                "needed"
            )
        if self.time_s[0] > measured_s[-1] or measured_s[0] > self.time_s[-1]:
            raise ValueError(
                f"clip {self.name}: its pictures begin {self.time_s[0] - measured_s[0]:.10g} s after its labels and "
                "have no time in common; count both from the same moment (a video's first picture is at 0 s)"
            )

    def _pressed_signal(self) -> np.ndarray:
        """Return how far each picture (n,) has gone from rest towards the most pressed ones.

        That is its projection on their mean difference, in which the noise of pixels averages out; their mean absolute
        difference begins at the noise, and is exactly 0 for the first picture alone.
        """
        reduced = [resized(picture, _SIGNAL_PX) for picture in self.pictures()]
        if len(reduced) != len(self.time_s):
            raise ValueError(f"clip {self.name} has {len(reduced)} pictures and {len(self.time_s)} times")
        pictures = np.stack(reduced).reshape(len(reduced), -1).astype(np.float32)
        change = np.abs(pictures - pictures[0]).mean(axis=1)
        most = np.argsort(change)[-max(len(pictures) // 10, 1) :]
        rest = pictures[:_REFERENCE_FRAMES].mean(axis=0)
        return (pictures - rest) @ (pictures[most].mean(axis=0) - rest)

    def _estimated_lag(self) -> "LagEstimate":
        """Return the lag at which pictures and force correlate best, and the range of those that do as well.

        Where force is a line in the signal plus noise, twice the log likelihood of a lag is −n log(1 − r²), and falls
        by 4 at the ends of an interval of 95 %. Errors of neighbouring pictures go together, so n is divided by the sum
        of their autocorrelation up to its first zero. Clocks alone give one lag while the signal rises and while it
        falls; compressed video shows slow changes late and gives two, which the range includes.
        """
        signal = self._pressed_signal()
        pressed_n = [_pressing_n(self.labels_at(lag)) for lag in self.lags]
        is_rising = np.gradient(np.convolve(np.pad(signal, 2, "edge"), np.ones(5) / 5, "valid")) > 0
        correlations = np.array([_correlation(signal, own) for own in pressed_n])
        rising = np.array([_correlation(signal[is_rising], own[is_rising]) for own in pressed_n])
        falling = np.array([_correlation(signal[~is_rising], own[~is_rising]) for own in pressed_n])
        if np.isnan(correlations).all():
            raise ValueError(
                f"clip {self.name}: its force or its pictures do not change, or fewer than {_FEWEST_FRAMES} pictures "
                "have labels; take it out of the folder"
            )
        best = int(np.nanargmax(correlations))
        unexplained = np.where(correlations > 0, 1 - correlations**2, 1.0)
        independent = _independent_errors(signal, pressed_n[best])
        fitting = np.flatnonzero(unexplained <= unexplained[best] * np.exp(4 / independent)).tolist()
        fitting += [int(np.nanargmax(own)) for own in (rising, falling) if not np.isnan(own).all()]
        return LagEstimate(
            self.lags[best],
            (self.lags[min(fitting)], self.lags[max(fitting)]),
            correlations[best],
            correlations[self.lags.index(0)],
        )


@dataclass(frozen=True)
class LagEstimate:
    """A lag in frames; unless it was stated, the range of those that fit as well, and how signals correlate."""

    lag: int
    range: tuple[int, int] | None = None
    correlation: float | None = None
    correlation_at_0: float | None = None


def _correlation(signal: np.ndarray, pressed_n: np.ndarray) -> float:
    """Return Pearson's correlation where both are known; NaN for too few, or if one does not change.

    Rounding would decide the latter.
    """
    known = np.isfinite(pressed_n)
    signal, pressed_n = signal[known], pressed_n[known]
    if len(pressed_n) < _FEWEST_FRAMES or np.ptp(signal) == 0 or np.ptp(pressed_n) == 0:
        return float("nan")
    return float(np.corrcoef(signal, pressed_n)[0, 1])


def _independent_errors(signal: np.ndarray, pressed_n: np.ndarray) -> float:
    """Return how many independent errors a line from the signal to the force has, one at least."""
    known = np.isfinite(pressed_n)
    line = np.polynomial.Polynomial.fit(signal[known], pressed_n[known], 1)
    errors = pressed_n[known] - line(signal[known])
    correlated = np.correlate(errors, errors, "full")[len(errors) - 1 :]
    positive = correlated[: np.argmax(correlated <= 0) or None]
    return (
        max(len(errors) * correlated[0] / (2 * positive.sum() - correlated[0]), 1.0) if correlated[0] else 1.0
    )


def _pressing_n(labels: pd.DataFrame) -> np.ndarray:
    """Return how hard was pressed (n,): −Fz, or the size of what else of the force was measured, N."""
    if "fz_n" in labels:
        return -labels["fz_n"].to_numpy()
    return np.linalg.norm(labels[[name for name in ("fx_n", "fy_n") if name in labels]], axis=1)


def mean_rgb(picture: np.ndarray) -> tuple[float, float, float]:
    red, green, blue = picture.mean(axis=(0, 1)).tolist()
    return red, green, blue


def _recordings(folder: Path, every: int, lag: int | None) -> Iterator[Selection]:
    """Select from the clips of a user's folder; the folder is their session."""
    tables = tables_in(folder)
    if not tables:
        raise ValueError(f"{folder} holds no recordings: {_LAYOUT}")
    clips = {table.stem for table in tables}
    if left := [path.name for path in visible_files(folder) if not {path.name, path.stem} & clips]:
        LOG.warning("not read, since no CSV table has their name: %s", comma_list(left))
    return (_recorded_clip(table).selected(every, lag) for table in tables)


def _recorded_clip(table: Path) -> Clip:
    columns, notes = known_columns(table, ("time_s", *QUANTITIES), needed=["time_s"])
    names = known_labels(columns)
    if not set(names) & set(FORCE_COLUMNS):
        raise ValueError(f"{table} needs the column time_s and one of {', '.join(FORCE_COLUMNS)} at least")
    labels = pd.DataFrame({name: columns[name] for name in names}, columns["time_s"])
    pressed_n = _pressing_n(labels)
    if np.nanmax(pressed_n) < -np.nanmin(pressed_n):
        raise ValueError(
            f"{table}: fz_n reaches {-np.nanmin(pressed_n):.3g} N and no less than {-np.nanmax(pressed_n):.3g} N; in "
            "compression Fz must be negative (the force of the indenter on the sensor): turn its sign, or take off "
            "what the gauge reads at rest"
        )
    _check_order(columns["time_s"], table)
    if repeated := int(labels.index.duplicated().sum()):
        labels = labels.groupby(level=0).mean()
        notes.append(f"{repeated} rows repeat the time of the row before: their mean is taken")
    sources = [
        path
        for path in visible_files(table.parent)
        if path.name == table.stem or (path.stem == table.stem and path.suffix.lower() in VIDEOS)
    ]
    if len(sources) != 1:
        many = f" has several: {', '.join(path.name for path in sources)}" if sources else " has no pictures"
        raise ValueError(f"the clip of {table}{many}; {_LAYOUT}")
    (source,) = sources
    if source.is_dir():
        tables = tables_in(source)
        if len(tables) != 1:
            raise ValueError(f"{source} must hold one table with the columns picture, time_s")
        of_pictures, notes_of_pictures = known_columns(tables[0], (needed := ("picture", "time_s")), needed)
        notes += notes_of_pictures
        time_s, paths = of_pictures["time_s"], picture_paths(tables[0], of_pictures["picture"])
        if left := len({*picture_files(visible_files(source, source / IMAGES))} - {*paths}):
            notes.append(f"{left} pictures have no row in {tables[0].name}: not read")
        pictures: Callable[[], Iterable[np.ndarray]] = partial(_pictures_of_one_size, paths)
        _check_order(time_s, tables[0])
        if (repeats := np.flatnonzero(np.diff(time_s) == 0)).size:
            raise ValueError(
                f"{tables[0]}: rows {repeats[0] + 1} and {repeats[0] + 2} below the header have one time, "
                f"{time_s[repeats[0]]:.10g} s: a camera takes one picture at a time"
            )
    else:
        time_s = picture_times_s(source)
        pictures = partial(video_pictures, source)
        _check_order(time_s, source)
    # Tables are written with seven digits, which the seconds since 1970 need for themselves.
    labels.index -= (origin_s := labels.index[0])
    return Clip(
        table.stem, table.parent.resolve().name, pictures, time_s - origin_s, labels, notes=tuple(notes)
    )


def _pictures_of_one_size(paths: list[Path]) -> Iterator[np.ndarray]:
    """Yield the pictures (h, w, 3) uint8 of files; a ValueError if one has another size than the first."""
    first = read_image(paths[0])
    for path in paths:
        if (picture := read_image(path)).shape != first.shape:
            (h0, w0, _), (h, w, _) = first.shape, picture.shape
            raise ValueError(
                f"{path} is {w}×{h} px, and {paths[0].name} {w0}×{h0} px: all must have one size"
            )
        yield picture


def _check_order(time_s: np.ndarray, place: Path) -> None:
    for row in np.flatnonzero(~np.isfinite(time_s)).tolist():
        raise ValueError(f"{place}: row {row + 1} below the header has no time")
    for row in np.flatnonzero(np.diff(time_s) < 0).tolist():
        raise ValueError(
            f"{place}: times must not fall, and in row {row + 2} below the header {time_s[row + 1]:.10g} s comes after "
            f"{time_s[row]:.10g} s"
        )


LAYOUTS: dict[str, Layout] = {"recordings": _recordings}
"""What is converted, by name."""
