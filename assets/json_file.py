"""Reading JSON that anyone may have written, and JSON that carries its own checksum."""

import hashlib
import json
from pathlib import Path
from typing import Any

MOST_BYTES = 2**28
CHECKSUM = "sha256"


def parse_json(data: bytes | str) -> Any:
    """Return the value of JSON text in UTF-8.

    Raises
    ------
    ValueError
        If it is none; the message does not name the file.
    """
    try:
        return json.loads(data)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except UnicodeDecodeError:
        raise ValueError("it is not text in UTF-8") from None


def read_json(path: Path) -> Any:
    """Return the value of a JSON file.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not JSON, or larger than 256 MiB; the message does not name the file.
    """
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"it is larger than {MOST_BYTES // 2**20} MiB")
    return parse_json(path.read_bytes())


def canonical_json(value: Any) -> bytes:
    """Return the one JSON text of a value: sorted keys, so that equal values hash equally."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()


def with_checksum(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values and, as `sha256`, the checksum of their canonical JSON."""
    return {**values, CHECKSUM: hashlib.sha256(canonical_json(values)).hexdigest()}


def without_checksum(values: Any) -> dict[str, Any]:
    """Return what `with_checksum` was given.

    Raises
    ------
    ValueError
        If that is not what is there.
    """
    if not isinstance(values, dict):
        raise ValueError("its own checksum does not match")
    content = {name: value for name, value in values.items() if name != CHECKSUM}
    try:
        intact = with_checksum(content)[CHECKSUM] == values.get(CHECKSUM)
    except (RecursionError, UnicodeEncodeError):
        intact = False
    if not intact:
        raise ValueError("its own checksum does not match")
    return content
