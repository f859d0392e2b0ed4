"""Reading TOML files, with one sentence that names the file where one is not right."""

import contextlib
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

MOST_BYTES = 2**20


def read_toml(path: Path | str) -> dict[str, Any]:
    """Return the tables of a TOML file.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is empty, larger than 1 MiB or not valid TOML in UTF-8; the message names the file and the place.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"{path} {'is a folder, not a TOML file' if path.is_dir() else 'does not exist'}"
        )
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size} bytes; TOML files have at most {MOST_BYTES}")
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"{path} is not valid TOML: {error}") from None
    if not values:
        raise ValueError(f"{path} is empty: it states no field")
    return values


@contextlib.contextmanager
def named_in_errors(what: Path | str) -> Iterator[None]:
    """Put the name of a file, or of something else, in front of a ValueError about it, unless it is there."""
    try:
        yield
    except ValueError as error:
        if str(what) in str(error):
            raise
        raise ValueError(f"{what}: {error}") from None
