"""Real data as people keep them: a folder of pictures and one CSV table with named columns, as of a GelSight Mini."""

from functools import cached_property
from pathlib import Path

import numpy as np

from gelgap.assets.plain_name import stays_inside
from gelgap.domains.stored import PictureFiles, read_table

# Names under which people write the same thing; letters and digits alone count.
NAMES = {
    "picture": ("image", "file", "filename", "path", "picture", "frame", "img", "imagepath", "imagefile"),
    "fx_n": ("fx", "fxn", "forcex", "forcexn"),
    "fy_n": ("fy", "fyn", "forcey", "forceyn"),
    "fz_n": ("fz", "fzn", "forcez", "forcezn"),
}
OPTIONAL = {
    "contact_class": ("contactclass", "class", "label"),
    "point_id": ("pointid", "point"),
    "x_mm": ("xmm", "x"),
    "y_mm": ("ymm", "y"),
    "depth_mm": ("depthmm", "depth"),
    "split": ("split",),
}
PICTURES = (".png", ".jpg", ".jpeg", ".bmp")
REFERENCE_STEMS = ("reference", "ref", "background", "bg", "nocontact")


class PictureFolder(PictureFiles):
    """A folder with one CSV table: a column that names the picture, and the forces `fx, fy, fz` in N.

    The reference is a picture called reference, ref, background or bg; without one, the frame of class 0 or else the
    one with the smallest force takes its place, and `notes` says so. Forces beyond the paper's range widen the declared
    range to the next 0.1 N, which `notes` says too. Pictures lie in the folder or in its `images/`.
    """

    def __init__(self, folder: Path | str):
        self.folder = Path(folder)
        self.name = self.folder.name
        table = next(iter(tables_of(self.folder)))
        rows = read_table(table)
        if not rows:
            raise ValueError(f"{table} has no rows; expected one per picture")
        header = [name for name in rows[0] if name]
        columns = {ours: _find(header, theirs) for ours, theirs in (NAMES | OPTIONAL).items()}
        missing = [ours for ours in NAMES if columns[ours] is None]
        if missing:
            raise ValueError(
                f"{table} lacks the columns {', '.join(missing)}; it has {', '.join(header)}: expected for example "
                "image, fx_n, fy_n, fz_n"
            )
        notes: list[str] = []
        self.picture_paths = [self._picture_path(row[columns["picture"]], table) for row in rows]
        self.columns = {"frame_id": np.arange(len(rows))}
        for ours, theirs in columns.items():
            if theirs is not None and ours != "picture":
                self.columns[ours] = _values(ours, theirs, rows, table)
        self.force_range_n = self._declared_range(notes)
        self._reference_file = self._find_reference(notes)
        self.notes = tuple(notes)

    @staticmethod
    def recognises(folder: Path) -> bool:
        return folder.is_dir() and len(tables_of(folder)) == 1

    @cached_property
    def reference(self) -> np.ndarray:
        return self.decoded_file(self._reference_file)

    def _picture_path(self, name: str, table: Path) -> Path:
        if not stays_inside(name):
            raise ValueError(f"{table} names the picture {name!r}: pictures must lie in {self.folder}")
        for place in (self.folder / name, self.folder / "images" / name):
            if place.is_file():
                return place
        raise FileNotFoundError(
            f"{table} names the picture {name!r}, which is neither in {self.folder} nor in images/"
        )

    def _declared_range(self, notes: list[str]) -> np.ndarray:
        declared = type(self).force_range_n
        forces = self.force_n
        forces = forces[np.isfinite(forces).all(axis=1)]
        lowest = forces.min(axis=0, initial=0.0)
        highest = forces.max(axis=0, initial=0.0)
        low = np.where(lowest < declared[:, 0], np.round(np.floor(lowest * 10) / 10, 1), declared[:, 0])
        high = np.where(highest > declared[:, 1], np.round(np.ceil(highest * 10) / 10, 1), declared[:, 1])
        widened = np.stack([low, high], axis=1)
        if not np.array_equal(widened, declared):
            notes.append(f"forces go beyond the paper's range: the declared range is {widened.tolist()} N")
        return widened

    def _find_reference(self, notes: list[str]) -> Path:
        for path in sorted([*self.folder.iterdir(), *(self.folder / "images").glob("*")]):
            if path.suffix.lower() in PICTURES and _plain(path.stem) in REFERENCE_STEMS:
                return path
        classes = self.columns.get("contact_class")
        index = (
            int(np.flatnonzero(classes == 0)[0])
            if classes is not None and (classes == 0).any()
            else int(np.nan_to_num(np.linalg.norm(self.force_n, axis=1), nan=np.inf).argmin())
        )
        force = np.linalg.norm(self.force_n[index])
        notes.append(f"no reference picture: frame {index}, with a force of {force:.3f} N, takes its place")
        return self.picture_paths[index]


def _values(ours: str, theirs: str, rows: list[dict[str, str]], table: Path) -> np.ndarray:
    values = [row[theirs] for row in rows]
    if ours == "split":
        return np.array(values, dtype=object)
    try:
        numbers = np.array([float(value) for value in values])
    except ValueError:
        raise ValueError(f"{table}, column {theirs!r}: every row must hold a number") from None
    if ours not in ("contact_class", "point_id"):
        return numbers
    if not (np.abs(numbers) < 2**31).all():
        raise ValueError(f"{table}, column {theirs!r}: every row must hold a whole number")
    return numbers.astype(np.int64)


def tables_of(folder: Path) -> list[Path]:
    """Return the CSV tables in a folder."""
    return sorted(folder.glob("*.csv"))


def _plain(name: str) -> str:
    return "".join(letter for letter in name.lower().split("(")[0] if letter.isalnum())


def _find(header: list[str], names: tuple[str, ...]) -> str | None:
    return next((column for column in header if _plain(column) in names), None)
