"""Real data as people keep them: a folder of pictures and one CSV table with named columns, as of a GelSight Mini."""

from functools import cached_property
from pathlib import Path

import numpy as np

from gelgap.assets.names import stays_inside
from gelgap.domains.dataset import LabelledFrames
from gelgap.domains.hidden_markers import without_markers
from gelgap.domains.labels import (
    FORCE_COLUMNS,
    QUANTITIES,
    covering,
    known_labels,
    paper_range,
)
from gelgap.domains.picture_codec import resized
from gelgap.domains.stored import PictureFiles, read_table

# Names under which people write the same thing; letters and digits alone count.
PICTURE_NAMES = ("image", "file", "filename", "path", "picture", "frame", "img", "imagepath", "imagefile")
LABEL_NAMES = {
    "fx_n": ("fx", "fxn", "forcex", "forcexn"),
    "fy_n": ("fy", "fyn", "forcey", "forceyn"),
    "fz_n": ("fz", "fzn", "forcez", "forcezn"),
    "mx_nmm": ("mx", "mxnmm", "torquex", "torquexnmm"),
    "my_nmm": ("my", "mynmm", "torquey", "torqueynmm"),
    "mz_nmm": ("mz", "mznmm", "torquez", "torqueznmm"),
    "x_mm": ("xmm", "x"),
    "y_mm": ("ymm", "y"),
    "depth_mm": ("depthmm", "depth"),
}
NUMBERS = {"time_s": ("times",)}
WHOLE_NUMBERS = {"contact_class": ("contactclass", "class", "label"), "point_id": ("pointid", "point")}
GROUPS = {"clip": ("clip",), "object": ("object",), "session": ("session",)}
TEXTS = GROUPS | {"split": ("split",), "reference": ("reference",)}
COLUMNS = LABEL_NAMES | NUMBERS | WHOLE_NUMBERS | TEXTS
PICTURES = (".png", ".jpg", ".jpeg", ".bmp")
REFERENCE_STEMS = ("reference", "ref", "background", "bg", "nocontact")
REFERENCES = "references"


