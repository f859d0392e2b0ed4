"""Files that cannot be used: the sentence about one, and setting aside those that are made again."""

import contextlib
import logging
from pathlib import Path

DAMAGED_SUFFIX = ".damaged"


def warn(sentence: str) -> None:
    """Say on standard error what is wrong with a file that is made again."""
    logging.getLogger("gelgap").warning("gelgap: %s", sentence)


def set_aside(path: Path, why: str) -> None:
    """Rename a cached file that cannot be used and say so on standard error; the caller makes it again."""
    with contextlib.suppress(OSError):
        path.replace(path.with_name(f"{path.name}{DAMAGED_SUFFIX}"))
    warn(f"{path} {why}: set aside as {path.name}{DAMAGED_SUFFIX} and made again")
