"""Generating domains: plan, check the folders, run, write; finished work is neither repeated nor lost."""

import contextlib
import json
import logging
import platform
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from gelgap.assets.locks import sole_use
from gelgap.assets.names import comma_list, quoted
from gelgap.assets.progress import Progress, shown_progress
from gelgap.assets.whole_file import TEMPORARY_SUFFIX
from gelgap.data.formats.domain_folder import REFERENCE, SHARDS, DomainFolder
from gelgap.data.formats.shards import HEIGHT_MAP_OFFSET_MM, HEIGHT_MAP_STEP_MM, SCHEMA_VERSION
from gelgap.domains.domain import Domain
from gelgap.domains.generation.estimate import force_notes
from gelgap.domains.generation.plan import GenerationPlan, plan_generation, shard_starts
from gelgap.domains.generation.run import run
from gelgap.domains.generation.scheduler import check_answers, check_scheduler
from gelgap.domains.generation.shard import Shard, reference_png
from gelgap.domains.recipe import DomainRecipe, check_named_once, differences, facts_of, make_recipes
from gelgap.sim import ContactPath, PosePath

LOG = logging.getLogger(__name__)
RUN_LOG = "run.jsonl"
"""When, where and what; the one file that may differ between equal data sets."""
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
    interpolation: dict[str, dict[str, Any]]

    def __str__(self) -> str:
        rate = self.frames_written / self.wall_s if self.wall_s else 0.0
        lines = [
            f"{comma_list(self.domains)}: {self.frames} frames in {self.out_dir}; now written {self.frames_written} "
            f"frames, {self.bytes_written / 1e6:.1f} MB, {self.solves} solves in {self.wall_s:.1f} s "
            f"({rate:.1f} frames/s)"
        ]
        if self.skipped:
            lines.append(f"already finished: {comma_list(self.skipped)}")
        if self.unconverged:
            lines.append(f"{self.unconverged} frames did not converge: written without a picture")
        if self.unrenderable:
            lines[-1] += f", {self.unrenderable} of them now as they cannot be rendered ({RUN_LOG} says why)"
        if self.outside_range:
            lines.append(
                f"{self.outside_range} frames have a force outside the declared range; training will refuse them: "
                "declare a wider range (--range, or force_range_n) or change the gel"
            )
        for name, errors in self.interpolation.items():
            if not errors["held_out_poses"]:
                lines.append(f"{name}: poses interpolated; no held-out pose converged to tell their error")
                continue
            told = (
                "{}: poses interpolated from {solves} solves; on {held_out_poses} held-out poses, each solved by "
                "itself, force off by {force_rms_percent:.1f} % rms, membrane by {membrane_rms_um:.1f} µm, picture by "
                "{picture_rms_codes:.1f} of 255"
            ).format(name, **errors)
            if not errors["within_bounds"]:
                told += ": more than a library promises (2 %, 4 µm): --set interpolated=false solves each"
            lines.append(told)
        return "\n".join(lines)


def generate(
    domains: Iterable[str | Domain],
    path: str | ContactPath | PosePath,
    out_dir: Path | str,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    overwrite: bool = False,
    **settings: Any,
) -> GenerationReport:
    """Generate domains by their names into one folder each under `out_dir`.

    See `make_recipes` for the settings (quality, seed, …), `generate_recipes` for what is resumed, refused and raised.
    """
    recipes = make_recipes(domains, path, **settings)
    return generate_recipes(recipes, out_dir, scheduler=scheduler, workers=workers, overwrite=overwrite)


