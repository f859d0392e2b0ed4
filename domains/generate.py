"""Generating domains: plan, run, write; finished work is neither repeated nor lost."""

import itertools
import logging
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gelgap.assets.locks import sole_use
from gelgap.assets.names import comma_list
from gelgap.domains.cluster import SYNCHRONOUS, dask_client, run_in_process, run_on_cluster
from gelgap.domains.domain import Domain
from gelgap.domains.estimate import workload
from gelgap.domains.frame_pictures import led_to_camera
from gelgap.domains.generation_progress import GenerationProgress
from gelgap.domains.plan import GenerationPlan, plan_generation, solve_plan
from gelgap.domains.recipe import DomainRecipe, make_recipes
from gelgap.domains.run_log import RUN_LOG, RunLog
from gelgap.domains.shard import Shard
from gelgap.domains.writer import DomainWriter
from gelgap.sim import ContactPath, PosePath

LOG = logging.getLogger(__name__)
# A shorter piece of work says nothing of how busy the machine is.
_TELLING_CORE_S = 0.1


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
            f"{comma_list(self.domains)}: {self.frames} frames in {self.out_dir}; now written {self.frames_written} "
            f"frames, {self.bytes_written / 1e6:.1f} MB, {self.solves} solves in {self.wall_s:.1f} s "
            f"({rate:.1f} frames/s)"
        ]
        if self.skipped:
            lines.append(f"already finished: {comma_list(self.skipped)}")
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
    progress: GenerationProgress | None = None,
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
    progress: GenerationProgress | None = None,
) -> GenerationReport:
    """Generate domains; what an earlier, interrupted run finished is kept if its bytes are intact.

    Parameters
    ----------
    recipes
        The domains, each with a name of its own.
    out_dir
        Gets one folder per domain, and `run.jsonl` (times, machine, events).
    scheduler
        Address of a Dask scheduler, or `synchronous` for this process; by default a local cluster is started.
    workers
        Processes of the local cluster; by default one per core.
    overwrite
        Replace domains that hold another configuration.
    progress
        Told what is done; silent by default.

    Raises
    ------
    ValueError
        If a domain's folder holds another configuration, two recipes have one name, a contact cannot be solved, or
        workers is below 1.
    RuntimeError
        If another process writes to the folder, the disk is full, or the cluster is lost; finished shards are kept.
    """
    start = time.monotonic()
    out_dir = Path(out_dir)
    progress = progress or GenerationProgress()
    names = tuple(recipe.name for recipe in recipes)
    if workers is not None and workers < 1:
        raise ValueError(f"workers = {workers}: must be 1 or more")
    if len(set(names)) < len(names):
        raise ValueError(f"two domains have one name in {', '.join(names)}; give each its own")
    for recipe in recipes:
        solve_plan(recipe)  # refuses contacts that cannot be solved before anything is written
    with sole_use(out_dir):
        writers = _prepared_writers(recipes, out_dir, overwrite)
        skipped = tuple(name for name in names if writers[name].complete)
        LOG.info("planning %s", comma_list(names))
        wall_start, core_start = time.perf_counter(), time.process_time()
        plan = plan_generation(recipes, {name: writer.finished for name, writer in writers.items()})
        busy = _busy(time.perf_counter() - wall_start, time.process_time() - core_start)
        if scheduler is None:
            workers = plan.processes(workers)
        load = workload(plan, _worker_count(scheduler, workers), busy)
        progress.begin(len(plan.solves), plan.frames, load)
        log = RunLog(out_dir)
        log.event("begin", domains=names, solves=len(plan.solves), frames=plan.frames, scheduler=scheduler)
        try:
            LOG.info("rendering the reference pictures")
            matrices = {
                name: led_to_camera(writer.recipe) for name, writer in writers.items() if not writer.complete
            }
            for name, matrix in matrices.items():
                writers[name].write_reference(matrix)
            LOG.info("starting workers")
            shards = _run(plan, matrices, progress, scheduler, workers)
            written, unrenderable = _write(shards, writers, log, progress)
            for writer in writers.values():
                writer.finish()
        except BaseException as error:
            log.event("stopped", error=f"{type(error).__name__}: {error}")
            raise
        report = GenerationReport(
            out_dir=out_dir,
            domains=names,
            skipped=skipped,
            frames=sum(len(recipe.path.poses) for recipe in recipes),
            frames_written=plan.frames,
            unconverged=sum(writer.total("unconverged") for writer in writers.values()),
            unrenderable=unrenderable,
            outside_range=sum(writer.total("outside_range") for writer in writers.values()),
            solves=len(plan.solves),
            bytes_written=written,
            wall_s=time.monotonic() - start,
        )
        log.event("end", wall_s=round(report.wall_s, 3), bytes=written)
        return report


def _worker_count(scheduler: str | None, workers: int | None) -> int | None:
    """Return how many processes share the work; None where a cluster of others decides."""
    if scheduler == SYNCHRONOUS:
        return 1
    return workers if scheduler is None else None


def _busy(wall_s: float, core_s: float) -> float:
    """Return how many times slower the machine is than an idle one, as a piece of work on one core has shown."""
    return max(1.0, wall_s / core_s) if core_s > _TELLING_CORE_S else 1.0


def _prepared_writers(
    recipes: Sequence[DomainRecipe], out_dir: Path, overwrite: bool
) -> dict[str, DomainWriter]:
    """Return a writer per domain, by name; nothing is changed on disk unless all folders are free or resumable."""
    writers = {recipe.name: DomainWriter(recipe, out_dir / recipe.name) for recipe in recipes}
    for writer in writers.values():
        writer.check(overwrite)
    for writer in writers.values():
        writer.prepare()
    return writers


def _write(
    batches: Iterable[Sequence[Shard]],
    writers: dict[str, DomainWriter],
    log: RunLog,
    progress: GenerationProgress,
) -> tuple[int, int]:
    """Write shards as they come; return how many bytes they have, and how many frames could not be rendered."""
    written = unrenderable = 0
    for shard in itertools.chain.from_iterable(batches):
        written += writers[shard.domain].write_shard(shard)
        progress.written(shard.frames)
        unrenderable += len(shard.unrenderable)
        if shard.unrenderable:
            log.event("not rendered", domain=shard.domain, frames=shard.unrenderable)
    return written, unrenderable


def _run(
    plan: GenerationPlan,
    matrices: dict[str, np.ndarray],
    progress: GenerationProgress,
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
