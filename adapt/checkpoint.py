"""Reading files of torch that anyone may have written: tensors and plain values alone, checked by their CRC-32."""

import struct
import warnings
import zipfile
import zlib
from pathlib import Path
from typing import Any

import torch

# A checkpoint stores its tensors as they are: a file that would take more than this times its size is not one.
_MOST_GROWTH = 2
# What Python's zipfile and zlib raise on bytes that are not theirs.
_UNREADABLE = (
    *(zipfile.BadZipFile, zlib.error, struct.error),
    *(EOFError, OSError, ValueError, NotImplementedError, RuntimeError),
)
_ZIP = b"PK\x03\x04"


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Return the dictionary of a file that `torch.save` wrote, on the CPU.

    torch itself reads a file with damaged weights without a word; the CRC-32 that the file keeps of each part is
    compared here. Files in the format before torch 1.6 have none.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a checkpoint, or is damaged; the message names it.
    """
    if not path.is_file():
        raise FileNotFoundError(f"checkpoint {path} does not exist")
    with path.open("rb") as file:
        if file.read(len(_ZIP)) == _ZIP:
            _check_archive(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about foreign bytes; the sentence below is enough
            content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # an unpickler of foreign bytes raises anything
        reason = str(error).partition("\n")[0].partition(". ")[0]
        raise ValueError(f"{path} is not a checkpoint of torch ({type(error).__name__}: {reason})") from None
    if not isinstance(content, dict):
        raise ValueError(
            f"{path} is not a checkpoint: it holds {type(content).__name__}, expected a dictionary"
        )
    return content


def _check_archive(path: Path) -> None:
    try:
        with zipfile.ZipFile(path) as archive:
            total = sum(info.file_size for info in archive.infolist())
            fits = total <= _MOST_GROWTH * path.stat().st_size
            damaged = archive.testzip() if fits else None
    except _UNREADABLE as error:
        raise ValueError(f"{path} is damaged ({error}): it is not a whole checkpoint") from None
    if not fits:
        raise ValueError(f"{path} is not a checkpoint: it would take {total / 2**20:.0f} MiB")
    if damaged is not None:
        raise ValueError(f"{path} is damaged: the CRC-32 of {damaged!r} does not match")
