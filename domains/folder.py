"""A domain's folder on disk: its manifest, its shards, and what differs between the two."""

import hashlib
import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelgap.assets.checksums import file_sha256, parse_json, with_checksum, without_checksum
from gelgap.assets.names import is_plain_name
from gelgap.assets.whole_file import TEMPORARY_SUFFIX, write_whole

MANIFEST = "manifest.json"
REFERENCE = "reference.png"
MISSING = "is missing"


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


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
            _check_manifest(manifest)
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
            return MISSING
        size = path.stat().st_size
        if size != entry["bytes"]:
            return f"has {size} bytes, the manifest states {entry['bytes']}"
        if file_sha256(path) != entry["sha256"]:
            return "has other bytes than the manifest states (SHA-256 differs)"
        return None

    def clear(self) -> None:
        """Remove what generation wrote here, and nothing else."""
        for pattern in (MANIFEST, REFERENCE, "frames-*.parquet", f".*{TEMPORARY_SUFFIX}", ".cache/*"):
            for path in self.path.glob(pattern):
                path.unlink()

    def remove_leftovers(self, names: set[str]) -> None:
        """Remove temporary files, and shards that the plan does not know."""
        for path in [*self.path.glob(f".*{TEMPORARY_SUFFIX}"), *self.path.glob("frames-*.parquet")]:
            if path.name not in names:
                path.unlink()

    def damages(self) -> list[Damage]:
        """Return everything that differs from what the manifest states: missing, changed and unknown files."""
        try:
            manifest = self.read_manifest()
        except FileNotFoundError:
            return [Damage(MANIFEST, "is missing")]
        except RuntimeError:
            return [Damage(MANIFEST, "is damaged (its own checksum does not match)")]
        files = manifest["files"]
        problems = {name: self.problem(name, entry) for name, entry in sorted(files.items())}
        found = [Damage(name, problem) for name, problem in problems.items() if problem]
        unknown = {path.name for path in self.path.glob("frames-*.parquet")} - set(files)
        found += [Damage(name, "is not in the manifest") for name in sorted(unknown)]
        if not manifest["complete"]:
            found.append(Damage(MANIFEST, "says that generation has not finished"))
        return found


_SHARD_NAME = re.compile(r"frames-\d{5,}\.parquet")
_SHA256 = re.compile(r"[0-9a-f]{64}")


def _check_manifest(manifest: dict[str, Any]) -> None:
    """Raise ValueError if a manifest, whose checksum is right, states what no generation writes."""
    if not is_plain_name(manifest.get("domain")):
        raise ValueError(f"it states domain = {manifest.get('domain')!r}, which is not a plain name")
    kinds = {"files": dict, "configuration": dict, "versions": dict, "complete": bool, "schema_version": int}
    for field, kind in kinds.items():
        if not isinstance(manifest.get(field), kind):
            raise ValueError(f"it states {field} = {manifest.get(field)!r}, expected {kind.__name__}")
    for name, entry in manifest["files"].items():
        if name != REFERENCE and not _SHARD_NAME.fullmatch(name):
            raise ValueError(f"it states the file {name!r}, which is not of this folder")
        known = isinstance(entry, dict) and isinstance(entry.get("bytes"), int)
        if not known or not _SHA256.fullmatch(str(entry.get("sha256"))):
            raise ValueError(f"it states no size and SHA-256 of {name}")
    columns = manifest["configuration"].get("columns")
    if not isinstance(columns, list) or not all(isinstance(column, str) for column in columns):
        raise ValueError(f"it states columns = {columns!r}, expected a list of names")
    if not _is_range(manifest.get("force_range_n")):
        raise ValueError(
            f"it states force_range_n = {manifest.get('force_range_n')!r}, expected three ranges"
        )


def _is_range(value: Any) -> bool:
    """Return whether a value is three pairs of finite numbers, the first below the second."""
    return (
        isinstance(value, list)
        and len(value) == 3
        and all(
            isinstance(pair, list)
            and len(pair) == 2
            and all(isinstance(number, int | float) and math.isfinite(number) for number in pair)
            and pair[0] < pair[1]
            for pair in value
        )
    )
