"""Opening a data set, whichever layout it has: gelgap's own, the paper's published one, or pictures with a table.

Published: `<domain>/{train,test,ori}/images/0.jpg …` with `forcePosition/force.csv`. Real data as people keep them: a
folder of pictures and one CSV table with named columns, as of a GelSight Mini.
"""

import csv
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from gelgap.assets.checksums import sha256
from gelgap.assets.names import quoted, stays_inside
from gelgap.domains.formats.domain_folder import MANIFEST
from gelgap.domains.formats.pictures import resized, without_markers
from gelgap.domains.frames.dataset import CONTACT_CLASSES, LabelledFrames, join_domains
from gelgap.domains.frames.labels import FORCE_COLUMNS, QUANTITIES, covering, known_labels, paper_range
from gelgap.domains.frames.stored import GeneratedDomain, StoredFrames

PUBLISHED_REFERENCE = "ref.jpg"
# All frames of the published parts once more, in one folder.
UNSPLIT = "ori"
PUBLISHED_PARTS = ("train", "test")
PUBLISHED_FORCES = ("Fx(N)", "Fy(N)", "Fz(N)")
PUBLISHED_LABEL = "label"
_ALIASES = {"inpainting": "wmb0i0"}

# Names under which people write the same thing; letters and digits alone count.
PICTURE_NAMES = ("image", "file", "filename", "path", "picture", "frame", "img", "imagepath", "imagefile")
NUMBERS = {
    "fx_n": ("fx", "fxn", "forcex", "forcexn"),
    "fy_n": ("fy", "fyn", "forcey", "forceyn"),
    "fz_n": ("fz", "fzn", "forcez", "forcezn"),
    "mx_nmm": ("mx", "mxnmm", "torquex", "torquexnmm"),
    "my_nmm": ("my", "mynmm", "torquey", "torqueynmm"),
    "mz_nmm": ("mz", "mznmm", "torquez", "torqueznmm"),
    "x_mm": ("xmm", "x"),
    "y_mm": ("ymm", "y"),
    "depth_mm": ("depthmm", "depth"),
    "time_s": ("times",),
}
WHOLE_NUMBERS = {"contact_class": ("contactclass", "class", "label"), "point_id": ("pointid", "point")}
GROUPS = {"clip": ("clip",), "object": ("object",), "session": ("session",)}
TEXTS = GROUPS | {"split": ("split",), "reference": ("reference",)}
COLUMNS = NUMBERS | WHOLE_NUMBERS | TEXTS
PICTURES = (".png", ".jpg", ".jpeg", ".bmp")
REFERENCE_STEMS = ("reference", "ref", "background", "bg", "nocontact")
REFERENCES = "references"


def open_domain(folder: Path | str) -> StoredFrames:
    """Open a data set: gelgap's own format, the paper's published layout, or a folder of pictures with a CSV table.

    Raises
    ------
    FileNotFoundError
        If it is not a data set of a known layout; the message says what was looked for.
    RuntimeError
        If the data set is damaged or not finished.
    ValueError
        If a table is not as it should be, or there are several.
    """
    folder = Path(folder)
    if problem := layout_problem(folder):
        raise FileNotFoundError(f"{folder} {problem}")
    if (folder / MANIFEST).exists():
        return GeneratedDomain(folder)
    return _published(folder) if _is_published(folder) else _picture_folder(folder)


def open_domains(folders: Path | str | Sequence[Path | str]) -> LabelledFrames:
    """Open a data set as `open_domain` does, or several, joined."""
    if isinstance(folders, Path | str):
        return open_domain(folders)
    return join_domains([open_domain(folder) for folder in folders])


def layout_problem(folder: Path) -> str | None:
    """Return why a folder is not a data set, and what was looked for; None if it has a known layout."""
    tables = _tables_in(folder)
    if (folder / MANIFEST).exists() or _is_published(folder) or len(tables) == 1:
        return None
    if tables:
        return (
            f"holds {len(tables)} CSV tables ({', '.join(table.name for table in tables)}): keep one, "
            "with a row per picture"
        )
    what = "does not exist" if not folder.exists() else "is not a data set"
    inside = sorted(path.parent.name for path in folder.glob(f"*/{MANIFEST}"))
    hint = f"; it holds the domains {', '.join(inside)}: name one of them" if inside else ""
    return (
        f"{what}; expected a folder with {MANIFEST} (gelgap generate), with ref.jpg and train/images "
        f"(the published layout), or with pictures and one CSV table{hint}"
    )


_LARGEST_LIKELY_N = 150.0


