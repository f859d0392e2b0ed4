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

from gelgap.assets.locks import cache_folder, key_lock
from gelgap.domains.dataset import LabelledFrames
from gelgap.domains.hidden_markers import without_markers
from gelgap.domains.kept_pictures import open_kept_pictures, write_kept_pictures
from gelgap.domains.picture_codec import as_colour, decode_picture, resized

LOG = logging.getLogger(__name__)
_CHUNK = 256
PICTURES = "images"


class StoredFrames(LabelledFrames):
    """A data set in a `folder`; what reads one layout says how to get a frame's encoded picture."""

    folder: Path

    @abstractmethod
    def encoded_picture(self, index: int) -> bytes:
        """Return the PNG or JPEG bytes of one frame."""

    @abstractmethod
    def place_of(self, index: int) -> str:
        """Return the name of the file that holds one frame's picture."""

    def decoded_file(self, path: Path) -> np.ndarray:
        """Return the picture (h, w, 3) of a file of this data set, or raise ValueError with its name."""
        try:
            picture = decode_picture(path.read_bytes())
        except ValueError as error:
            raise ValueError(f"data set {self.name}: {path} is not readable: {error}") from None
        return as_colour(picture)

    def picture(self, index: int) -> np.ndarray:
        return self._decoded(index, self.encoded_picture(index))

    def images(self, size_px: int | tuple[int, int] | None = None) -> np.ndarray:
        """Return all pictures (n, h, w, 3) uint8, area-averaged to `size_px`, memory-mapped from a cache on disk.

        The first call for a size builds the cache, in `.cache` beside the data, or in the user's cache folder where
        $GELGAP_CACHE names one or the data cannot be written to. Changes to the array never reach the file.
        """
        return self._kept(self.image_size_px(size_px), markers=True)

    def images_without_markers(self, size_px: int | tuple[int, int] | None = None) -> np.ndarray:
        """Return what `images` does, of pictures with their markers found and inpainted; kept beside those.

        The first call for a size inpaints every picture of the data set as stored, some 10 ms each.
        """
        return self._kept(self.image_size_px(size_px), markers=False)

    def _kept(self, size: tuple[int, int], markers: bool) -> np.ndarray:
        resized(self.reference, size)
        path = self._cache_file(size, markers)
        shape = (len(self), size[1], size[0], 3)
        pictures = open_kept_pictures(path, shape)
        if pictures is None:
            with key_lock(path.parent, path.name):
                pictures = open_kept_pictures(path, shape)
                if pictures is None:
                    write_kept_pictures(path, shape, self._decoded_chunks(size, markers))
                    pictures = open_kept_pictures(path, shape)
        if pictures is None:
            raise RuntimeError(
                f"{path} is not what was written: the disk is faulty, or another program changed it"
            )
        return pictures

    def _decoded(self, index: int, data: bytes) -> np.ndarray:
        try:
            picture = decode_picture(data)
        except ValueError as error:
            raise ValueError(
                f"data set {self.name}: the picture of frame {index} ({self.place_of(index)}) is not readable: "
                f"{error}; `gelgap inspect {self.folder} --verify` names every such picture"
            ) from None
        picture = as_colour(picture)
        if picture.shape != self.reference.shape:
            raise ValueError(
                f"data set {self.name}: the picture of frame {index} is {picture.shape[1]}×{picture.shape[0]} px "
                f"({self.place_of(index)}), the reference {self.reference.shape[1]}×{self.reference.shape[0]} px; "
                "all pictures must have one size"
            )
        return picture

    def _cache_file(self, size_px: tuple[int, int], markers: bool) -> Path:
        kind = "images" if markers else "without-markers"
        name = f"{kind}-{size_px[0]}x{size_px[1]}-{self.digest[:16]}.npy"
        beside = self.folder / ".cache"
        elsewhere = "GELGAP_CACHE" in os.environ or not os.access(self.folder, os.W_OK)
        if (beside / name).exists() or not elsewhere:
            return beside / name
        return cache_folder() / PICTURES / name

    def _decoded_chunks(self, size_px: tuple[int, int], markers: bool) -> Iterator[bytes]:
        def shrunk(index: int, data: bytes) -> np.ndarray:
            picture = self._decoded(index, data)
            return resized(picture if markers else without_markers(picture), size_px)

        doing = "decoding pictures" if markers else "hiding the markers"
        with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as threads:
            for start in range(0, len(self), _CHUNK):
                LOG.info("%s of %s at %d×%d px, once: %d of %d", doing, self.name, *size_px, start, len(self))
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
    """A data set whose pictures are files of their own, `picture_paths`, one per frame.

    `further_files` are the others that decide what it holds: tables and reference pictures.
    """

    picture_paths: list[Path]
    further_files: list[Path]

    @cached_property
    def digest(self) -> str:
        paths = [*self.picture_paths, *self.further_files]
        stats = [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in paths]
        return hashlib.sha256(repr(stats).encode()).hexdigest()

    def encoded_picture(self, index: int) -> bytes:
        return self.picture_paths[index].read_bytes()

    def place_of(self, index: int) -> str:
        return str(self.picture_paths[index].relative_to(self.folder))


def read_table(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV table by the names of its columns, without spaces around names and values.

    Raises
    ------
    ValueError
        If it is not a table in UTF-8; the message names the file.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            return [
                {name.strip(): (value or "").strip() for name, value in row.items() if name is not None}
                for row in csv.DictReader(file, skipinitialspace=True)
            ]
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not a CSV table in UTF-8: {error}") from None
