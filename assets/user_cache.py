"""The user's cache folder, which rooms share without knowing each other, and writing to it."""

import os
import tempfile
from pathlib import Path


def cache_folder() -> Path:
    """Return $GELGAP_CACHE, or `gelgap` in the user's cache folder."""
    chosen = os.environ.get("GELGAP_CACHE")
    if chosen:
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gelgap"


def write_cached(path: Path, content: bytes) -> None:
    """Write a file to a temporary name and rename it, so that readers and concurrent writers see it whole.

    Raises
    ------
    OSError
        If the file cannot be written; nothing of it is left.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
