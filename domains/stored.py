"""Frames whose pictures lie on disk, decoded once at training size into one memory-mapped array."""

import csv
import hashlib
import logging
import os
from abc import abstractmethod
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path

import numpy as np

from gelgap.assets.key_lock import key_lock
from gelgap.assets.user_cache import cache_folder
from gelgap.assets.whole_file import whole_file
from gelgap.domains.dataset import LabelledFrames
from gelgap.domains.picture_codec import decode_picture, resized

LOG = logging.getLogger(__name__)
_CHUNK = 256
PICTURES = "images"


class StoredFrames(LabelledFrames):
    """A data set in a `folder`; what reads one layout says how to get a frame's encoded picture."""

    folder: Path

    @abstractmethod
    def encoded_picture(self, index: int) -> bytes:
        """Return the PNG or JPEG bytes of one frame."""

    def picture(self, index: int) -> np.ndarray:
        return self._decoded(index, self.encoded_picture(index))

    def images(self, size_px: int | tuple[int, int] | None = None) -> np.ndarray:
        """Return all pictures (n, h, w, 3) uint8, area-averaged to `size_px`, memory-mapped from a cache on disk.

        The first call for a size builds the cache, in `.cache` beside the data, or in the user's cache folder where
        $GELGAP_CACHE names one or the data cannot be written to. Changes to the array never reach the file.
        """
        size = self.image_size_px(size_px)
        resized(self.reference, size)
        path = self._cache_file(size)
        if not path.exists():
            with key_lock(path.parent, path.name):
                if not path.exists():
                    self._build_cache(size, path)
        return np.load(path, mmap_mode="c")

    def _decoded(self, index: int, data: bytes) -> np.ndarray:
        picture = decode_picture(data)
        if picture.ndim == 2:
            picture = np.repeat(picture[..., None], 3, axis=2)
        if picture.shape != self.reference.shape:
            raise ValueError(
                f"data set {self.name}: the picture of frame {index} is {picture.shape[1]}×{picture.shape[0]} px, the "
                f"reference {self.reference.shape[1]}×{self.reference.shape[0]} px; all pictures must have one size"
            )
        return picture

    def _cache_file(self, size_px: tuple[int, int]) -> Path:
        name = f"images-{size_px[0]}x{size_px[1]}-{self.digest[:16]}.npy"
        beside = self.folder / ".cache"
        elsewhere = "GELGAP_CACHE" in os.environ or not os.access(self.folder, os.W_OK)
        if (beside / name).exists() or not elsewhere:
            return beside / name
        return cache_folder() / PICTURES / name

    def _build_cache(self, size_px: tuple[int, int], path: Path) -> None:
        header = {"descr": "|u1", "fortran_order": False, "shape": (len(self), size_px[1], size_px[0], 3)}
        LOG.info("decoding %d pictures of %s at %d×%d px, once", len(self), self.name, *size_px)
        # Plain writes, not a memory map: a full disk is then an error and not a crash.
        with whole_file(path) as temporary, temporary.open("wb") as file:
            np.lib.format.write_array_header_1_0(file, header)
            for chunk in self._decoded_chunks(size_px):
                file.write(chunk)

    def _decoded_chunks(self, size_px: tuple[int, int]) -> Iterator[bytes]:
        def shrunk(index: int, data: bytes) -> np.ndarray:
            return resized(self._decoded(index, data), size_px)

        with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as threads:
            for start in range(0, len(self), _CHUNK):
                # The bytes are read in order by one thread; only decoding, which releases the GIL, runs in all.
                indices = range(start, min(start + _CHUNK, len(self)))
                encoded = [self.encoded_picture(index) for index in indices]
                yield np.stack(list(threads.map(shrunk, indices, encoded))).tobytes()


def clear_picture_cache() -> int:
    """Delete shrunken pictures in the user's cache folder, not those beside data; return how many bytes they had."""
    files = [*(cache_folder() / PICTURES).glob("*.npy"), *(cache_folder() / PICTURES).glob(".*.tmp")]
    size = sum(file.stat().st_size for file in files)
    for file in files:
        file.unlink(missing_ok=True)
    return size


class PictureFiles(StoredFrames):
    """A data set whose pictures are files of their own, `picture_paths`, one per frame."""

    picture_paths: list[Path]

    @cached_property
    def digest(self) -> str:
        stats = [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in self.picture_paths]
        return hashlib.sha256(repr(stats).encode()).hexdigest()

    def encoded_picture(self, index: int) -> bytes:
        return self.picture_paths[index].read_bytes()


def read_table(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV table by the names of its columns, without spaces around names and values."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        return [
            {name.strip(): (value or "").strip() for name, value in row.items() if name is not None}
            for row in csv.DictReader(file, skipinitialspace=True)
        ]
