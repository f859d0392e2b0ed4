"""The cache of a data set's decoded pictures: one npy file with its SHA-256 behind the array, memory-mapped."""

import hashlib
import io
import time
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

import numpy as np

from gelgap.assets.whole_file import warn, whole_file

# NumPy maps the array alone, so the end is no concern of other readers of the file.
_MARK = b"SHA-256\0"
_END_BYTES = len(_MARK) + hashlib.sha256().digest_size
_PIECE_BYTES = 2**20
_SETTLED_NS = 2_000_000_000


def write_kept_pictures(path: Path, shape: tuple[int, ...], pieces: Iterable[bytes]) -> None:
    """Write uint8 pictures of this shape, given piece by piece, and their checksum.

    Raises
    ------
    RuntimeError
        If the disk does not take the file.
    """
    digest = hashlib.sha256()
    # Plain writes, not a memory map: a full disk is then an error and not a crash.
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, _header(shape))
        digest.update(_start(shape))
        for piece in pieces:
            file.write(piece)
            digest.update(piece)
        file.write(_MARK + digest.digest())


def open_kept_pictures(path: Path, shape: tuple[int, ...]) -> np.ndarray | None:
    """Return the pictures, mapped so that changes never reach the file; None if there is no such file.

    A damaged file is named and not used, nor is one that an older version wrote without a checksum; the caller writes
    it again. A process checks a file once.
    """
    try:
        about = path.stat()
    except FileNotFoundError:
        return None
    if about.st_size == _array_end(shape):
        return None
    # What was written a moment ago may be written again without a later time.
    check = _is_intact if time.time_ns() - about.st_mtime_ns > _SETTLED_NS else _is_intact.__wrapped__
    if not check(path, shape, about.st_size, about.st_mtime_ns):
        warn(f"{path} is damaged (its checksum does not match): made again")
        return None
    return np.memmap(path, np.uint8, mode="c", offset=len(_start(shape)), shape=shape)


def _header(shape: tuple[int, ...]) -> dict[str, object]:
    return {"descr": "|u1", "fortran_order": False, "shape": shape}


@lru_cache
def _start(shape: tuple[int, ...]) -> bytes:
    """Return the bytes in front of the array."""
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(buffer, _header(shape))
    return buffer.getvalue()


def _array_end(shape: tuple[int, ...]) -> int:
    return len(_start(shape)) + int(np.prod(shape, dtype=np.int64))


@lru_cache(maxsize=1024)
def _is_intact(path: Path, shape: tuple[int, ...], size: int, modified_ns: int) -> bool:
    """Compare a file with its checksum; size and time of change tell its states apart."""
    left = _array_end(shape)
    if size != left + _END_BYTES:
        return False
    digest = hashlib.sha256()
    with path.open("rb") as file:
        first = file.read(len(_start(shape)))
        if first != _start(shape):
            return False
        digest.update(first)
        left -= len(first)
        while left and (piece := file.read(min(_PIECE_BYTES, left))):
            digest.update(piece)
            left -= len(piece)
        return file.read() == _MARK + digest.digest()
