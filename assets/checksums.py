"""SHA-256 of bytes, of files, of a folder (in the form of `sha256sum --check`), and of JSON that carries its own."""

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gelgap.assets.whole_file import write_whole

SUMS = "SHA256SUMS"
CHECKSUM = "sha256"
_LINE = re.compile(r"([0-9a-f]{64})  (\S.*)")


def sha256(data: bytes) -> str:
    """Return the SHA-256 of bytes as hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file, read in pieces."""
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


def parse_json(data: bytes | str) -> Any:
    """Return the value of JSON text in UTF-8, or raise ValueError; the message does not name the file."""
    try:
        return json.loads(data)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def canonical_json(value: Any) -> bytes:
    """Return the one JSON text of a value: sorted keys, so that equal values hash equally."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()


def with_checksum(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values and, as `sha256`, the checksum of their canonical JSON."""
    return {**values, CHECKSUM: sha256(canonical_json(values))}


def without_checksum(values: Any) -> dict[str, Any]:
    """Return what `with_checksum` was given, or raise ValueError if that is not what is there."""
    content = {name: values[name] for name in values if name != CHECKSUM} if isinstance(values, dict) else {}
    try:
        intact = with_checksum(content) == values
    except (RecursionError, UnicodeEncodeError):
        intact = False
    if not intact:
        raise ValueError("its own checksum does not match")
    return content
