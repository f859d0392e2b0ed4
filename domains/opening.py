"""Opening a data set, whichever of the known layouts it has on disk."""

from pathlib import Path

from gelgap.domains.folder import MANIFEST
from gelgap.domains.generated import GeneratedDomain
from gelgap.domains.picture_folder import PictureFolder, tables_of
from gelgap.domains.published import PublishedDomain
from gelgap.domains.stored import StoredFrames


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
    for layout in (PublishedDomain, PictureFolder):
        if layout.recognises(folder):
            return layout(folder)
    raise FileNotFoundError(f"{folder} {layout_problem(folder)}")


def layout_problem(folder: Path) -> str | None:
    """Return why a folder is not a data set, and what was looked for; None if it has a known layout."""
    known = (folder / MANIFEST).exists()
    if known or any(layout.recognises(folder) for layout in (PublishedDomain, PictureFolder)):
        return None
    if len(tables := tables_of(folder)) > 1:
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