class PictureFiles(StoredFrames):
    """A data set whose pictures are files of their own, `picture_paths`, one per frame.

    It has one rest picture or several, of which the column `reference_id` says which is a frame's own. The digest is
    made from names, sizes and times of change of the pictures and of `further_files`: tables and rest pictures. Ranges
    of forces that were found in the frames, (3, 2) N, are not declared.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        columns: dict[str, np.ndarray],
        picture_paths: Sequence[Path],
        reference_paths: Sequence[Path],
        further_files: Sequence[Path],
        notes: Sequence[str],
        found_range_n: np.ndarray | None = None,
    ):
        self.folder, self.name, self.columns, self.notes = folder, name, columns, tuple(notes)
        self.picture_paths, self.reference_paths = picture_paths, reference_paths
        self.further_files, self.reference_count = further_files, len(reference_paths)
        self._reduced: dict[tuple[tuple[int, int], bool], np.ndarray] = {}
        if found_range_n is not None:
            self.force_range_n, self.declares_ranges = found_range_n, False

    @cached_property
    def reference(self) -> np.ndarray:
        path = self.reference_paths[0]
        return self.decoded(path.read_bytes(), f"the reference {path}", is_reference=True)

    def references_at(self, size_px: int | tuple[int, int] | None = None, markers: bool = True) -> np.ndarray:
        size = self.image_size_px(size_px)
        if (size, markers) not in self._reduced:
            pictures = map(self.reference_picture, self.reference_paths)
            self._reduced[size, markers] = np.stack(
                [resized(picture if markers else without_markers(picture), size) for picture in pictures]
            )
        return self._reduced[size, markers]

    def reference_picture(self, path: Path) -> np.ndarray:
        """Return a rest picture (h, w, 3); a ValueError if it is damaged or of another size than the first."""
        return self.decoded(path.read_bytes(), f"the rest picture {path}")

    @cached_property
    def digest(self) -> str:
        paths = [*self.picture_paths, *self.further_files]
        stats = [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in paths]
        return sha256(repr(stats).encode())

    def encoded_picture(self, index: int) -> bytes:
        return self.picture_paths[index].read_bytes()

    def place_of(self, index: int) -> str:
        return str(self.picture_paths[index].relative_to(self.folder))


def read_table(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV table by the names of its columns, without spaces around names and values."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            header = reader.fieldnames or ()
            if len(header) == 1 and any(mark in header[0] for mark in ";\t"):
                raise ValueError(
                    f"{path} has no comma in its header {quoted(header[0])}: separate columns by commas"
                )
            return [
                {name.strip(): (value or "").strip() for name, value in row.items() if name is not None}
                for row in reader
            ]
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not a CSV table in UTF-8: {error}") from None


def _tables_in(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.csv"))


def _is_published(folder: Path) -> bool:
    parts = (folder / part / "images" for part in (*PUBLISHED_PARTS, UNSPLIT))
    return (folder / PUBLISHED_REFERENCE).is_file() and any(part.is_dir() for part in parts)


def _published(folder: Path) -> PictureFiles:
    """Read a domain of the published data set, with its irregularities handled and noted.

    Row i of `force.csv` belongs to `i.jpg`; columns are found by name. Where the parts `train` and `test` exist they
    are read, and `ori`, which repeats them, is not. A part whose rows and pictures do not match is an error.
    """
    domain, notes = _ALIASES.get(folder.name, folder.name), []
    if domain != folder.name:
        notes.append(f"the folder {folder.name!r} is the domain {domain}")
    parts = [part for part in PUBLISHED_PARTS if (folder / part / "images").is_dir()] or [UNSPLIT]
    if parts != [UNSPLIT] and (folder / UNSPLIT).is_dir():
        notes.append(f"{UNSPLIT}/ repeats the frames of {' and '.join(parts)}: not read")
    tables = [folder / part / "forcePosition" / "force.csv" for part in parts]
    read = [_published_part(table) for table in tables]
    paths = [path for own, _ in read for path in own]
    names = [name for name in read[0][1] if all(name in values for _, values in read)]
    columns = {name: np.concatenate([values[name] for _, values in read]) for name in names}
    classes = columns.get("contact_class")
    if classes is None:
        notes.append("the table has no contact labels: contact classes are off")
    else:
        columns["contact_class"] = classes % CONTACT_CLASSES
        if beyond := int((classes >= CONTACT_CLASSES).sum()):
            notes.append(f"{beyond} labels are running numbers: taken modulo {CONTACT_CLASSES}")
    if parts != [UNSPLIT]:
        counts = [len(own) for own, _ in read]
        columns["split"] = np.repeat(np.array(parts, dtype=object), counts)
    columns["frame_id"] = np.arange(len(paths))
    declared = LabelledFrames.force_range_n
    forces = np.stack([columns[name] for name in FORCE_COLUMNS], axis=1)
    forces = forces[np.isfinite(forces).all(axis=1)]
    if outside := int(((forces < declared[:, 0]) | (forces > declared[:, 1])).any(axis=1).sum()):
        smallest, largest = (np.round(part, 3).tolist() for part in (forces.min(axis=0), forces.max(axis=0)))
        notes.append(
            f"{outside} of {len(paths)} frames have a force outside the declared range {declared.tolist()} N: "
            f"found {smallest}…{largest} N"
        )
    reference = folder / PUBLISHED_REFERENCE
    return PictureFiles(folder, domain, columns, paths, [reference], [reference, *tables], notes)


def _published_part(table: Path) -> tuple[list[Path], dict[str, np.ndarray]]:
    """Return the pictures of a part and its columns: forces, and contact classes where every row has one."""
    part = table.parents[1]
    try:
        rows = read_table(table)
    except FileNotFoundError:
        raise FileNotFoundError(f"{table} is missing; every part has its forces there") from None
    names = list(rows[0]) if rows else PUBLISHED_FORCES
    if missing := [name for name in PUBLISHED_FORCES if name not in names]:
        raise ValueError(f"{table} lacks the columns {', '.join(missing)}; it has {', '.join(names)}")
    found = sum(1 for path in (part / "images").glob("*.jpg") if path.stem.isdigit())
    if found != len(rows):
        raise ValueError(
            f"{part} has {found} pictures and {len(rows)} rows of forces ({table}); they must match"
        )
    paths = [part / "images" / f"{number}.jpg" for number in range(found)]
    if gone := [path for path in paths if not path.is_file()]:
        raise ValueError(f"{gone[0]} is missing; a row of {table} belongs to it")
    wanted = dict(zip(FORCE_COLUMNS, PUBLISHED_FORCES, strict=True))
    if all(row.get(PUBLISHED_LABEL) for row in rows):
        wanted["contact_class"] = PUBLISHED_LABEL
    return paths, {ours: _values(ours, theirs, rows, table) for ours, theirs in wanted.items()}


def _picture_folder(folder: Path) -> PictureFiles:
    """Read a folder with one CSV table: a column that names the picture, and one at least that is a label.

    Pictures lie in the folder or in its `images/`. Labels beyond the paper's ranges of forces widen them to the next
    0.1 N, which is noted.
    """
    (table,) = _tables_in(folder)
    rows = read_table(table)
    if not rows:
        raise ValueError(f"{table} has no rows; expected one per picture")
    header = [name for name in rows[0] if name]
    picture = _find(header, PICTURE_NAMES)
    found = {ours: theirs for ours, names in COLUMNS.items() if (theirs := _find(header, names))}
    has = f"it has {', '.join(header)}: expected for example picture, fx_n, fy_n, fz_n"
    if picture is None:
        raise ValueError(f"{table} lacks a column that names the picture; {has}")
    if not known_labels(found):
        raise ValueError(
            f"{table} has no label, of which one at least is needed ({', '.join(QUANTITIES)}); {has}"
        )
    paths = [_picture_path(table, row[picture]) for row in rows]
    columns = {"frame_id": np.arange(len(rows))}
    columns |= {ours: _values(ours, found[ours], rows, table) for ours in found if ours != "reference"}
    notes = []
    if repeated := len(paths) - len(set(paths)):
        notes.append(f"{repeated} rows name a picture that a row before them names")
    forces_n = [
        np.abs(columns[name]).max(initial=0, where=np.isfinite(columns[name]))
        for name in FORCE_COLUMNS
        if name in columns
    ]
    if forces_n and max(forces_n) > _LARGEST_LIKELY_N:
        notes.append(f"forces reach {max(forces_n):g} N, beyond any such sensor's: are they in mN?")
    ranges = LabelledFrames.force_range_n.copy()
    for axis, name in enumerate(FORCE_COLUMNS):
        if name in columns:
            ranges[axis] = covering(columns[name], paper_range(name))
    if not np.array_equal(ranges, LabelledFrames.force_range_n):
        told = (
            f"{QUANTITIES[name].symbol} {low:g}…{high:g}"
            for name, (low, high) in zip(FORCE_COLUMNS, ranges, strict=True)
            if name in columns
        )
        notes.append(f"forces go beyond the paper's range: the declared range is {', '.join(told)} N")
    named = [row[found["reference"]] for row in rows] if "reference" in found else None
    references = _references(table, columns, named, paths, notes)
    return PictureFiles(folder, folder.name, columns, paths, references, [table, *references], notes, ranges)


def _find(header: list[str], names: tuple[str, ...]) -> str | None:
    return next((column for column in header if _plain(column) in names), None)


def _plain(name: str) -> str:
    return "".join(letter for letter in name.lower().split("(")[0] if letter.isalnum())


def _picture_path(table: Path, name: str) -> Path:
    folder = table.parent
    if not stays_inside(name):
        raise ValueError(f"{table} names the picture {name!r}: pictures must lie in {folder}")
    for place in (folder / name, folder / "images" / name):
        if place.is_file():
            return place
    raise FileNotFoundError(
        f"{table} names the picture {name!r}, which is neither in {folder} nor in images/"
    )


def _values(ours: str, theirs: str, rows: list[dict[str, str]], table: Path) -> np.ndarray:
    values = [row[theirs] for row in rows]
    if ours in TEXTS:
        if ours in GROUPS and not all(values):
            raise ValueError(f"{table}, column {theirs!r}: every row must hold a name")
        return np.array(values, dtype=object)
    numbers = np.empty(len(values))
    for row, value in enumerate(values):
        try:
            numbers[row] = float(value)
        except ValueError:
            raise ValueError(
                f"{table}, column {theirs!r}: every row must hold a number, and row {row + 1} below the header holds "
                f"{quoted(value) if value else 'nothing'}"
            ) from None
    if ours not in WHOLE_NUMBERS:
        return numbers
    if not (np.abs(numbers) < 2**31).all():
        raise ValueError(f"{table}, column {theirs!r}: every row must hold a whole number")
    return numbers.astype(np.int64)


def _references(
    table: Path, columns: dict[str, np.ndarray], named: list[str] | None, paths: list[Path], notes: list[str]
) -> list[Path]:
    """Return the rest pictures; where frames have their own, the column `reference_id` says which.

    That of a row is what its column `reference` names, or else that of its clip, `references/<clip>.png`. Without
    either all rows share one: the picture called reference, ref, background or bg, or else the frame that shows least
    contact, which is noted.
    """
    folder = table.parent
    if named is not None:
        own = [_picture_path(table, name) for name in named]
    elif "clip" in columns and (folder / REFERENCES).is_dir():
        of_clip = {clip: _clip_reference(table, clip) for clip in dict.fromkeys(columns["clip"])}
        own = [of_clip[clip] for clip in columns["clip"]]
    else:
        for path in sorted([*folder.iterdir(), *(folder / "images").glob("*")]):
            if path.suffix.lower() in PICTURES and _plain(path.stem) in REFERENCE_STEMS:
                return [path]
        index, why = _lightest_touch(folder, columns)
        notes.append(f"no reference picture: frame {index}, {why}, takes its place")
        return [paths[index]]
    number = {path: i for i, path in enumerate(dict.fromkeys(own))}
    columns["reference_id"] = np.array([number[path] for path in own])
    return list(number)


def _clip_reference(table: Path, clip: str) -> Path:
    folder = table.parent
    if not stays_inside(clip):
        raise ValueError(f"{table} names the clip {clip!r}: its rest picture must lie in {folder}")
    for ending in PICTURES:
        if (path := folder / REFERENCES / f"{clip}{ending}").is_file():
            return path
    raise FileNotFoundError(
        f"clip {clip!r} of {table} has no rest picture; expected {folder / REFERENCES / clip}.png"
    )


def _lightest_touch(folder: Path, columns: dict[str, np.ndarray]) -> tuple[int, str]:
    """Return the frame that shows least contact, and why: of class 0, or of the smallest force or depth."""
    forces = [columns[name] for name in FORCE_COLUMNS if name in columns]
    size = np.linalg.norm(forces, axis=0) if forces else columns.get("depth_mm")
    classes = columns.get("contact_class")
    if classes is not None and (classes == 0).any():
        index = int(np.flatnonzero(classes == 0)[0])
    elif size is not None:
        index = int(np.nan_to_num(size, nan=np.inf).argmin())
    else:
        raise FileNotFoundError(
            f"{folder} has no reference picture: put reference.png there, or name rest pictures in a column reference"
        )
    if size is None:
        return index, "of class 0"
    return index, f"with a force of {size[index]:.3f} N" if forces else f"at a depth of {size[index]:.3f} mm"
