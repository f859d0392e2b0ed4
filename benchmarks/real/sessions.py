"""Sessions of the GelSight Wedge's grasps, converted once from the clone as `gelgap convert` does, and read back."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gelgap.benchmarks.real.published_sets import LAYOUTS, WEDGE_CLONE
from gelgap.domains import convert
from gelgap.domains.formats.convert import CONTACT_N, TABLE
from gelgap.domains.formats.pictures import decode_picture, resized
from gelgap.domains.frames.folders import read_table

LOG = logging.getLogger(__name__)
CLONE = "EstimateModulus"
SESSIONS = ("2023-12-06", "2023-12-16")
"""The two sessions with objects in common."""
_SIZE_PX = (80, 60)


@dataclass(frozen=True)
class Session:
    """Pictures in contact of one session, which has one light: `clip` and `object` (n,) names, `fz_n` (n,).

    `change` (n,) is the mean absolute difference of a picture from its clip's reference, in grey levels.
    """

    name: str
    clip: np.ndarray
    object: np.ndarray
    fz_n: np.ndarray
    change: np.ndarray

    @property
    def key(self) -> list[Any]:
        """What a training on it depends on: its name, and the clip and the force of each picture."""
        return [self.name, self.clip.tolist(), self.fz_n.tolist()]

    def of(self, clips: Sequence[str]) -> "Session":
        """Return the pictures of some clips."""
        return self.take(np.isin(self.clip, clips))

    def of_objects(self, objects: Sequence[str]) -> "Session":
        """Return the pictures of some objects."""
        return self.take(np.isin(self.object, objects))

    def take(self, chosen: np.ndarray) -> "Session":
        """Return some of the pictures, by a mask (n,) or by indices."""
        return Session(
            self.name, self.clip[chosen], self.object[chosen], self.fz_n[chosen], self.change[chosen]
        )


def converted_sessions(data: Path, out_dir: Path) -> Path:
    """Return the folder of all sessions of the clone in the folder `data`, converted once and kept in `out_dir`.

    Raises
    ------
    FileNotFoundError
        If the clone is missing; the message has the line that gets it.
    ValueError
        If the clone lacks one of the sessions that are compared.
    """
    clone, converted = data / CLONE, out_dir / "real" / "wedge"
    if not clone.is_dir():
        raise FileNotFoundError(f"{clone} is missing; get it: {WEDGE_CLONE} {clone}")
    if not converted.is_dir():
        LOG.info("converting %s, once", clone)
        convert(clone, LAYOUTS["wedge"], converted)
    if missing := [name for name in SESSIONS if not (converted / name).is_dir()]:
        raise ValueError(f"{clone} has no session {missing[0]}; it has {', '.join(_folders(converted))}")
    return converted


@cache
def read_sessions(folder: Path) -> tuple[Session, Session]:
    """Return the two sessions that are compared, of the objects that both have.

    Raises
    ------
    ValueError
        If they have no object in common.
    """
    first, second = (_read(folder / name) for name in SESSIONS)
    shared = sorted(set(first.object) & set(second.object))
    if not shared:
        raise ValueError(f"the sessions {' and '.join(SESSIONS)} of {folder} have no object in common")
    return first.of_objects(shared), second.of_objects(shared)


def session_named(folder: Path, name: str) -> Session:
    """Return one of the two sessions that are compared."""
    return next(session for session in read_sessions(folder) if session.name == name)


def _folders(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.is_dir())


def _read(folder: Path) -> Session:
    rows = [row for row in read_table(folder / TABLE) if -float(row["fz_n"]) > CONTACT_N]
    references = {name: _small(folder / name) for name in {row["reference"] for row in rows}}
    change = [np.abs(_small(folder / row["picture"]) - references[row["reference"]]).mean() for row in rows]
    return Session(
        folder.name,
        np.array([row["clip"] for row in rows]),
        np.array([row["object"] for row in rows]),
        np.array([float(row["fz_n"]) for row in rows]),
        np.array(change),
    )


def _small(path: Path) -> np.ndarray:
    return resized(decode_picture(path.read_bytes()), _SIZE_PX).astype(float)
