"""Writing one domain's folder so that its manifest is true after every file."""

from collections.abc import Callable
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from gelgap.domains.columns import HEIGHT_MAP_OFFSET_MM, HEIGHT_MAP_STEP_MM
from gelgap.domains.folder import REFERENCE, DomainFolder
from gelgap.domains.frame_pictures import reference_png
from gelgap.domains.plan import shard_bounds
from gelgap.domains.recipe import DomainRecipe
from gelgap.domains.schema import SCHEMA_VERSION
from gelgap.domains.shard import Shard

PACKAGES = (
    "gelgap",
    "mujoco",
    "numpy",
    "scipy",
    "numba",
    "pyrender",
    "colour-science",
    "opencv-python-headless",
    "pyarrow",
)
"""The packages whose versions a domain's bytes may depend on."""


class DomainWriter:
    """Writes one domain's folder, shard by shard, keeping the manifest true after each."""

    def __init__(self, recipe: DomainRecipe, path: Path):
        self.recipe = recipe
        self.folder = DomainFolder(path)
        self.files: dict[str, Any] = {}
        self.complete = False
        self._replace = False

    @property
    def finished(self) -> set[str]:
        """Names of the shards that need no work."""
        return set(self.files) - {REFERENCE}

    def check(self, overwrite: bool) -> None:
        """Refuse a folder that holds something else, before anything is changed; else see what is intact."""
        self._replace = overwrite
        if overwrite or not self.folder.exists():
            return
        manifest = self.folder.read_manifest()
        intact = {
            name: entry for name, entry in manifest["files"].items() if not self.folder.problem(name, entry)
        }
        self.complete = manifest["complete"] and len(intact) == len(manifest["files"])
        differences = _differences(manifest["schema_version"], SCHEMA_VERSION, "schema_version")
        differences += _differences(manifest["configuration"], self.recipe.configuration())
        if not self.complete:
            differences += _differences(manifest["versions"], package_versions(), "versions")
        if differences:
            raise ValueError(
                f"{self.folder.path} holds another configuration ({'; '.join(differences[:3])}"
                f"{'; …' if len(differences) > 3 else ''}): use the same settings to resume it, --overwrite to "
                "replace it, or another output folder"
            )
        self.files = intact

    def prepare(self) -> None:
        """Make the folder ready: remove what is to be replaced, and leftovers of an interrupted run."""
        self.folder.path.mkdir(parents=True, exist_ok=True)
        if self._replace:
            self.folder.clear()
        self.folder.remove_leftovers(set(self.files))
        if not self.complete:
            self._write_manifest()

    def write_reference(self, matrix: np.ndarray) -> None:
        if REFERENCE not in self.files:
            self.files[REFERENCE] = self.folder.write_file(REFERENCE, reference_png(self.recipe, matrix))
            self._write_manifest()

    def write_shard(self, shard: Shard) -> int:
        """Write one shard and enter it in the manifest; return how many bytes it has."""
        entry = self.folder.write_file(shard.file, shard.data)
        counts = ("frames", "unconverged", "force_min_n", "force_max_n", "outside_range")
        self.files[shard.file] = entry | {name: getattr(shard, name) for name in counts}
        self._write_manifest()
        return len(shard.data)

    def finish(self) -> None:
        if not self.complete:
            self.complete = True
            self._write_manifest()

    def total(self, count: str) -> int:
        """Return the sum of one count over all shards."""
        return sum(entry.get(count, 0) for entry in self.files.values())

    def _write_manifest(self) -> None:
        complete = self.complete and len(self.finished) == len(shard_bounds(len(self.recipe.path.poses)))
        manifest = {
            "schema_version": SCHEMA_VERSION,
            "domain": self.recipe.name,
            "complete": complete,
            "configuration": self.recipe.configuration(),
            "seed": self.recipe.seed,
            "frames": len(self.recipe.path.poses),
            "unconverged": self.total("unconverged"),
            "outside_range": self.total("outside_range"),
            "force_range_n": self.recipe.force_range_n,
            "force_min_n": self._over_shards(np.min, "force_min_n"),
            "force_max_n": self._over_shards(np.max, "force_max_n"),
            "height_map": {"step_mm": HEIGHT_MAP_STEP_MM, "offset_mm": HEIGHT_MAP_OFFSET_MM},
            "versions": package_versions(),
            "files": dict(sorted(self.files.items())),
        }
        self.folder.write_manifest(manifest)

    def _over_shards(self, extreme: Callable[..., np.ndarray], entry_name: str) -> list[float] | None:
        found = [entry[entry_name] for entry in self.files.values() if entry.get(entry_name)]
        return extreme(found, axis=0).tolist() if found else None


@lru_cache(maxsize=1)
def package_versions() -> dict[str, str]:
    """Return the versions of the packages that a domain's bytes may depend on."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def _differences(there: Any, asked: Any, field: str = "") -> list[str]:
    if isinstance(there, dict) and isinstance(asked, dict):
        return [
            line
            for key in sorted(there.keys() | asked.keys())
            for line in _differences(there.get(key), asked.get(key), f"{field}.{key}" if field else key)
        ]
    if there == asked:
        return []
    texts = [text if len(text := str(value)) < 60 else "…" for value in (there, asked)]
    return [f"{field}: {texts[0]} there, {texts[1]} asked for"]
