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
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby, islice
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.assets.image_file import picture_files, read_image, visible_files
from gelgap.assets.names import comma_list, is_plain_name
from gelgap.data.formats.domain_folder import new_folder
from gelgap.data.formats.lag import LagEstimate, estimated_lag, offset_of_clocks, pressed_signal
from gelgap.data.formats.pictures import encode_png
from gelgap.data.formats.recording_faults import (
    PictureFaults,
    ReducedPictures,
    drift_of_light,
    picture_faults,
    runs,
    stands_still,
    unsettled_pictures,
)
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
_LEAST_STEP = 0.01
_LEAST_ALIGNED = 0.9
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
    lag: float | None = None
    correlation: float | None = None
    correlation_at_0: float | None = None
    lag_range: tuple[float, float] | None = None
    lag_at_limit: bool = False
    begins_in_contact: bool = False
    in_holes: int = 0
    left_out: int = 0
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
    are_apart
        The clocks have no time in common, so that each counts from its first value.
    """

    name: str
    session: str
    pictures: Callable[[], Iterable[np.ndarray]]
    time_s: np.ndarray
    labels: pd.DataFrame
    lags: range = _LAGS
    are_apart: bool = False
    notes: tuple[str, ...] = ()

    def selected(self, every: int, lag: int | None) -> Selection:
        """Find the lag, unless it is given, and the reference, and select pictures in contact and those before."""
        LOG.info("converting %s/%s", self.session, self.name)
        self._check_times()
        if lag is None and not self._have_common_time():
            return replace(self, time_s=self.time_s - self.time_s[0], are_apart=True).selected(every, None)
        read = ReducedPictures.read(self.pictures())
        if len(read) != len(self.time_s):
            raise ValueError(f"clip {self.name} has {len(read)} of {len(self.time_s)} pictures")
        faults = picture_faults(read, _pressing_n(self.labels_at(lag or 0)))
        if lag is None:
            found = self._estimated_lag(read, faults.usable)
        else:
            self._check_common_time()
            found = LagEstimate(lag)
        labels = self.labels_at(found.lag)
        touching = np.flatnonzero(_pressing_n(labels) > CONTACT_N)
        unsettled = unsettled_pictures(read.pictures[: touching[0] if len(touching) else len(read)])
        faults.unlike[:unsettled] = True
        shown = faults.usable & ~_seen_late(faults.in_doubt, labels)
        notes = self._noted_faults(read, faults, labels, shown)
        if found.best is not None and (self.are_apart or not self.lags[0] <= found.lag <= self.lags[-1]):
            shift_s = found.lag * self._frame_s
            clocks = (
                "which have no time in common, each counted from its first value,"
                if self.are_apart
                else "as they are,"
            )
            notes.append(f"the clocks, {clocks} differ by {shift_s:.3f} s: aligned over the whole clip")
        labels[~shown] = np.nan
        pressed_n, known = _pressing_n(labels), np.isfinite(labels).all(axis=1).to_numpy()
        if not known.any():
            raise ValueError(f"clip {self.name}: no picture has labels at a lag of {found.lag} frames")
        touches = pressed_n > CONTACT_N
        # The reference is made of the pictures before the contact, less one as a lag may be wrong by one.
        before = int(np.argmax(touches)) if touches.any() else len(touches)
        at_rest, in_contact = np.flatnonzero(known & ~touches), np.flatnonzero(known & touches)
        before_contact = np.flatnonzero(shown[: max(before - 1, 1)])
        quiet = next(own for own in (before_contact, at_rest, np.flatnonzero(shown)[:1]) if len(own))
        quiet = quiet[:_REFERENCE_FRAMES]
        of_rest = [
            picture
            for number, picture in enumerate(islice(self.pictures(), quiet[-1] + 1))
            if number in quiet
        ]
        reference = np.median(of_rest, axis=0).round().astype(np.uint8)
        chosen = np.union1d(at_rest[: len(quiet)], in_contact[::every])
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
            lag_at_limit=found.lag != 0 and found.best in (self.lags[0], self.lags[-1]),
            begins_in_contact=bool(pressed_n[np.isfinite(pressed_n)][0] > CONTACT_N),
            in_holes=int(self._in_holes(found.lag).any(axis=1).sum()),
            left_out=int((~shown).sum()),
            notes=(*self.notes, *notes),
        )
        return Selection(facts, reference, self.pictures, table)

    def labels_at(self, lag: float) -> pd.DataFrame:
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

    def _shifted_s(self, lag: float) -> np.ndarray:
        return self.time_s + lag * self._frame_s

    def _in_holes(self, lag: float) -> pd.DataFrame:
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
        n, m = len(self.time_s), len(self.labels)
        if min(n, m) < _FEWEST_FRAMES:
            raise ValueError(
                f"clip {self.name} has {n} pictures and {m} rows of labels; at least {_FEWEST_FRAMES} of each are "
                "needed"
            )

    def _have_common_time(self) -> bool:
        return self.time_s[0] <= self.labels.index[-1] and self.labels.index[0] <= self.time_s[-1]

    def _check_common_time(self) -> None:
        if self.are_apart or not self._have_common_time():
            raise ValueError(
                f"clip {self.name}: its pictures and its labels have no time in common, and no alignment of the whole "
                "clip fits; count both from the same moment (a video's first picture is at 0 s)"
            )

    def _noted_faults(
        self, read: ReducedPictures, faults: PictureFaults, labels: pd.DataFrame, shown: np.ndarray
    ) -> list[str]:
        """Return sentences on what is wrong with the pictures, each with numbers and times."""
        told = []
        for what, chosen in {
            "repeat the one before, as of a camera that stalls: left out": ~faults.unlike & ~shown,
            "are unlike the rest, in colours, light or view: left out": faults.unlike,
        }.items():
            if of_runs := [self._when(*run) for run in runs(chosen)]:
                told.append(f"{chosen.sum()} pictures {what}: {comma_list(of_runs)}")
        for number, share in [step for step in faults.light_steps if abs(step[1]) >= _LEAST_STEP]:
            told.append(f"the light of the whole view steps by {share:+.1%} at {self._when(number, number)}")
        at_rest = np.flatnonzero(shown & (_pressing_n(labels) <= CONTACT_N))
        if len(at_rest) and (share := drift_of_light(read.pictures[at_rest])):
            first, last = self.time_s[at_rest[0]], self.time_s[at_rest[-1]]
            told.append(f"the light drifts by {share:+.0%} between rests at {first:.2f} and {last:.2f} s")
        return told

    def _when(self, first: int, last: int) -> str:
        if first == last:
            return f"{first} ({self.time_s[first]:.2f} s)"
        return f"{first}–{last} ({self.time_s[first]:.2f}–{self.time_s[last]:.2f} s)"

    def _estimated_lag(self, read: ReducedPictures, usable: np.ndarray) -> LagEstimate:
        """Return the lag of this clip, also where the clocks have other zeros."""
        signal = pressed_signal(read.pictures, usable)

        def pressed_n_at(lag: float) -> np.ndarray:
            return _pressing_n(self.labels_at(lag))

        found = estimated_lag(signal, usable, pressed_n_at, self.lags)
        offset = self._offset_of_clocks(signal) if self.lags == _LAGS else None
        if offset is not None and offset not in self.lags:
            lags = range(offset + _LAGS[0], offset + _LAGS[-1] + 1)
            aligned = estimated_lag(signal, usable, pressed_n_at, lags)
            # Each lag has some part of a press to fit: the whole one must leave less than half of the rest.
            if (
                aligned
                and aligned.correlation > _LEAST_ALIGNED
                and (not found or 1 - aligned.correlation**2 < (1 - found.correlation**2) / 2)
            ):
                found = aligned
        if self.are_apart and not (found and found.correlation > _LEAST_ALIGNED):
            self._check_common_time()
        if found is None:
            raise ValueError(
                f"clip {self.name}: its force or its pictures do not change, or fewer than {_FEWEST_FRAMES} pictures "
                "have labels; take it out of the folder"
            )
        return found

    def _offset_of_clocks(self, signal: np.ndarray) -> int | None:
        """Return the lag in frames at which the whole clip goes with the whole log; None if none or several do."""
        measured_s, frame_s = self.labels.index.to_numpy(), self._frame_s
        pressed_n = _pressing_n(self.labels)
        known = np.isfinite(pressed_n)
        if not known.any():
            return None
        seen = np.interp(np.arange(self.time_s[0], self.time_s[-1], frame_s), self.time_s, signal)
        felt = np.interp(
            np.arange(measured_s[0], measured_s[-1], frame_s), measured_s[known], pressed_n[known]
        )
        offset = offset_of_clocks(seen, felt)
        return None if offset is None else round(offset + (measured_s[0] - self.time_s[0]) / frame_s)


def _seen_late(in_doubt: np.ndarray, labels: pd.DataFrame) -> np.ndarray:
    """Return which pictures (n,) that may repeat the one before do so while a force changes.

    By more than 1 % of its range and six times its noise, as the differences of rows tell.
    """
    late, forces = np.zeros(len(in_doubt), bool), labels[[name for name in FORCE_COLUMNS if name in labels]]
    noise_n = 1.48 * forces.diff().diff().abs().median() / 6**0.5
    least = (forces.max() - forces.min()) / 100 + 6 * noise_n
    for first, last in runs(in_doubt):
        of_run = forces.iloc[max(first - 1, 0) : last + 1]
        late[first : last + 1] = (of_run.max() - of_run.min() > least).any()
    return late


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
    for name in [own for own in FORCE_COLUMNS if own in labels]:
        stands = stands_still(labels[name].to_numpy())
        time_s = labels.index - columns["time_s"][0]
        for first, last in runs(stands):
            notes.append(
                f"{name} stands at {labels[name].iloc[first]:.4g} from {time_s[first]:.2f} to {time_s[last]:.2f} s of "
                "the log, at its limit or not read: no labels there"
            )
        labels[name] = labels[name].mask(stands)
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
