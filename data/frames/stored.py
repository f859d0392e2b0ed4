"""Data sets on disk: pictures decoded once into a memory-mapped cache, and gelgap's own format."""

import io
import logging
import os
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from gelgap.assets.checksums import sha256
from gelgap.assets.image_file import decode_image
from gelgap.assets.locks import cache_folder, key_lock
from gelgap.assets.pinhole import Pinhole
from gelgap.assets.whole_file import whole_file
from gelgap.data.facts import DomainFacts
from gelgap.data.formats.domain_folder import MANIFEST, REFERENCE, DomainFolder
from gelgap.data.formats.pictures import decode_column, resized, without_markers
from gelgap.data.formats.shards import COLUMNS, OPTIONAL, TRACTION_SHAPE, ShardFile, damaged
from gelgap.data.frames.dataset import LabelledFrames

LOG = logging.getLogger(__name__)
PICTURES = "images"
_CHUNK = 256


class StoredFrames(LabelledFrames):
    """A data set in a `folder`; what reads one layout says how to get a frame's encoded picture.

    Frames have the picture without contact of one of the files `reference_paths`.
    """

    def __init__(self, folder: Path, reference_paths: Sequence[Path]):
        self.folder, self.reference_paths = folder, reference_paths
        self.rest_pictures = [partial(self.rest_picture, path) for path in reference_paths]

    @abstractmethod
    def encoded_picture(self, index: int) -> bytes:
        """Return the PNG or JPEG bytes of one frame."""

    @abstractmethod
    def place_of(self, index: int) -> str:
        """Return the name of the file that holds one frame's picture."""

    def picture(self, index: int) -> np.ndarray:
        return self.decoded(self.encoded_picture(index), f"{self.place_of(index)}: frame {index}")

    def rest_picture(self, path: Path) -> np.ndarray:
        """Return a picture without contact; a ValueError if it is damaged, or of another size than the first."""
        return self.decoded(
            path.read_bytes(), f"the reference {path}", is_first=path == self.reference_paths[0]
        )

    def decoded(self, data: bytes, what: str, *, is_first: bool = False) -> np.ndarray:
        """Return a picture (h, w, 3) of the size of the first reference; a ValueError names what it is."""
        try:
            picture = decode_image(data)
        except ValueError as error:
            raise ValueError(
                f"data set {self.name}: {what} is not readable: {error}; "
                f"`gelgap inspect {self.folder} --verify` names every such picture"
            ) from None
        if not is_first and picture.shape != self.reference.shape:
            (height, width), (width0, height0) = picture.shape[:2], self.size_px
            raise ValueError(
                f"data set {self.name}: {what} is {width}×{height} px, the reference {width0}×{height0} px; "
                "all pictures must have one size"
            )
        return picture

    def load(self, size_px: tuple[int, int], markers: bool) -> np.ndarray:
        """Return all pictures (n, h, w, 3) uint8, memory-mapped from a cache on disk; changes never reach the file.

        The first call for a size builds the cache, in `.cache` beside the data, or in the user's cache folder where
        $GELGAP_CACHE names one or the data cannot be written to. Filling in markers takes some 10 ms a picture.
        """
        resized(self.reference, size_px)
        path = self._cache_file(size_px, markers)
        shape = (len(self), size_px[1], size_px[0], 3)
        pictures = open_kept_pictures(path, shape)
        if pictures is not None:
            return pictures
        with key_lock(path.parent, path.name):
            pictures = open_kept_pictures(path, shape)
            if pictures is None:
                write_kept_pictures(path, shape, self._decoded_chunks(size_px, markers))
                pictures = np.lib.format.open_memmap(path, mode="c")
        return pictures

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
            picture = self.decoded(data, f"{self.place_of(index)}: frame {index}")
            return resized(picture if markers else without_markers(picture), size_px)

        doing = "decoding the pictures" if markers else "decoding the pictures and inpainting any markers"
        with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as threads:
            for start in range(0, len(self), _CHUNK):
                LOG.info("%s of %s at %d×%d px, once: %d of %d", doing, self.name, *size_px, start, len(self))
                # The bytes are read in order by one thread; only decoding, which releases the GIL, runs in all.
                indices = range(start, min(start + _CHUNK, len(self)))
                encoded = [self.encoded_picture(index) for index in indices]
                yield np.stack(list(threads.map(shrunk, indices, encoded))).tobytes()


def write_kept_pictures(path: Path, shape: tuple[int, ...], pieces: Iterable[bytes]) -> None:
    """Write uint8 pictures of this shape, given piece by piece, as one npy file."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "|u1", "fortran_order": False, "shape": shape})
    # Plain writes, not a memory map: a full disk is then an error and not a crash.
    with whole_file(path) as temporary, temporary.open("wb") as file:
        file.write(header.getvalue())
        for piece in pieces:
            file.write(piece)


def open_kept_pictures(path: Path, shape: tuple[int, ...]) -> np.ndarray | None:
    """Return the pictures, mapped so that changes never reach the file; None if no such file can be read."""
    try:
        pictures = np.lib.format.open_memmap(path, mode="c")
    except (FileNotFoundError, ValueError):
        return None
    return pictures if pictures.shape == shape and pictures.dtype == np.uint8 else None


def clear_picture_cache() -> int:
    """Delete shrunken pictures in the user's cache folder, not those beside data; return how many bytes they had."""
    files = [path for pattern in ("*.npy", ".*") for path in (cache_folder() / PICTURES).glob(pattern)]
    size = sum(file.stat().st_size for file in files)
    for file in files:
        file.unlink(missing_ok=True)
    return size


