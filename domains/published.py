"""Real data in the published layout: `<domain>/{train,test,ori}/images/0.jpg …` with `forcePosition/force.csv`."""

from functools import cached_property
from pathlib import Path

import numpy as np

from gelgap.domains.labels import FORCE_COLUMNS
from gelgap.domains.stored import PictureFiles, read_table

REFERENCE = "ref.jpg"
PARTS = ("train", "test")
# All frames once more, in one folder.
UNSPLIT = "ori"
PUBLISHED_FORCES = ("Fx(N)", "Fy(N)", "Fz(N)")
LABEL_COLUMN = "label"
ALIASES = {"inpainting": "wmb0i0"}


class PublishedDomain(PictureFiles):
    """One domain of the published data set, with its irregularities handled and listed in `notes`.

    Row i of `force.csv` belongs to `i.jpg`; columns are found by name. Where the parts `train` and `test` exist they
    are read, and `ori`, which repeats them, is not. A part whose rows and pictures do not match is an error.
    """

    def __init__(self, folder: Path | str):
        self.folder = Path(folder)
        self.name = ALIASES.get(self.folder.name, self.folder.name)
        notes = []
        if self.name != self.folder.name:
            notes.append(f"the folder {self.folder.name!r} is the domain {self.name}")
        parts = [part for part in PARTS if (self.folder / part / "images").is_dir()] or [UNSPLIT]
        if parts != [UNSPLIT] and (self.folder / UNSPLIT).is_dir():
            notes.append(f"{UNSPLIT}/ repeats the frames of {' and '.join(parts)}: not read")
        self.further_files = [self.folder / REFERENCE, *(self._table(part) for part in parts)]
        rows = [(part, *row) for part in parts for row in self._read_part(part)]
        self.picture_paths = [path for _, path, _, _ in rows]
        forces = np.array([force for _, _, force, _ in rows], dtype=np.float64).reshape(-1, 3)
        self.columns = {name: forces[:, axis] for axis, name in enumerate(FORCE_COLUMNS)}
        labels = [label for *_, label in rows]
        if None in labels:
            notes.append("the table has no contact labels: contact classes are off")
        else:
            classes = np.array(labels, dtype=np.int64)
            beyond = int((classes >= self.n_classes).sum())
            if beyond:
                notes.append(f"{beyond} labels are running numbers: taken modulo {self.n_classes}")
            self.columns["contact_class"] = classes % self.n_classes
        if parts != [UNSPLIT]:
            self.columns["split"] = np.array([part for part, *_ in rows], dtype=object)
        self.columns["frame_id"] = np.arange(len(rows))
        low, high = self.force_range_n.T
        forces = forces[np.isfinite(forces).all(axis=1)]
        outside = int(((forces < low) | (forces > high)).any(axis=1).sum())
        if outside:
            smallest, largest = (
                np.round(part, 3).tolist() for part in (forces.min(axis=0), forces.max(axis=0))
            )
            notes.append(
                f"{outside} of {len(rows)} frames have a force outside the declared range "
                f"{self.force_range_n.tolist()} N: found {smallest}…{largest} N"
            )
        self.notes = tuple(notes)

    @staticmethod
    def recognises(folder: Path) -> bool:
        return (folder / REFERENCE).is_file() and any(
            (folder / part / "images").is_dir() for part in (*PARTS, UNSPLIT)
        )

    @cached_property
    def reference(self) -> np.ndarray:
        return self.decoded_file(self.folder / REFERENCE)

    def _table(self, part: str) -> Path:
        return self.folder / part / "forcePosition" / "force.csv"

    def _read_part(self, part: str) -> list[tuple[Path, list[float], int | None]]:
        table = self._table(part)
        try:
            rows = read_table(table)
        except FileNotFoundError:
            raise FileNotFoundError(f"{table} is missing; every part has its forces there") from None
        names = list(rows[0]) if rows else PUBLISHED_FORCES
        missing = [name for name in PUBLISHED_FORCES if name not in names]
        if missing:
            raise ValueError(f"{table} lacks the columns {', '.join(missing)}; it has {', '.join(names)}")
        images = self.folder / part / "images"
        found = sum(1 for path in images.glob("*.jpg") if path.stem.isdigit())
        if found != len(rows):
            raise ValueError(
                f"{self.folder / part} has {found} pictures and {len(rows)} rows of forces ({table}); they must match"
            )
        read = []
        for number, row in enumerate(rows):
            picture = images / f"{number}.jpg"
            if not picture.is_file():
                raise ValueError(f"{picture} is missing; row {number} of {table} belongs to it")
            try:
                force = [float(row[name]) for name in PUBLISHED_FORCES]
                label = int(float(row[LABEL_COLUMN])) if row.get(LABEL_COLUMN) else None
                if label is not None and abs(label) >= 2**31:
                    raise ValueError
            except (ValueError, OverflowError):
                raise ValueError(
                    f"{table}, row {number}: {row} has something else where a number is expected"
                ) from None
            read.append((picture, force, label))
        return read