class PictureFolder(PictureFiles):
    """A folder with one CSV table: a column that names the picture, and one at least that is a label.

    The rest picture of a row is what its column `reference` names, or else that of its clip,
    `references/<clip>.png`. Without either all rows share one: the picture called reference, ref, background or bg;
    without such a one, the frame of class 0 or else the one with the smallest force or depth takes its place, and
    `notes` says so. Labels beyond the paper's ranges of forces widen them to the next 0.1 N, which `notes` says too.
    Pictures lie in the folder or in its `images/`.
    """

    declares_ranges = False

    def __init__(self, folder: Path | str):
        self.folder = Path(folder)
        self.name = self.folder.name
        self._table = next(iter(tables_of(self.folder)))
        rows = read_table(self._table)
        if not rows:
            raise ValueError(f"{self._table} has no rows; expected one per picture")
        header = [name for name in rows[0] if name]
        picture = _find(header, PICTURE_NAMES)
        found = {ours: theirs for ours, names in COLUMNS.items() if (theirs := _find(header, names))}
        self._check_header(header, picture, found)
        notes: list[str] = []
        self.picture_paths = [self._picture_path(row[picture]) for row in rows]
        self.columns = {"frame_id": np.arange(len(rows))}
        for ours, theirs in found.items():
            if ours != "reference":
                self.columns[ours] = _values(ours, theirs, rows, self._table)
        self.force_range_n = self._found_range(notes)
        named = [row[found["reference"]] for row in rows] if "reference" in found else None
        self.reference_paths = self._find_references(named, notes)
        self.further_files = [self._table, *self.reference_paths]
        self._reduced: dict[tuple[tuple[int, int], bool], np.ndarray] = {}
        self.notes = tuple(notes)

    @staticmethod
    def recognises(folder: Path) -> bool:
        return folder.is_dir() and len(tables_of(folder)) == 1

    @cached_property
    def reference(self) -> np.ndarray:
        return self.decoded_file(self.reference_paths[0])

    @property
    def reference_count(self) -> int:
        return len(self.reference_paths)

    def references_at(self, size_px: int | tuple[int, int] | None = None, markers: bool = True) -> np.ndarray:
        size = self.image_size_px(size_px)
        if (size, markers) not in self._reduced:
            pictures = map(self.reference_picture, self.reference_paths)
            self._reduced[size, markers] = np.stack(
                [resized(picture if markers else without_markers(picture), size) for picture in pictures]
            )
        return self._reduced[size, markers]

    def reference_picture(self, path: Path) -> np.ndarray:
        """Return one of the rest pictures (h, w, 3), or raise a ValueError if it is of another size than the first."""
        picture = self.decoded_file(path)
        if picture.shape != self.reference.shape:
            (height, width), (first_height, first_width) = picture.shape[:2], self.reference.shape[:2]
            raise ValueError(
                f"data set {self.name}: the rest picture {path} is {width}×{height} px, {self.reference_paths[0].name} "
                f"{first_width}×{first_height} px; all pictures must have one size"
            )
        return picture

    def _check_header(self, header: list[str], picture: str | None, found: dict[str, str]) -> None:
        example = "expected for example picture, fx_n, fy_n, fz_n"
        if picture is None:
            raise ValueError(
                f"{self._table} lacks a column that names the picture; it has {', '.join(header)}: {example}"
            )
        if not known_labels(found):
            raise ValueError(
                f"{self._table} has no label, of which one at least is needed ({', '.join(QUANTITIES)}); it has "
                f"{', '.join(header)}: {example}"
            )

    def _picture_path(self, name: str) -> Path:
        if not stays_inside(name):
            raise ValueError(f"{self._table} names the picture {name!r}: pictures must lie in {self.folder}")
        for place in (self.folder / name, self.folder / "images" / name):
            if place.is_file():
                return place
        raise FileNotFoundError(
            f"{self._table} names the picture {name!r}, which is neither in {self.folder} nor in images/"
        )

    def _found_range(self, notes: list[str]) -> np.ndarray:
        declared = LabelledFrames.force_range_n
        found = declared.copy()
        for axis, name in enumerate(FORCE_COLUMNS):
            if name in self.columns:
                found[axis] = covering(self.columns[name], paper_range(name))
        if not np.array_equal(found, declared):
            ranges = (
                f"{QUANTITIES[name].symbol} {found[axis][0]:g}…{found[axis][1]:g}"
                for axis, name in enumerate(FORCE_COLUMNS)
                if name in self.columns
            )
            notes.append(f"forces go beyond the paper's range: the declared range is {', '.join(ranges)} N")
        return found

    def _find_references(self, named: list[str] | None, notes: list[str]) -> list[Path]:
        """Return the rest pictures; where frames have their own, the column `reference_id` says which."""
        if named is not None:
            return self._by_frame([self._picture_path(name) for name in named])
        if "clip" in self.columns and (self.folder / REFERENCES).is_dir():
            of_clip = {clip: self._clip_reference(clip) for clip in dict.fromkeys(self.columns["clip"])}
            return self._by_frame([of_clip[clip] for clip in self.columns["clip"]])
        for path in sorted([*self.folder.iterdir(), *(self.folder / "images").glob("*")]):
            if path.suffix.lower() in PICTURES and _plain(path.stem) in REFERENCE_STEMS:
                return [path]
        index, why = self._lightest_touch()
        notes.append(f"no reference picture: frame {index}, {why}, takes its place")
        return [self.picture_paths[index]]

    def _by_frame(self, paths: list[Path]) -> list[Path]:
        number = {path: i for i, path in enumerate(dict.fromkeys(paths))}
        self.columns["reference_id"] = np.array([number[path] for path in paths])
        return list(number)

    def _clip_reference(self, clip: str) -> Path:
        if not stays_inside(clip):
            raise ValueError(
                f"{self._table} names the clip {clip!r}: its rest picture must lie in {self.folder}"
            )
        for ending in PICTURES:
            if (path := self.folder / REFERENCES / f"{clip}{ending}").is_file():
                return path
        raise FileNotFoundError(
            f"clip {clip!r} of {self._table} has no rest picture; expected {self.folder / REFERENCES / clip}.png"
        )

    def _lightest_touch(self) -> tuple[int, str]:
        """Return the frame that shows least contact, and why it was taken."""
        forces = [self.columns[name] for name in FORCE_COLUMNS if name in self.columns]
        size = np.linalg.norm(forces, axis=0) if forces else self.columns.get("depth_mm")
        classes = self.columns.get("contact_class")
        if classes is not None and (classes == 0).any():
            index = int(np.flatnonzero(classes == 0)[0])
        elif size is not None:
            index = int(np.nan_to_num(size, nan=np.inf).argmin())
        else:
            raise FileNotFoundError(
                f"{self.folder} has no reference picture: put reference.png there, or name rest pictures in a column "
                "reference"
            )
        if size is None:
            return index, "of class 0"
        return (
            index,
            f"with a force of {size[index]:.3f} N" if forces else f"at a depth of {size[index]:.3f} mm",
        )


def _values(ours: str, theirs: str, rows: list[dict[str, str]], table: Path) -> np.ndarray:
    values = [row[theirs] for row in rows]
    if ours in TEXTS:
        if ours in GROUPS and not all(values):
            raise ValueError(f"{table}, column {theirs!r}: every row must hold a name")
        return np.array(values, dtype=object)
    try:
        numbers = np.array([float(value) for value in values])
    except ValueError:
        raise ValueError(f"{table}, column {theirs!r}: every row must hold a number") from None
    if ours not in WHOLE_NUMBERS:
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
