"""Arrays of npz files: read as anyone may have written them, without objects, and written whole or not at all."""

import io
import zipfile
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from gelgap.assets.whole_file import whole_file

MOST_BYTES = 2**30


def read_arrays(source: Path | bytes, names: Collection[str] | None = None) -> dict[str, np.ndarray]:
    """Return the arrays of an npz file by name: those of `names` that are there, or all.

    The CRC-32 that the file keeps of each array is checked.

    Raises
    ------
    ValueError
        If it is not an npz file, an array is damaged or holds Python objects, or all are larger than 1 GiB; the
        message does not name the file.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(source) if isinstance(source, bytes) else source) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            wanted = {name: info for name, info in members.items() if names is None or name in names}
            if (total := sum(info.file_size for info in wanted.values())) > MOST_BYTES:
                raise ValueError(f"its arrays would take {total / 2**30:.1f} GiB, allowed is 1 GiB")
            return {name: _array(archive.read(info)) for name, info in wanted.items()}
    except Exception as error:  # zipfile, zlib and NumPy raise ten kinds on bytes that are not theirs
        reason = " ".join(str(error).split()) or "its end is missing"
        if "allow_pickle" in reason:
            reason = "it holds Python objects, which are never read: they could run code"
        raise ValueError(reason) from None


def write_arrays(path: Path | str, arrays: Mapping[str, np.ndarray]) -> None:
    """Write a compressed npz file, whole or not at all."""
    with whole_file(Path(path)) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


def _array(data: bytes) -> np.ndarray:
    file = io.BytesIO(data)
    array = np.lib.format.read_array(file, allow_pickle=False)
    if file.read():
        raise ValueError("an array has another size than its header states")
    return array
