"""Opening a data set, whichever layout it has: gelgap's own, the paper's published one, or pictures with a table.

Published: `<domain>/{train,test,ori}/images/0.jpg …` with `forcePosition/force.csv`. Real data as people keep them: a
folder of pictures and one CSV table with named columns, as of a GelSight Mini.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from functools import cached_property
from pathlib import Path, PurePosixPath
from unicodedata import normalize

import numpy as np

from gelgap.assets.checksums import file_sha256, sha256
from gelgap.assets.image_file import SUFFIXES, picture_files, visible_files
from gelgap.assets.names import comma_list, stays_inside
from gelgap.assets.pinhole import Pinhole
from gelgap.assets.toml_file import named_in_errors, read_toml
from gelgap.data.formats.domain_folder import MANIFEST
from gelgap.data.formats.pictures import REFERENCE_STEMS
from gelgap.data.frames.dataset import CONTACT_CLASSES, LabelledFrames
from gelgap.data.frames.joined import join_domains
from gelgap.data.frames.labels import FORCE_COLUMNS, PAPER_RANGES, Labels, covering
from gelgap.data.frames.stored import GeneratedDomain, StoredFrames
from gelgap.data.frames.tables import known_columns, plain_name

SENSOR_FILE = "sensor.toml"
"""Says of a folder of pictures how many mm a pixel shows."""
PUBLISHED_REFERENCE = "ref.jpg"
# All frames of the published parts once more, in one folder.
UNSPLIT = "ori"
PUBLISHED_PARTS = ("train", "test")
PUBLISHED_FORCES = ("Fx(N)", "Fy(N)", "Fz(N)")
_ALIASES = {"inpainting": "wmb0i0"}

REFERENCES = "references"
IMAGES = "images"
TABLES = (".csv", ".tsv")


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
    if (folder / MANIFEST).exists():
        return GeneratedDomain(folder)
    if _is_published(folder):
        return _published(folder)
    files = visible_files(folder, folder / IMAGES)
    pictures = picture_files(files)
    if problem := _layout_problem(folder, files, pictures):
        raise FileNotFoundError(f"{folder} {problem}")
    return _picture_folder(folder, files, pictures)


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


def _layout_problem(folder: Path, files: list[Path], pictures: list[Path]) -> str | None:
    """Return why a folder has not one table, or pictures alone, and what was looked for; None if it has."""
    tables = _tables(folder, files)
    if len(tables) == 1:
        return None
    if tables:
        return (
            f"holds {len(tables)} CSV tables ({', '.join(table.name for table in tables)}): keep one, "
            "with a row per picture"
        )
    inside = [path.name for path in domain_folders(folder) if path != folder] if folder.exists() else []
    if not inside and not all(map(_is_reference, pictures)):
        sheets = [path.name for path in files if path.suffix.lower() in (".xlsx", ".xls", ".ods")]
        if sheets and not any(map(_is_reference, files)):
            return f"has pictures and no CSV table: save {', '.join(sheets)} as CSV, with a column picture"
        return None
    for deeper in ("[!.]*/*", "[!.]*/[!.]*/*"):
        found = (path for path in folder.glob(deeper) if path.suffix.lower() in (*TABLES, *SUFFIXES))
        inside = inside or sorted({str(path.parent.relative_to(folder)) for path in found})
    what = "does not exist" if not folder.exists() else "is not a data set"
    hint = f"did you mean {comma_list(inside)} in it?" if inside else "for arrays: gelgap.data.ArrayFrames"
    return (
        f"{what}; expected a folder with {MANIFEST} (gelgap generate), with ref.jpg and train/images "
        f"(the published layout), or with pictures ({', '.join(SUFFIXES)}) and at most one CSV table; {hint}"
    )


def tables_in(folder: Path) -> list[Path]:
    """Return the tables of a folder."""
    return _tables(folder, visible_files(folder))


def _tables(folder: Path, files: list[Path]) -> list[Path]:
    return [path for path in files if path.parent == folder and path.suffix.lower() in TABLES]


def _is_reference(picture: Path) -> bool:
    return plain_name(picture.stem) in REFERENCE_STEMS


class PictureFiles(StoredFrames):
    """A data set whose pictures are files of their own, `picture_paths`, one per frame.

    It has one rest picture or several, of which the column `reference_id` says which is a frame's own. The digest is
    made from names, sizes and times of change of all files, and from the bytes of uncompressed pictures, which have one
    size. `further_files` are tables and rest pictures; `sensor.toml` a sensor's, or a line such as `mm_per_px = 0.05`.
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
        paths = [*self.picture_paths, *self.further_files, *self.folder.glob(SENSOR_FILE)]
        stats = [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in paths]
        stats += [(file_sha256(path),) for path in paths if path.suffix.lower() in (".bmp", ".tif", ".tiff")]
        return sha256(repr(stats).encode())

    @cached_property
    def cameras(self) -> Sequence[Pinhole | None]:
        file = self.folder / SENSOR_FILE
        camera = _camera_of(file, self.size_px[0]) if file.exists() else None
        return [camera] * len(self.rest_pictures)

    def encoded_picture(self, index: int) -> bytes:
        return self.picture_paths[index].read_bytes()

    def place_of(self, index: int) -> str:
        return str(self.picture_paths[index].relative_to(self.folder))