def generate_recipes(
    recipes: Sequence[DomainRecipe],
    out_dir: Path | str,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    overwrite: bool = False,
) -> GenerationReport:
    """Generate domains, and show how far that is; what an earlier, interrupted run finished is kept if it is intact.

    Parameters
    ----------
    recipes
        The domains, each with a name of its own.
    out_dir
        Gets one folder per domain, and `run.jsonl` (times, machine, events).
    scheduler
        Address of a Dask scheduler, or `synchronous` for this process; by default, processes of this machine.
    workers
        How many of them; by default one per core.
    overwrite
        Replace domains that hold another configuration.

    Raises
    ------
    ValueError
        If a domain's folder holds another configuration, two recipes have one name, a contact cannot be solved,
        workers is below 1 or given for a cluster that is there, the scheduler is no address, or Dask is missing for it.
    RuntimeError
        If another process writes to the folder, the disk is full, or the cluster is lost; finished shards are kept.
    """
    start = time.monotonic()
    out_dir = Path(out_dir)
    check_named_once(recipe.name for recipe in recipes)
    check_scheduler(scheduler, workers)
    check_answers(scheduler)
    plan = plan_generation(recipes)  # refuses contacts that cannot be solved before anything is written
    for note in force_notes(recipes):
        LOG.warning("%s", note)
    with sole_use(out_dir), shown_progress() as progress:
        writers = _writers(recipes, out_dir, overwrite)
        plan = plan.without({name: set(writer.files) for name, writer in writers.items()})
        log = partial(_log_event, out_dir)
        log("begin", domains=[*writers], solves=len(plan.solves), frames=plan.frames, scheduler=scheduler)
        try:
            for writer in writers.values():
                writer.prepare()
            _check_space(out_dir, plan, writers)
            progress("solves", 0, len(plan.solves))
            progress("frames", 0, plan.frames)
            _write_shards(run(plan, progress, scheduler, workers), writers, plan.frames, progress, log)
        except BaseException as error:
            log("stopped", error=f"{type(error).__name__}: {error}")
            raise
        report = _report(out_dir, writers, plan, time.monotonic() - start)
        log("end", wall_s=round(report.wall_s, 3), bytes=report.bytes_written)
        return report


def _writers(recipes: Sequence[DomainRecipe], out_dir: Path, overwrite: bool) -> "dict[str, DomainWriter]":
    """Return what writes each domain; nothing is changed on disk unless all folders are free or resumable."""
    writers = {recipe.name: DomainWriter(recipe, out_dir / recipe.name) for recipe in recipes}
    for writer in writers.values():
        writer.check(overwrite)
    return writers


def _write_shards(
    shards: Iterable[Shard],
    writers: "Mapping[str, DomainWriter]",
    frames: int,
    progress: Progress,
    log: Callable[..., None],
) -> None:
    """Write shards as they come, and show how many of the frames are written."""
    written = 0
    for shard in shards:
        writers[shard.domain].write_shard(shard)
        written += shard.facts["frames"]
        progress("frames", written, frames)
        if shard.unrenderable:
            log("not rendered", domain=shard.domain, frames=shard.unrenderable)


def _report(
    out_dir: Path, writers: "Mapping[str, DomainWriter]", plan: GenerationPlan, wall_s: float
) -> GenerationReport:
    """Return what was done: by the plan of what was left to do, and by what the writers have written."""
    interpolation = {
        name: writer.interpolation for name, writer in writers.items() if writer.interpolation is not None
    }
    return GenerationReport(
        out_dir=out_dir,
        domains=tuple(writers),
        skipped=tuple(name for name, writer in writers.items() if writer.skipped),
        frames=sum(writer.recipe.frames for writer in writers.values()),
        frames_written=plan.frames,
        unconverged=sum(writer.total("unconverged") for writer in writers.values()),
        unrenderable=sum(writer.unrenderable for writer in writers.values()),
        outside_range=sum(writer.total("outside_range") for writer in writers.values()),
        solves=len(plan.solves),
        bytes_written=sum(writer.bytes_written for writer in writers.values()),
        wall_s=wall_s,
        interpolation=interpolation,
    )


