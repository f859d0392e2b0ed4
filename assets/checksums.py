"""SHA-256 sums of a folder's files, in the form that `sha256sum --check` reads, and what differs from them."""

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path

from gelgap.assets.whole_file import write_whole

SUMS = "SHA256SUMS"
_LINE = re.compile(r"([0-9a-f]{64})  (\S.*)")


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file as hexadecimal digits, read in pieces."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_checksums(folder: Path, sums: Mapping[str, str]) -> None:
    """Write the list of a folder, SHA-256 by the name of the file; files that it names already stay in it."""
    every = _listed(folder) | sums
    write_whole(folder / SUMS, "".join(f"{digest}  {name}\n" for name, digest in every.items()).encode())


def checksum_problem(path: Path) -> str | None:
    """Return how a file differs from the list beside it; None if it does not, or if no list names it."""
    sums = _listed(path.parent)
    if path.name not in sums or not path.is_file() or file_sha256(path) == sums[path.name]:
        return None
    return f"is damaged: it has not the SHA-256 that {SUMS} states"


def _listed(folder: Path) -> dict[str, str]:
    try:
        lines = (folder / SUMS).read_bytes().decode(errors="replace").splitlines()
    except OSError:
        return {}
    return {match[2]: match[1] for line in lines if (match := _LINE.fullmatch(line))}
