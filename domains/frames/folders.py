"""Opening a data set, whichever layout it has: gelgap's own, the paper's published one, or pictures with a table.

Published: `<domain>/{train,test,ori}/images/0.jpg …` with `forcePosition/force.csv`. Real data as people keep them: a
folder of pictures and one CSV table with named columns, as of a GelSight Mini.
"""

import csv
from collections.abc import Iterable, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from gelgap.assets.checksums import sha256
from gelgap.assets.names import quoted, stays_inside
from gelgap.domains.formats.domain_folder import MANIFEST
from gelgap.domains.frames.dataset import CONTACT_CLASSES, LabelledFrames, join_domains
from gelgap.domains.frames.labels import (
    FORCE_COLUMNS,
    PAPER_RANGES,
    QUANTITIES,
    Labels,
    covering,
    known_labels,
)
from gelgap.domains.frames.stored import GeneratedDomain, StoredFrames

PUBLISHED_REFERENCE = "ref.jpg"
# All frames of the published parts once more, in one folder.
UNSPLIT = "ori"
PUBLISHED_PARTS = ("train", "test")
PUBLISHED_FORCES = ("Fx(N)", "Fy(N)", "Fz(N)")
_ALIASES = {"inpainting": "wmb0i0"}

# Names under which people write the same thing; letters and digits alone count.
PICTURE_NAMES = ("image", "file", "filename", "path", "picture", "frame", "img", "imagepath", "imagefile")
NUMBERS = {
    **{f"f{axis}_n": (f"f{axis}", f"f{axis}n", f"force{axis}", f"force{axis}n") for axis in "xyz"},
    **{f"m{axis}_nmm": (f"m{axis}", f"m{axis}nmm", f"torque{axis}", f"torque{axis}nmm") for axis in "xyz"},
    "x_mm": ("xmm", "x"),
    "y_mm": ("ymm", "y"),
    "depth_mm": ("depthmm", "depth"),
    "time_s": ("times",),
}
WHOLE_NUMBERS = {"contact_class": ("contactclass", "class", "label"), "point_id": ("pointid", "point")}
GROUPS = {"clip": ("clip",), "object": ("object",), "session": ("session",)}
TEXTS = GROUPS | {"split": ("split",), "reference": ("reference",), "picture": PICTURE_NAMES}
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


def domain_folders(folder: Path | str) -> tuple[Path, ...]:
    """Return the folders of generated domains directly inside a folder; itself where there are none.

    Raises
    ------
    FileNotFoundError
        If there is no such folder.
    """
    if not Path(folder).exists():
        raise FileNotFoundError(f"{folder} does not exist; a folder of one domain, or of several, is needed")
    inside = sorted(path.parent for path in Path(folder).glob(f"*/{MANIFEST}"))
    return tuple(inside) or (Path(folder),)


def layout_problem(folder: Path) -> str | None:
    """Return why a folder is not a data set, and what was looked for; None if it has a known layout."""
    tables = sorted(folder.glob("*.csv"))
    if (folder / MANIFEST).exists() or _is_published(folder) or len(tables) == 1:
        return None
    if tables:
        return (
            f"holds {len(tables)} CSV tables ({', '.join(table.name for table in tables)}): keep one, "
            "with a row per picture"
        )
    what = "does not exist" if not folder.exists() else "is not a data set"
    inside = [path.name for path in domain_folders(folder) if path != folder] if folder.exists() else []
    hint = f"; it holds the domains {', '.join(inside)}: name one of them" if inside else ""
    return (
        f"{what}; expected a folder with {MANIFEST} (gelgap generate), with ref.jpg and train/images "
        f"(the published layout), or with pictures and one CSV table{hint}"
    )


_LARGEST_LIKELY_N = 150.0


