"""Generating domains: plan, run, write; finished work is never done again and never lost."""

import json
import platform
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from gelgap.domains.cluster import SYNCHRONOUS, dask_client, run_in_process, run_on_cluster
from gelgap.domains.domain import Domain
from gelgap.domains.folder import REFERENCE, RUN_LOG, DomainFolder, sole_writer
from gelgap.domains.pictures import led_to_camera, reference_png
from gelgap.domains.plan import GenerationPlan, plan_generation, shard_bounds
from gelgap.domains.progress import Progress, Silent
from gelgap.domains.recipe import DomainRecipe, make_recipes
from gelgap.domains.schema import HEIGHT_MAP_OFFSET_MM, HEIGHT_MAP_STEP_MM, SCHEMA_VERSION
from gelgap.domains.shard import Shard
from gelgap.sim import ContactPath, PosePath

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


@dataclass(frozen=True)
class GenerationReport:
    """What a generation did. Counts are frames, over all domains."""

    out_dir: Path
    domains: tuple[str, ...]
    skipped: tuple[str, ...]
    frames: int
    frames_written: int
    unconverged: int
    unrenderable: int
    outside_range: int
    solves: int
    bytes_written: int
    wall_s: float

    def __str__(self) -> str:
        rate = self.frames_written / self.wall_s if self.wall_s else 0.0
        lines = [
            f"{', '.join(self.domains)}: {self.frames} frames in {self.out_dir}; now written {self.frames_written} "
            f"frames, {self.bytes_written / 1e6:.1f} MB, {self.solves} solves in {self.wall_s:.1f} s "
            f"({rate:.1f} frames/s)"
        ]
        if self.skipped:
            lines.append(f"already finished: {', '.join(self.skipped)}")
        if self.unconverged:
            because = (
                f", {self.unrenderable} of them now because they could not be rendered ({RUN_LOG} says why)"
            )
            lines.append(
                f"{self.unconverged} frames did not converge: written without a picture"
                f"{because if self.unrenderable else ''}"
            )
        if self.outside_range:
            lines.append(
                f"{self.outside_range} frames have a force outside the declared range; training will refuse them: "
                "declare a wider range (force_range_n) or change the gel"
            )
        return "\n".join(lines)


def generate(
    domains: Iterable[str | Domain],
    path: str | ContactPath | PosePath,
    out_dir: Path | str,
    *,
    quality: str = "standard",
    seed: int = 0,
    scheduler: str | None = None,
    workers: int | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    **settings: Any,
) -> GenerationReport:
    """Generate domains by their names into one folder each under `out_dir`; see `make_recipes` for the settings.

    See `generate_recipes` for what is resumed, skipped, refused and raised.
    """
    recipes = make_recipes(domains, path, quality=quality, seed=seed, **settings)
    return generate_recipes(
        recipes, out_dir, scheduler=scheduler, workers=workers, overwrite=overwrite, progress=progress
    )


