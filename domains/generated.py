"""Reading gelgap's own format: a manifest, a reference picture and Parquet shards."""

import hashlib
import os
import time
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gelgap.domains.folder import MISSING, REFERENCE, DomainFolder
from gelgap.domains.picture_codec import decode_picture
from gelgap.domains.shard_file import ShardFile, damaged
from gelgap.domains.stored import StoredFrames

if TYPE_CHECKING:
    from gelgap.domains.recipe import DomainRecipe


class GeneratedDomain(StoredFrames):
    """A domain in gelgap's own format: a manifest, a reference picture and Parquet shards."""

    def __init__(self, folder: Path | str):
        files = DomainFolder(folder)
        self.folder = files.path
        self.manifest: dict[str, Any] = files.read_manifest()
        self.name = self.manifest["domain"]
        self.force_range_n = np.array(self.manifest["force_range_n"])
        if not self.manifest["complete"]:
            raise RuntimeError(
                f"{self.folder} is not finished; run the same `gelgap generate` again to complete what is missing"
            )
        self._shards = sorted(name for name in self.manifest["files"] if name.endswith(".parquet"))
        if not self._shards or REFERENCE not in self.manifest["files"]:
            raise RuntimeError(
                f"{files.manifest_path} names no frames; generate the domain again with --overwrite"
            )
        self._check_bytes(files)
        tables, places = zip(*(self._read_labels(number) for number in range(len(self._shards))), strict=True)
        for number, table in enumerate(tables):
            if table.keys() != tables[0].keys():
                raise damaged(self.shard_paths[number], f"its columns are not those of {self._shards[0]}")
        joined = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
        kept = np.flatnonzero(joined["converged"])
        self.columns = {name: values[kept] for name, values in joined.items()}
        self.unconverged = len(joined["converged"]) - len(kept)
        if self.unconverged:
            self.notes = (
                f"{self.unconverged} of {len(joined['converged'])} frames did not converge: left out",
            )
        self._places = np.concatenate(places)[kept]
        self._open_shards: dict[int, ShardFile] = {}
        self._group: tuple[tuple[int, int, str] | None, list[bytes | None]] = (None, [])

    def _check_bytes(self, files: DomainFolder) -> None:
        """Compare every file with the manifest: a changed label would train a model, and no one would see it."""
        with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as threads:
            problems = threads.map(lambda item: _problem(files, *item), self.manifest["files"].items())
            for name, problem in zip(self.manifest["files"], problems, strict=True):
                if problem == MISSING:
                    raise FileNotFoundError(f"{self.folder / name} is missing; generate the domain again")
                if problem:
                    raise damaged(self.folder / name, problem)

    def _read_labels(self, number: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Return the plain columns of one shard, and where its rows are: shard, row group, row (n, 3)."""
        shard = ShardFile(self.folder / self._shards[number])
        labels = shard.labels()
        places = [
            (number, group, row) for group, rows in enumerate(shard.rows_per_group) for row in range(rows)
        ]
        return labels, np.array(places, dtype=np.int64).reshape(-1, 3)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open_shards": {}, "_group": (None, [])}

    @property
    def shard_paths(self) -> list[Path]:
        """The Parquet files that the manifest names, in order."""
        return [self.folder / name for name in self._shards]

    @cached_property
    def reference(self) -> np.ndarray:
        return self.decoded_file(self.folder / REFERENCE)

    @cached_property
    def digest(self) -> str:
        hashes = sorted((name, entry["sha256"]) for name, entry in self.manifest["files"].items())
        return hashlib.sha256(repr(hashes).encode()).hexdigest()

    def encoded_picture(self, index: int) -> bytes:
        picture = self._cell(index, "image")
        if not isinstance(picture, bytes):
            raise damaged(self.folder / self.place_of(index), f"frame {index} has no picture")
        return picture

    def place_of(self, index: int) -> str:
        return self._shards[int(self._places[index][0])]

    def optional(self, column: str, index: int) -> np.ndarray:
        """Return one frame's value of an optional column: a picture (h, w) as stored, or points (m, 2).

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
        cell = self._cell(index, column)
        return decode_picture(cell) if isinstance(cell, bytes) else np.array(cell)

    def height_map_mm(self, index: int) -> np.ndarray:
        """Return the height map (h, w) in mm."""
        scale = self.manifest["height_map"]
        return scale["offset_mm"] + scale["step_mm"] * self.optional("height_map", index).astype(np.float64)

    def contact_mask(self, index: int) -> np.ndarray:
        """Return where the indenter touches, (h, w) bool."""
        return self.optional("contact_mask", index) > 0

    def marker_px(self, index: int) -> np.ndarray:
        """Return where the markers are in the picture, (m, 2) pixels."""
        return self.optional("marker_px", index)

    def marker_rest_mm(self, index: int) -> np.ndarray:
        """Return where the markers are on the undeformed membrane, (m, 2) mm."""
        return self.optional("marker_rest_mm", index)

    @cached_property
    def recipe(self) -> "DomainRecipe":
        """The configuration that the domain was generated from."""
        from gelgap.domains.recipe import DomainRecipe

        return DomainRecipe(**self.manifest["configuration"])

    @property
    def optional_columns(self) -> tuple[str, ...]:
        return tuple(self.manifest["configuration"]["columns"])

    def _cell(self, index: int, column: str) -> Any:
        shard, group, row = (int(number) for number in self._places[index])
        if self._group[0] != (shard, group, column):
            self._group = ((shard, group, column), self._read_group(shard, group, column))
        return self._group[1][row]

    def _read_group(self, shard: int, group: int, column: str) -> list[Any]:
        if shard not in self._open_shards:
            self._open_shards[shard] = ShardFile(self.folder / self._shards[shard])
        return self._open_shards[shard].cells(group, column)


# What a process has compared, by path, time of change and entry: a page or an export opens a domain several times.
_INTACT: set[tuple[Path, int, str]] = set()
_SETTLED_NS = 2_000_000_000


def _problem(files: DomainFolder, name: str, entry: dict[str, Any]) -> str | None:
    """Return how a file differs from its manifest entry; a file that did not change since is not read again."""
    path = files.path / name
    try:
        modified_ns = path.stat().st_mtime_ns
    except OSError:
        return MISSING
    key = path.absolute(), modified_ns, entry["sha256"]
    if key in _INTACT and path.stat().st_size == entry["bytes"]:
        return None
    problem = files.problem(name, entry)
    # What was written a moment ago may be written again without a later time.
    if problem is None and time.time_ns() - modified_ns > _SETTLED_NS:
        _INTACT.add(key)
    return problem