class PictureFiles(StoredFrames):
    """A data set whose pictures are files of their own, `picture_paths`, one per frame.

    It has one rest picture or several, of which the column `reference_id` says which is a frame's own. The digest is
    made from names, sizes and times of change of the pictures and of `further_files`: tables and rest pictures.
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
    ):
        super().__init__(folder, reference_paths)
        self.name, self.columns, self.notes = name, columns, tuple(notes)
        self.picture_paths, self.further_files = picture_paths, further_files

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
    elif beyond := int((classes >= CONTACT_CLASSES).sum()):
        columns["contact_class"] = np.where(classes < 0, classes, classes % CONTACT_CLASSES)
        notes.append(f"{beyond} labels are running numbers: taken modulo {CONTACT_CLASSES}")
    if parts != [UNSPLIT]:
        columns["split"] = np.repeat(np.array(parts, dtype=object), [len(own) for own, _ in read])
    columns["frame_id"] = np.arange(len(paths))
    reference = folder / PUBLISHED_REFERENCE
    return PictureFiles(folder, domain, columns, paths, [reference], [reference, *tables], notes)


def _published_part(table: Path) -> tuple[list[Path], dict[str, np.ndarray]]:
    """Return the pictures of a part and its columns: forces, and contact classes where every row has one."""
    part = table.parents[1]
    if not table.is_file():
        raise FileNotFoundError(f"{table} is missing; every part has its forces there")
    columns, classes = known_columns(table, FORCE_COLUMNS), [row.get("label") for row in read_table(table)]
    if all(classes):
        columns["contact_class"] = _whole_numbers(classes, f"{table}, column 'label'")
    if not set(FORCE_COLUMNS) <= columns.keys():
        raise ValueError(f"{table} lacks one of the columns {', '.join(PUBLISHED_FORCES)}")
    paths = [part / "images" / f"{number}.jpg" for number in range(len(columns["fz_n"]))]
    found = {path for path in (part / "images").glob("*.jpg") if path.stem.isdigit()}
    if found != set(paths):
        raise ValueError(
            f"{part} has {len(found)} pictures and {len(paths)} rows of forces ({table}): they must match, "
            "row i and images/i.jpg"
        )
    return paths, columns


def _picture_folder(folder: Path) -> PictureFiles:
    """Read a folder with one CSV table: a column that names the picture, and one at least that is a label.

    Pictures lie in the folder or in its `images/`. Labels beyond the paper's ranges of forces widen them to the next
    0.1 N, which is noted.
    """
    (table,) = folder.glob("*.csv")
    columns, notes = known_columns(table), []
    if "picture" not in columns or not known_labels(columns):
        raise ValueError(
            f"{table} has no label, or names no pictures: it needs a column picture and at least one of "
            f"{', '.join(QUANTITIES)}; it has {', '.join(read_table(table)[0])}"
        )
    paths = [picture_path(table, name) for name in columns.pop("picture")]
    columns = {"frame_id": np.arange(len(paths))} | columns
    if repeated := len(paths) - len(set(paths)):
        notes.append(f"{repeated} rows name a picture that a row before them names")
    forces = [name for name in FORCE_COLUMNS if name in columns]
    ranges = PAPER_RANGES | {name: covering(columns[name], PAPER_RANGES[name]) for name in forces}
    if ranges != PAPER_RANGES:
        told = Labels.of({name: ranges[name] for name in forces})
        notes.append(f"forces go beyond the paper's range: the declared range is {told}")
    if (largest_n := np.abs(list(ranges.values())).max()) > _LARGEST_LIKELY_N:
        notes.append(f"forces reach {largest_n:g} N, beyond any such sensor's: are they in mN?")
    references = _references(table, columns, paths, notes)
    frames = PictureFiles(folder, folder.name, columns, paths, references, [table, *references], notes)
    frames.force_range_n, frames.declares_ranges = np.array(list(ranges.values())), False
    return frames


def known_columns(table: Path, wanted: Iterable[str] = COLUMNS) -> dict[str, np.ndarray]:
    """Return the wanted columns that a table has, (n,) each by our name: numbers, whole numbers, or texts.

    Numbers of classes and points are left out if no row has one.

    Raises
    ------
    ValueError
        If there is no row, or a cell is not what its column needs.
    """
    rows = read_table(table)
    if not rows:
        raise ValueError(f"{table} has no rows")
    found: dict[str, np.ndarray] = {}
    for ours in wanted:
        theirs = next((name for name in rows[0] if name and _plain(name) in COLUMNS[ours]), None)
        if theirs is None:
            continue
        values, where = [row[theirs] for row in rows], f"{table}, column {theirs!r}"
        if ours in TEXTS:
            if ours in GROUPS and not all(values):
                raise ValueError(f"{where}: every row must hold a name")
            found[ours] = np.array(values, dtype=object)
        elif ours in NUMBERS:
            found[ours] = _numbers(values, where)
        elif any(values):
            found[ours] = _whole_numbers(values, where)
    return found


def _numbers(values: list[str], where: str) -> np.ndarray:
    numbers = np.empty(len(values))
    for row, value in enumerate(values):
        try:
            numbers[row] = float(value)
        except ValueError:
            raise ValueError(
                f"{where}: every row must hold a number, and row {row + 1} below the header holds "
                f"{quoted(value) if value else 'nothing'}"
            ) from None
    return numbers


def _whole_numbers(values: list[str], where: str) -> np.ndarray:
    numbers = _numbers(values, where)
    if not (np.abs(numbers) < 2**31).all():
        raise ValueError(f"{where}: every row must hold a whole number")
    return numbers.astype(np.int64)


def _plain(name: str) -> str:
    return "".join(letter for letter in name.lower().split("(")[0] if letter.isalnum())


def _references(
    table: Path, columns: dict[str, np.ndarray], paths: list[Path], notes: list[str]
) -> list[Path]:
    """Return the rest pictures; where frames have their own, the column `reference_id` says which.

    That of a row is what its column `reference` names, or else that of its clip, `references/<clip>.png`. Without
    either all rows share one: the picture called reference, ref, background or bg, or else the frame that shows least
    contact, which is noted.
    """
    folder = table.parent
    if "reference" in columns:
        own = [picture_path(table, name) for name in columns.pop("reference")]
    elif "clip" in columns and (folder / REFERENCES).is_dir():
        of_clip = {
            clip: _file_of(table, f"clip {clip!r}", [f"{REFERENCES}/{clip}{ending}" for ending in PICTURES])
            for clip in dict.fromkeys(columns["clip"])
        }
        own = [of_clip[clip] for clip in columns["clip"]]
    else:
        for path in sorted([*folder.iterdir(), *(folder / "images").glob("*")]):
            if path.suffix.lower() in PICTURES and _plain(path.stem) in REFERENCE_STEMS:
                return [path]
        index = _lightest_touch(folder, columns)
        notes.append(f"no reference picture: frame {index}, which shows least contact, takes its place")
        return [paths[index]]
    number = {path: i for i, path in enumerate(dict.fromkeys(own))}
    columns["reference_id"] = np.array([number[path] for path in own])
    return list(number)


def picture_path(table: Path, name: str) -> Path:
    """Return the picture that a table names, in its folder or `images/`; a ValueError if it is not there."""
    return _file_of(table, f"the picture {name!r}", [name, f"images/{name}"])


def _file_of(table: Path, what: str, places: Sequence[str]) -> Path:
    """Return the first of some places in a table's folder that has a file, of what the table names."""
    for place in places:
        if not stays_inside(place):
            raise ValueError(f"{table} names {what}: pictures must lie in {table.parent}")
        if (path := table.parent / place).is_file():
            return path
    raise ValueError(
        f"{table} names {what}, which is not there: expected {' or '.join(places)} in {table.parent}"
    )


def _lightest_touch(folder: Path, columns: dict[str, np.ndarray]) -> int:
    """Return the frame that shows least contact: of class 0, or of the smallest force or depth."""
    is_untouched = columns.get("contact_class", np.ones(1)) == 0
    if is_untouched.any():
        return int(is_untouched.argmax())
    forces = [columns[name] for name in FORCE_COLUMNS if name in columns]
    size = np.linalg.norm(forces, axis=0) if forces else columns.get("depth_mm")
    if size is None:
        raise FileNotFoundError(
            f"{folder} has no reference picture: put reference.png there, or name rest pictures in a column reference"
        )
    return int(np.nan_to_num(size, nan=np.inf).argmin())
