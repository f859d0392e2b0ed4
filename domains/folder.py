"""A domain's folder on disk: its manifest, its shards, and what differs between the two."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelgap.assets.whole_file import TEMPORARY_SUFFIX, write_whole

MANIFEST = "manifest.json"
REFERENCE = "reference.png"


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def file_sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def canonical_json(value: Any) -> bytes:
    """Return the one JSON text of a value: sorted keys, so that equal values hash equally."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()


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
        except FileNotFoundError:
            raise FileNotFoundError(
                f"{self.path} holds no {MANIFEST}; expected a domain folder as `gelgap generate` writes it"
            ) from None
        try:
            manifest = json.loads(text)
            stated = manifest.pop("sha256")
        except (ValueError, KeyError, AttributeError, TypeError):
            stated, manifest = None, None
        if stated is None or stated != sha256(canonical_json(manifest)):
            raise RuntimeError(
                f"{self.manifest_path} is damaged (its own checksum does not match); "
                "generate the domain again with --overwrite"
            )
        return manifest

    def write_manifest(self, manifest: dict[str, Any]) -> None:
        signed = {**manifest, "sha256": sha256(canonical_json(manifest))}
        write_whole(
            self.manifest_path, json.dumps(signed, indent=1, sort_keys=True, ensure_ascii=False).encode()
        )

    def write_file(self, name: str, data: bytes) -> dict[str, Any]:
        """Write one file and return its manifest entry."""
        write_whole(self.path / name, data)
        return {"sha256": sha256(data), "bytes": len(data)}

    def problem(self, name: str, entry: dict[str, Any]) -> str | None:
        """Return how a file differs from what the manifest states, or None if it has exactly those bytes."""
        path = self.path / name
        if not path.exists():
            return "is missing"
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
        except (FileNotFoundError, RuntimeError) as error:
            return [Damage(MANIFEST, str(error))]
        files = manifest["files"]
        problems = {name: self.problem(name, entry) for name, entry in sorted(files.items())}
        found = [Damage(name, problem) for name, problem in problems.items() if problem]
        unknown = {path.name for path in self.path.glob("frames-*.parquet")} - set(files)
        found += [Damage(name, "is not in the manifest") for name in sorted(unknown)]
        if not manifest["complete"]:
            found.append(Damage(MANIFEST, "says that generation has not finished"))
        return found