class DomainWriter:
    """Writes one domain's folder, shard by shard, keeping the manifest true after each."""

    def __init__(self, recipe: DomainRecipe, path: Path):
        self.recipe = recipe
        self.folder = DomainFolder(path)
        self.files: dict[str, Any] = {}
        self.skipped = False
        self.interpolation: dict[str, Any] | None = None
        self.bytes_written = 0
        self.unrenderable = 0

    def check(self, overwrite: bool) -> None:
        """Refuse a folder that holds something else, before anything is changed; else see what is intact."""
        if overwrite or not self.folder.exists():
            return
        manifest = self.folder.read_manifest()
        files = manifest["files"]
        self.interpolation = manifest.get("interpolation")
        self.files = {name: entry for name, entry in files.items() if not self.folder.problem(name, entry)}
        self.skipped = manifest["complete"] and len(self.files) == len(files)
        there, asked = manifest["configuration"], self.recipe.configuration()
        there["schema_version"], asked["schema_version"] = manifest["schema_version"], SCHEMA_VERSION
        if not self.skipped:
            there["versions"], asked["versions"] = manifest["versions"], package_versions()
        changes = [
            f"{name}: {quoted(old)} there, {quoted(new)} asked for"
            for name, old, new in differences(there, asked)
        ]
        if changes:
            raise ValueError(
                f"{self.folder.path} holds another configuration ({'; '.join(changes[:3])}"
                f"{'; …' if len(changes) > 3 else ''}): use the same settings to resume it, --overwrite to "
                "replace it, or another output folder"
            )

    def prepare(self) -> None:
        """Make the folder ready, with its reference: remove what is replaced, and leftovers of an interrupted run."""
        self.folder.path.mkdir(parents=True, exist_ok=True)
        for pattern in (REFERENCE, SHARDS, f".*{TEMPORARY_SUFFIX}"):
            for path in self.folder.path.glob(pattern):
                if path.name not in self.files:
                    path.unlink()
        if self.skipped:
            self._add_facts()
        else:
            shutil.rmtree(self.folder.path / ".cache", ignore_errors=True)  # of pictures that are made again
            self._write_manifest()
        if REFERENCE not in self.files:
            self.files[REFERENCE] = self.folder.write_file(REFERENCE, reference_png(self.recipe))
            self._write_manifest()

    def _add_facts(self) -> None:
        """State what gelgap up to 0.3.0 did not in the manifest of a finished domain; its frames stay as they are."""
        manifest = self.folder.read_manifest()
        if "facts" not in manifest:
            manifest["facts"] = facts_of(self.recipe).model_dump(mode="json")
            self.folder.write_manifest(manifest)

    def write_shard(self, shard: Shard) -> None:
        """Write one shard and enter it in the manifest."""
        self.files[shard.file] = self.folder.write_file(shard.file, shard.data) | shard.facts
        self.interpolation = shard.interpolation or self.interpolation
        self.bytes_written += len(shard.data)
        self.unrenderable += len(shard.unrenderable)
        self._write_manifest()

    def total(self, count: str) -> int:
        """Return the sum of one count over all shards."""
        return sum(entry.get(count, 0) for entry in self.files.values())

    def _write_manifest(self) -> None:
        recipe = self.recipe
        shards = self.files.values()
        lows = [entry["force_min_n"] for entry in shards if entry.get("force_min_n")]
        highs = [entry["force_max_n"] for entry in shards if entry.get("force_max_n")]
        manifest = {
            "schema_version": SCHEMA_VERSION,
            "domain": recipe.name,
            "complete": len(self.files) == 1 + len(shard_starts(recipe.frames)),
            "configuration": recipe.configuration(),
            "seed": recipe.seed,
            "frames": recipe.frames,
            "unconverged": self.total("unconverged"),
            "outside_range": self.total("outside_range"),
            "force_range_n": recipe.force_range_n,
            "force_min_n": np.min(lows, axis=0).tolist() if lows else None,
            "force_max_n": np.max(highs, axis=0).tolist() if highs else None,
            "facts": facts_of(recipe).model_dump(mode="json"),
            "height_map": {"step_mm": HEIGHT_MAP_STEP_MM, "offset_mm": HEIGHT_MAP_OFFSET_MM},
            "versions": package_versions(),
            "files": dict(sorted(self.files.items())),
        }
        if self.interpolation:
            manifest["interpolation"] = self.interpolation
        self.folder.write_manifest(manifest)


def _check_space(out_dir: Path, plan: GenerationPlan, writers: Mapping[str, DomainWriter]) -> None:
    """Raise RuntimeError, before anything is solved, if the disk has no room: a frame takes what its reference does."""
    frames = ((len(batch), recipe.name) for batch in plan.batches for recipe in batch.recipes)
    needed = sum(number * writers[name].files[REFERENCE]["bytes"] for number, name in frames)
    free = shutil.disk_usage(out_dir).free
    if needed > free:
        raise RuntimeError(
            f"about {needed / 1e6:.0f} MB are needed in {out_dir}, and {free / 1e6:.0f} MB are free; make room, "
            "choose another folder or smaller pictures, and run the command again"
        )


@lru_cache(maxsize=1)
def package_versions() -> dict[str, str]:
    """Return the versions of the packages that a domain's bytes may depend on."""
    versions = dict.fromkeys(PACKAGES, "not installed")
    for name in PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            versions[name] = version(name)
    return versions


def _log_event(out_dir: Path, what: str, **values: Any) -> None:
    time_now = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    line = {"time": time_now, "host": platform.node(), "event": what} | values
    # A log that cannot be written, on a full disk, must not hide the original error.
    with contextlib.suppress(OSError), (out_dir / RUN_LOG).open("a", encoding="utf-8") as file:
        file.write(json.dumps(line) + "\n")