def generate_recipes(
    recipes: Sequence[DomainRecipe],
    out_dir: Path | str,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> GenerationReport:
    """Generate domains; what an earlier, interrupted run finished is kept if its bytes are intact.

    Parameters
    ----------
    recipes
        The domains, each with a name of its own.
    out_dir
        Gets one folder a domain, and `run.jsonl` (times, machine, events).
    scheduler
        Address of a Dask scheduler, or `synchronous` for this process; by default a local cluster is started.
    workers
        Processes of the local cluster; by default one a core.
    overwrite
        Replace domains that hold another configuration.
    progress
        Told what is done; silent by default.

    Raises
    ------
    ValueError
        If a domain's folder holds another configuration, two recipes have one name, or workers is below 1.
    RuntimeError
        If another process writes to the folder, the disk is full, or the cluster is lost; finished shards are kept.
    """
    start = time.monotonic()
    out_dir = Path(out_dir)
    progress = progress or Silent()
    names = [recipe.name for recipe in recipes]
    if workers is not None and workers < 1:
        raise ValueError(f"workers = {workers}: must be 1 or more")
    if len(set(names)) < len(names):
        raise ValueError(f"two domains have one name in {', '.join(names)}; give each its own")
    with sole_writer(out_dir):
        writers = [DomainWriter(recipe, out_dir / recipe.name) for recipe in recipes]
        for writer in writers:
            writer.check(overwrite)
        for writer in writers:
            writer.prepare()
        plan = plan_generation(recipes, {writer.recipe.name: writer.finished for writer in writers})
        skipped = tuple(writer.recipe.name for writer in writers if writer.complete)
        progress.begin(len(plan.solves), plan.frames)
        by_name = {writer.recipe.name: writer for writer in writers}
        written = unrenderable = 0
        log = RunLog(out_dir)
        log.event("begin", domains=names, solves=len(plan.solves), frames=plan.frames, scheduler=scheduler)
        try:
            if plan.batches or not all(writer.complete for writer in writers):
                matrices = {
                    writer.recipe.name: led_to_camera(writer.recipe)
                    for writer in writers
                    if not writer.complete
                }
                for writer in writers:
                    if not writer.complete:
                        writer.write_reference(matrices[writer.recipe.name])
                for shards in _run(plan, matrices, progress, scheduler, workers):
                    for shard in shards:
                        written += by_name[shard.domain].write_shard(shard)
                        progress.written(shard.frames)
                        unrenderable += len(shard.unrenderable)
                        if shard.unrenderable:
                            log.event("not rendered", domain=shard.domain, frames=shard.unrenderable)
                for writer in writers:
                    writer.finish()
        except BaseException as error:
            log.event("stopped", error=f"{type(error).__name__}: {error}")
            raise
        report = GenerationReport(
            out_dir=out_dir,
            domains=tuple(names),
            skipped=skipped,
            frames=sum(len(recipe.path.poses) for recipe in recipes),
            frames_written=plan.frames,
            unconverged=sum(writer.total("unconverged") for writer in writers),
            unrenderable=unrenderable,
            outside_range=sum(writer.total("outside_range") for writer in writers),
            solves=len(plan.solves),
            bytes_written=written,
            wall_s=time.monotonic() - start,
        )
        log.event("end", wall_s=round(report.wall_s, 3), bytes=written)
        return report


def _run(
    plan: GenerationPlan,
    matrices: dict[str, np.ndarray],
    progress: Progress,
    scheduler: str | None,
    workers: int | None,
) -> Iterator[list[Shard]]:
    if not plan.batches:
        return
    if scheduler == SYNCHRONOUS:
        yield from run_in_process(plan, matrices, progress)
        return
    with dask_client(scheduler, workers) as client:
        yield from run_on_cluster(plan, matrices, progress, client)


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
        intact = {name: entry for name, entry in manifest["files"].items() if self.folder.intact(name, entry)}
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
        forces = [entry for entry in self.files.values() if entry.get("force_min_n")]
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
            "force_min_n": np.min([entry["force_min_n"] for entry in forces], axis=0).tolist()
            if forces
            else None,
            "force_max_n": np.max([entry["force_max_n"] for entry in forces], axis=0).tolist()
            if forces
            else None,
            "height_map": {"step_mm": HEIGHT_MAP_STEP_MM, "offset_mm": HEIGHT_MAP_OFFSET_MM},
            "versions": package_versions(),
            "files": dict(sorted(self.files.items())),
        }
        self.folder.write_manifest(manifest)


class RunLog:
    """`run.jsonl`: when, where and what; the one file that may differ between equal data sets."""

    def __init__(self, out_dir: Path):
        self._path = out_dir / RUN_LOG

    def event(self, what: str, **values: Any) -> None:
        line = {
            "time": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "host": platform.node(),
            "event": what,
        }
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line | values) + "\n")
        except OSError:
            # A log that cannot be written, on a full disk, must not hide the error that it is about.
            pass


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
