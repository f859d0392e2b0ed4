"""Other people's recordings made into picture folders: videos with forces, presses marked by hand."""

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np

from gelgap.assets.names import is_plain_name
from gelgap.domains.ball_presses import SERIES, Presses, ball_presses
from gelgap.domains.clip import CONTACT_N, AlignedClip, Clip, align, pressing_n
from gelgap.domains.new_folder import new_folder
from gelgap.domains.picture_table import PictureRow, write_picture, write_picture_table
from gelgap.domains.recordings import recorded_clips
from gelgap.domains.wedge_grasps import wedge_clips

LOG = logging.getLogger(__name__)
_PRESSES_PER_CLIP = 20
_REFERENCE = "reference.png"


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


def convert(
    folder: Path | str, layout: str, out_dir: Path | str, every: int = 1
) -> tuple[ConvertedClip, ...]:
    """Write recordings as picture folders, one a domain, below a new folder, and return what became of each clip.

    `wedge` and `ball-presses` are clones of public repositories, `recordings` is a user's folder. Of the pictures in
    contact each `every`-th is written, and the few before that make a clip's reference.

    Raises
    ------
    ValueError
        If the layout is unknown, the folder has another, a file of it is not as it should be, or the output exists.
    """
    if layout not in LAYOUTS:
        raise ValueError(f"layout {layout!r} is unknown; known layouts: {', '.join(LAYOUTS)}")
    with new_folder(Path(out_dir)) as building:
        return tuple(LAYOUTS[layout](Path(folder), building, every))


def _wedge(clone: Path, out_dir: Path, every: int) -> list[ConvertedClip]:
    return _write_clips(wedge_clips(clone), out_dir, every)


def _recordings(folder: Path, out_dir: Path, every: int) -> list[ConvertedClip]:
    return _write_clips(recorded_clips(folder), out_dir, every)


def _write_clips(clips: Iterable[Clip], out_dir: Path, every: int) -> list[ConvertedClip]:
    """Write clips in the order of their sessions; a session is a domain."""
    facts = []
    for session, members in groupby(clips, key=lambda clip: clip.session):
        if not is_plain_name(session):
            raise ValueError(f"the session's name {session!r} is not one of a folder")
        table = []
        for clip in members:
            LOG.info("converting %s/%s", session, clip.name)
            aligned = align(clip)
            rows = _write_frames(aligned, out_dir / session, every)
            table += rows
            facts.append(_clip_facts(aligned, len(rows)))
        write_picture_table(out_dir / session, table)
    return facts


def _write_frames(aligned: AlignedClip, folder: Path, every: int) -> list[PictureRow]:
    clip, labels = aligned.clip, aligned.clip.labels_at(aligned.lag)
    known = np.isfinite(np.stack(list(labels.values()))).all(axis=0)
    touches = known & (pressing_n(labels) > CONTACT_N)
    kept = np.flatnonzero(touches)[::every]
    at_rest = np.flatnonzero((known & ~touches)[: aligned.at_rest])
    chosen = {*at_rest.tolist(), *kept.tolist()}
    reference = write_picture(folder, f"{clip.name}/{_REFERENCE}", aligned.reference)
    return [
        PictureRow(
            picture=write_picture(folder, f"{clip.name}/{frame:05d}.png", picture),
            reference=reference,
            **{name: float(values[frame]) for name, values in labels.items()},
            clip=clip.name,
            object=clip.object,
            session=clip.session,
            time_s=float(clip.time_s[frame]),
        )
        for frame, picture in enumerate(clip.pictures())
        if frame in chosen
    ]


def _clip_facts(aligned: AlignedClip, written: int) -> ConvertedClip:
    clip, labels = aligned.clip, np.stack(list(aligned.clip.labels.values()))
    return ConvertedClip(
        domain=clip.session,
        session=clip.session,
        name=clip.name,
        pictures=len(clip.time_s),
        in_contact=int((clip.pressing_at(aligned.lag) > CONTACT_N).sum()),
        dropped=int((~np.isfinite(labels)).any(axis=0).sum()),
        written=written,
        reference_rgb=_mean_rgb(aligned.reference),
        lag=aligned.lag,
        correlation=aligned.correlation,
        correlation_at_0=aligned.correlation_at_0,
        lag_at_limit=aligned.lag != 0 and aligned.lag in (clip.lags[0], clip.lags[-1]),
        begins_in_contact=aligned.begins_in_contact,
    )


def _ball_presses(clone: Path, out_dir: Path, every: int) -> list[ConvertedClip]:
    """Write all series as one domain: they are of one sensor."""
    domain, table, facts = "ball-presses", [], []
    for series in SERIES:
        presses = ball_presses(clone, series)
        right = presses.is_marked_right()
        rows = _write_presses(presses, np.flatnonzero(right)[::every], out_dir / domain)
        table += rows
        facts.append(
            ConvertedClip(
                domain=domain,
                session=series.name,
                name=series.name,
                pictures=len(right),
                in_contact=len(right),
                dropped=int((~right).sum()),
                written=len(rows),
                reference_rgb=_mean_rgb(presses.reference),
            )
        )
    write_picture_table(out_dir / domain, table)
    return facts


def _write_presses(presses: Presses, chosen: np.ndarray, folder: Path) -> list[PictureRow]:
    """Write some presses; a clip is twenty that were taken one after another, as they lie close together."""
    name, radius_mm = presses.series.name, presses.series.ball_radius_mm
    reference = write_picture(folder, f"{name}/{_REFERENCE}", presses.reference)
    return [
        PictureRow(
            picture=write_picture(folder, f"{name}/{press:05d}.png", presses.pictures[press]),
            reference=reference,
            x_mm=float(presses.centers_mm[press, 0]),
            y_mm=float(presses.centers_mm[press, 1]),
            clip=f"{name}-{press // _PRESSES_PER_CLIP:02d}",
            object=f"ball of {2 * radius_mm:.2f} mm",
            session=name,
        )
        for press in chosen.tolist()
    ]


def _mean_rgb(picture: np.ndarray) -> tuple[float, float, float]:
    red, green, blue = picture.mean(axis=(0, 1)).tolist()
    return red, green, blue


LAYOUTS: dict[str, Callable[[Path, Path, int], list[ConvertedClip]]] = {
    "wedge": _wedge,
    "ball-presses": _ball_presses,
    "recordings": _recordings,
}
"""What is converted, by name."""