def _camera_of(file: Path, width_px: int) -> Pinhole:
    """Return the camera's geometry in a sensor file, or one with the file's `mm_per_px`."""
    values = read_toml(file)
    with named_in_errors(file):
        if set(values) != {"mm_per_px"}:
            if "camera" not in values:
                raise ValueError("it has neither mm_per_px alone nor a sensor's table [camera]")
            return Pinhole.of_camera(values["camera"])
        if type(scale := values["mm_per_px"]) not in (float, int) or not scale > 0:
            raise ValueError(f"mm_per_px = {scale!r}: must be a number above 0")
        return Pinhole.showing(width_px * scale)


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
    columns, _ = known_columns(table, (*FORCE_COLUMNS, "contact_class"))
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


def _picture_folder(folder: Path, files: list[Path], pictures: list[Path]) -> PictureFiles:
    """Read a folder of pictures; a CSV table names them and gives their labels, or else none has any.

    Pictures lie in the folder or in its `images/`. Labels beyond the paper's ranges of forces widen them to the next
    0.1 N, which is noted.
    """
    tables = _tables(folder, files)
    if tables:
        columns, notes = known_columns(tables[0], needed=["picture"])
        paths = picture_paths(tables[0], columns.pop("picture"))
    else:
        columns, notes = {}, []
        paths = [path for path in pictures if not _is_reference(path)]
        if others := Counter(
            "folders" if path.is_dir() else path.suffix.lower()
            for path in files
            if path.suffix.lower() not in SUFFIXES
            and path.name not in (IMAGES, SENSOR_FILE, "Thumbs.db", "desktop.ini")
        ):
            kinds = ", ".join(f"{count} {kind or 'others'}" for kind, count in others.items())
            notes.append(f"not read, beside {len(paths)} pictures without a table: {kinds}")
        if twice := len(paths) - len({path.with_suffix("") for path in paths}):
            notes.append(f"{twice} pictures have the name of another and a different ending: each is a frame")
    columns = {"frame_id": np.arange(len(paths))} | columns
    if repeated := len(paths) - len(set(paths)):
        notes.append(f"{repeated} rows name a picture that a row before them names")
    forces = [name for name in FORCE_COLUMNS if name in columns]
    ranges = PAPER_RANGES | {name: covering(columns[name], PAPER_RANGES[name]) for name in forces}
    if ranges != PAPER_RANGES:
        told = Labels.of({name: ranges[name] for name in forces})
        notes.append(f"forces go beyond the paper's range: the declared range is {told}")
    own = _own_references(tables[0], columns) if tables else []
    references = list(dict.fromkeys(own)) or [_shared_reference(folder, pictures, columns, paths, notes)]
    if unnamed := sum(not _is_reference(path) for path in set(pictures) - {*paths, *references}):
        notes.append(f"{unnamed} pictures have no row in the table: not read")
    if own:
        columns["reference_id"] = np.array([references.index(path) for path in own])
    frames = PictureFiles(folder, folder.name, columns, paths, references, [*tables, *references], notes)
    frames.force_range_n, frames.declares_ranges = np.array(list(ranges.values())), False
    return frames


def _own_references(table: Path, columns: dict[str, np.ndarray]) -> list[Path]:
    """Return the rest picture of each row: what its column `reference` names, or that of its clip.

    The latter is `references/<clip>.png`. Without either it is empty: all rows share one.
    """
    if "reference" in columns:
        return picture_paths(table, columns.pop("reference"))
    if "clip" not in columns or not (table.parent / REFERENCES).is_dir():
        return []
    of_clip = {
        clip: _file_of(table, f"clip {clip!r}", [f"{REFERENCES}/{clip}{ending}" for ending in SUFFIXES])
        for clip in dict.fromkeys(columns["clip"])
    }
    return [of_clip[clip] for clip in columns["clip"]]


def _shared_reference(
    folder: Path, pictures: list[Path], columns: dict[str, np.ndarray], paths: list[Path], notes: list[str]
) -> Path:
    """Return the picture called as in `REFERENCE_STEMS`, or else the frame that shows least contact, noted."""
    named = [path for path in pictures if _is_reference(path)]
    if len(named) > 1:
        notes.append(f"{len(named)} pictures are called a reference: {named[0].name} is taken")
    if named:
        return named[0]
    index = _lightest_touch(folder, columns)
    notes.append(f"no reference picture: frame {index}, which shows least contact, takes its place")
    return paths[index]


def picture_paths(table: Path, names: Iterable[str]) -> list[Path]:
    """Return the picture of each row of a table, in its folder or `images/`; a ValueError if one is not there."""
    return [
        _file_of(table, f"the picture {name!r} in row {row} below the header", [name, f"{IMAGES}/{name}"])
        for row, name in enumerate(names, 1)
    ]


def _file_of(table: Path, what: str, places: Sequence[str]) -> Path:
    """Return the first of some places in a table's folder that has a file, of what the table names."""
    # Programs on a Mac write ä in two letters.
    for place in (*places, *(normalize(form, place) for form in ("NFC", "NFD") for place in places)):
        if not stays_inside(place):
            raise ValueError(
                f"{table} names {what}: must be a path from {table.parent} to a picture in it, as "
                f"{PurePosixPath(place).name}"
            )
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
            f"{folder} has no reference picture: add a picture without contact as reference.png there, or name "
            "rest pictures in a column reference"
        )
    return int(np.nan_to_num(size, nan=np.inf).argmin())
