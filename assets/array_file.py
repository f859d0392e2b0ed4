"""Arrays of an npz file that anyone may have written: no objects, and no more memory than the file may take."""

import io
import math
import struct
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import BinaryIO

import numpy as np

MOST_BYTES = 2**30
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# What Python's zipfile, zlib and NumPy raise on bytes that are not theirs.
_UNREADABLE = (
    *(zipfile.BadZipFile, zlib.error, struct.error),
    *(EOFError, OSError, ValueError, KeyError, NotImplementedError, RuntimeError, MemoryError),
)


def read_arrays(source: Path | bytes, names: Collection[str] | None = None) -> dict[str, np.ndarray]:
    """Return the arrays of an npz file by name: those of `names` that are there, or all.

    The CRC-32 that the file keeps of each array is checked.

    Raises
    ------
    ValueError
        If it is not an npz file, an array is damaged, holds Python objects, or is larger than 1 GiB; the message says
        which and does not name the file.
    """
    file = io.BytesIO(source) if isinstance(source, bytes) else source
    try:
        with zipfile.ZipFile(file) as archive:
            members = {
                info.filename.removesuffix(".npy"): info
                for info in archive.infolist()
                if info.filename.endswith(".npy")
            }
            wanted = {name: info for name, info in members.items() if names is None or name in names}
            _check_size(wanted)
            return {name: _read(archive, name, info) for name, info in wanted.items()}
    except _Refused as reason:
        raise ValueError(str(reason)) from None
    except _UNREADABLE as error:
        raise ValueError(" ".join(str(error).split()) or "its end is missing") from None


class _Refused(Exception):
    """Why an array is not read."""


def _check_size(members: dict[str, zipfile.ZipInfo]) -> None:
    total = sum(info.file_size for info in members.values())
    if total > MOST_BYTES:
        raise _Refused(
            f"its arrays would take {total / 2**30:.1f} GiB, allowed is {MOST_BYTES / 2**30:.0f} GiB"
        )


def _read(archive: zipfile.ZipFile, name: str, info: zipfile.ZipInfo) -> np.ndarray:
    if info.compress_type not in _METHODS:
        raise _Refused(f"{name} is compressed in a way that is not NumPy's")
    data = archive.read(info)
    return _array(io.BytesIO(data), name, len(data))


def _array(file: BinaryIO, name: str, size: int) -> np.ndarray:
    """Return the array of an npy file's bytes, after its header was compared with their number."""
    version = np.lib.format.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise _Refused(f"{name} has an npy header of version {version}")
    read_header = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }[version]
    shape, _, dtype = read_header(file)
    if dtype.hasobject:
        raise _Refused(f"{name} holds Python objects, which are never read: they could run code")
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != size - file.tell():
        raise _Refused(f"{name} has another size than its header states")
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)