class GeneratedDomain(StoredFrames):
    """A domain in gelgap's own format: a manifest, a reference picture and Parquet shards."""

    def __init__(self, folder: Path | str):
        files = DomainFolder(folder)
        super().__init__(files.path, [files.path / REFERENCE])
        self.manifest: dict[str, Any] = files.read_manifest()
        self.name = self.manifest["domain"]
        self.force_range_n = np.array(self.manifest["force_range_n"])
        if not self.manifest["complete"]:
            raise RuntimeError(
                f"{self.folder} is not finished; run the same `gelgap generate` again to complete what is missing"
            )
        names = sorted(name for name in self.manifest["files"] if name != REFERENCE)
        if not names or REFERENCE not in self.manifest["files"]:
            raise RuntimeError(f"{files.manifest_path} names no frames; generate it again with --overwrite")
        # A changed label would train a model, and no one would see it.
        for damage in files.damaged_files(self.manifest):
            raise damaged(self.folder / damage.file, damage.problem)
        self.shards = [ShardFile(self.folder / name) for name in names]
        for shard in self.shards:
            if shard.schema != self.shards[0].schema:
                raise damaged(shard.path, f"its columns are not those of {names[0]}")
        labels = [name for name in self.shards[0].schema.names if COLUMNS[name].is_label]
        tables = [shard.table(labels) for shard in self.shards]
        table = pa.concat_tables(tables)
        kept = np.flatnonzero(table["converged"])
        self.columns = {name: table[name].to_numpy()[kept] for name in labels}
        self.unconverged = len(table) - len(kept)
        if self.unconverged:
            self.notes = (f"{self.unconverged} of {len(table)} frames did not converge: left out",)
        places = [(number, row) for number, own in enumerate(tables) for row in range(len(own))]
        self._places = np.array(places)[kept]

    @cached_property
    def digest(self) -> str:
        hashes = sorted((name, entry["sha256"]) for name, entry in self.manifest["files"].items())
        return sha256(repr(hashes).encode())

    def encoded_picture(self, index: int) -> bytes:
        picture = self._cell(index, "image")
        if not isinstance(picture, bytes):
            raise damaged(self.folder / self.place_of(index), f"frame {index} has no picture")
        return picture

    def place_of(self, index: int) -> str:
        return self.shards[int(self._places[index][0])].path.name

    def optional(self, column: str, index: int) -> np.ndarray:
        """Return one frame's value of an optional column: a picture (h, w) as stored, points (m, 2), or numbers.

        Raises
        ------
        ValueError
            If the domain was generated without that column.
        """
        if column not in self.optional_columns:
            raise ValueError(
                f"data set {self.name} was generated without the column {column!r}; it has "
                f"{', '.join(self.optional_columns) or 'no optional columns'}: generate it with --columns {column}"
            )
        cell = self._cell(index, OPTIONAL[column][0].name)
        return decode_column(cell) if isinstance(cell, bytes) else np.array(cell)

    def height_map_mm(self, index: int) -> np.ndarray:
        """Return the height map (h, w) in mm."""
        scale = self.manifest["height_map"]
        return scale["offset_mm"] + scale["step_mm"] * self.optional("height_map", index).astype(np.float64)

    def traction_map_n(self, index: int) -> np.ndarray:
        """Return the force (24, 32, 3) in N on each cell; `traction_half_extent_mm` says what the cells divide."""
        return self.optional("traction", index).reshape(*TRACTION_SHAPE, 3)

    @cached_property
    def cameras(self) -> Sequence[Pinhole | None]:
        return (self.facts.camera,)

    @cached_property
    def facts(self) -> DomainFacts:
        """What the manifest states of gel, camera and gauge; a RuntimeError where it states it in no known way."""
        try:
            return DomainFacts.of(self.manifest)
        except (KeyError, TypeError, ValueError) as error:
            raise RuntimeError(
                f"{self.folder / MANIFEST} does not state {error}; generate the domain again with --overwrite"
            ) from None

    @property
    def traction_half_extent_mm(self) -> tuple[float, float]:
        """How far from the sensor's centre, along x and y, the cells of `traction` reach: beyond the view."""
        extent_mm = self.facts.traction_half_extent_mm
        if extent_mm is None:
            raise RuntimeError(
                f"{self.folder / MANIFEST} is of gelgap 0.3.0 or earlier and does not state how far the cells of "
                "`traction` reach; run the same `gelgap generate` again, which adds it and makes no frame anew"
            )
        return extent_mm

    @property
    def optional_columns(self) -> tuple[str, ...]:
        return tuple(self.manifest["configuration"]["columns"])

    def _cell(self, index: int, column: str) -> Any:
        shard, row = (int(number) for number in self._places[index])
        return self.shards[shard].cell(row, column)
