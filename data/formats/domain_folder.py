"""Folders on disk: a domain's, with its manifest and what differs from it, and output that is whole or not there."""

import json
import os
import re
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from gelgap.assets.checksums import file_sha256, parse_json, sha256, with_checksum, without_checksum
from gelgap.assets.locks import sole_use
from gelgap.assets.settings import Settings
from gelgap.assets.whole_file import write_whole

MANIFEST = "manifest.json"
REFERENCE = "reference.png"
SHARDS = "frames-*.parquet"


def _plain(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._+-]*", name):
        raise ValueError("must be letters a to z, digits and . _ + -, no spaces or accents, no sign first")
    return name


DomainName = Annotated[str, AfterValidator(_plain), Field(max_length=128)]


def shard_name(number: int) -> str:
    return f"frames-{number:05d}.parquet"


@dataclass(frozen=True)
class Damage:
    """One thing that is wrong with a domain folder."""

    file: str
    problem: str

    def __str__(self) -> str:
        return f"{self.file}: {self.problem}"


class DomainFolder:
    """The files of one domain. `entry` is what the manifest knows of a file: SHA-256, size and counts."""

    def __init__(self, path: Path | str):
        self.path = Path(path)

    @property
    def manifest_path(self) -> Path:
        return self.path / MANIFEST

    def exists(self) -> bool:
        return self.manifest_path.exists()

    def read_manifest(self) -> dict[str, Any]:
        """Return the manifest.

        Raises
        ------
        FileNotFoundError
            If the folder has none.
        RuntimeError
            If it is damaged.
        """
        try:
            text = self.manifest_path.read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            raise FileNotFoundError(
                f"{self.path} holds no {MANIFEST}; expected a domain folder as `gelgap generate` writes it"
            ) from None
        try:
            manifest = without_checksum(parse_json(text))
            _Manifest(**manifest)
        except ValueError as error:
            raise RuntimeError(
                f"{self.manifest_path} is damaged ({error}); generate the domain again with --overwrite"
            ) from None
        return manifest

    def write_manifest(self, manifest: dict[str, Any]) -> None:
        text = json.dumps(with_checksum(manifest), indent=1, sort_keys=True, ensure_ascii=False)
        write_whole(self.manifest_path, text.encode())

    def write_file(self, name: str, data: bytes) -> dict[str, Any]:
        """Write one file and return its manifest entry."""
        write_whole(self.path / name, data)
        return {"sha256": sha256(data), "bytes": len(data)}

    def problem(self, name: str, entry: dict[str, Any]) -> str | None:
        """Return how a file differs from what the manifest states, or None if it has exactly those bytes."""
        path = self.path / name
        if not path.exists():
            return "is missing"
        if file_sha256(path) != entry["sha256"]:
            return "has other bytes than the manifest states (SHA-256 differs)"
        return None

    def damaged_files(self, manifest: dict[str, Any]) -> Iterator[Damage]:
        """Yield the files that differ from what the manifest states; they are read side by side."""
        files = sorted(manifest["files"].items())
        with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as threads:
            problems = threads.map(lambda file: self.problem(*file), files)
            for (name, _), problem in zip(files, problems, strict=True):
                if problem:
                    yield Damage(name, problem)

    def damages(self) -> list[Damage]:
        """Return everything that differs from what the manifest states: missing, changed and unknown files."""
        try:
            manifest = self.read_manifest()
        except FileNotFoundError:
            return [Damage(MANIFEST, "is missing")]
        except RuntimeError:
            return [Damage(MANIFEST, "is damaged (its own checksum does not match)")]
        found = list(self.damaged_files(manifest))
        unknown = {path.name for path in self.path.glob(SHARDS)} - set(manifest["files"])
        found += [Damage(name, "is not in the manifest") for name in sorted(unknown)]
        if not manifest["complete"]:
            found.append(Damage(MANIFEST, "says that generation has not finished"))
        return found


class _Checked(Settings, extra="allow"):
    """What is checked of a manifest whose checksum is right; it may state more."""


class _FileEntry(_Checked):
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    bytes: int


class _Configuration(_Checked):
    columns: tuple[str, ...]


class _Manifest(_Checked):
    domain: DomainName
    files: dict[Annotated[str, Field(pattern=r"^(reference\.png|frames-\d{5,}\.parquet)$")], _FileEntry]
    configuration: _Configuration
    versions: dict[str, Any]
    complete: bool
    schema_version: int
    force_range_n: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]


@contextmanager
def new_folder(out_dir: Path) -> Iterator[Path]:
    """Give an empty folder to write to; it becomes `out_dir` when the block ends without error.

    Raises
    ------
    ValueError
        If there is something in `out_dir`.
    RuntimeError
        If the disk does not take it, or another process is writing it; nothing of it is left.
    """
    building = out_dir.with_name(f".{out_dir.name}.building")
    with sole_use(building):
        content = building / "content"
        try:
            check_is_new(out_dir)
            shutil.rmtree(content, ignore_errors=True)  # what a killed process has left
            content.mkdir()
            yield content
            if out_dir.exists():
                out_dir.rmdir()
            content.rename(out_dir)
        except OSError as error:
            raise RuntimeError(f"cannot write {out_dir}: {error.strerror or error}") from error
        finally:
            shutil.rmtree(building, ignore_errors=True)


def check_is_new(out_dir: Path) -> None:
    """Raise ValueError if a folder of output has something in it."""
    if out_dir.exists() and any(out_dir.iterdir()):
        raise ValueError(f"{out_dir} is not empty; name a new folder")
