"""Files that are there completely or not at all, also after a crash or on a full disk."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

TEMPORARY_SUFFIX = ".tmp"


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give the name of a temporary file to write; it takes the place of `path` when the block ends without error.

    Readers and concurrent writers see the old file or the new one, never a part. The temporary file lies beside `path`,
    begins with a dot and ends in `.tmp`; nothing of it is left after an error.

    Raises
    ------
    RuntimeError
        If the disk does not take the file; what was there before is untouched.
    """
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=TEMPORARY_SUFFIX)
        os.close(descriptor)
        temporary = Path(name)
        yield temporary
        # The permissions that an ordinary new file has.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise RuntimeError(
            f"cannot write {path}: {error.strerror or error}; what is finished is safe: "
            "make room and run the same command again to complete it"
        ) from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file completely or not at all; raises what `whole_file` does."""
    with whole_file(path) as temporary:
        temporary.write_bytes(data)
