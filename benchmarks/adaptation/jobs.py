"""Training runs: what each is, the record it leaves, and doing those that have none yet, one per core."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from gelgap.benchmarks.common.records import append_record, read_records

if TYPE_CHECKING:
    from gelgap.adapt import Profile
    from gelgap.domains import DomainRecipe, GenerationReport

Axes = tuple[float, float, float]
Changes = tuple[tuple[str, Any], ...]
RUNS = "runs.jsonl"
_NAN = (math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class TrainingJob:
    """One run to do: a method on a group with a seed; `changes` are profile fields that differ from the preset."""

    source: str
    target: str
    method: str
    seed: int
    changes: Changes = ()

    @property
    def group(self) -> tuple[str, str]:
        """Source and target."""
        return self.source, self.target

    def profile(self, preset: str) -> "Profile":
        """Return the preset with this job's changes; a transfer weight among them replaces the method's own too."""
        from gelgap.adapt import Profile

        profile, changes = Profile.preset(preset), dict(self.changes)
        if "transfer_weight" in changes:
            own = {k: v for k, v in profile.settings.get(self.method, {}).items() if k != "transfer_weight"}
            changes["settings"] = {**profile.settings, self.method: own}
        return profile.replace(**changes)


@dataclass(frozen=True)
class RunRecord:
    """One finished run: errors on the target's test frames per axis (N, and R²), and what else the tables need.

    Errors are NaN where the run stopped with `problem`. `stage1_s` is 0 where another run had trained the checkpoint.
    """

    job: TrainingJob
    profile: str
    versions: dict[str, str]
    problem: str | None = None
    key: str = ""
    mae_n: Axes = _NAN
    r2: Axes = _NAN
    constant_mean_n: Axes = _NAN
    source_held_out_r2: Axes | None = None
    stage1_s: float = 0.0
    stage2_s: float = math.nan
    feature_rank: float = math.nan
    prediction_spread: float = math.nan
    skipped_steps: int = 0

    @property
    def mean_mae_n(self) -> float:
        """Mean over the axes, N; NaN where the features collapsed."""
        return float(np.mean(self.mae_n))


Record = TypeVar("Record")


@dataclass(frozen=True)
class Bench:
    """Where runs find their data and leave their records, with which profile, and how much time they may take now.

    Without `seeds` a part of the benchmark takes its own. `workers` are processes, by default one per core; one means
    this process, without a cluster. No run is begun after `stop`, a time of `time.time`.
    """

    data: Path
    out: Path
    profile: str
    seeds: tuple[int, ...] | None = None
    workers: int | None = None
    stop: float = math.inf

    @classmethod
    def at(cls, folder: Path, **limits: Any) -> "Bench":
        """Return the bench of a folder that is named after the profile, its data beside it."""
        return cls(folder.parent / f"data-{folder.name}", folder, folder.name, **limits)

    def within(self, name: str, profile: str) -> "Bench":
        """Return a bench for another profile with data of its own, below this one's records."""
        folder = self.out / name
        return replace(self, data=folder / "data", out=folder / "runs", profile=profile)

    def generate(self, recipes: "Sequence[DomainRecipe]") -> "GenerationReport":
        """Generate what is missing of some domains."""
        from gelgap.domains import generate_recipes

        scheduler = "synchronous" if self.workers == 1 else None
        report = generate_recipes(recipes, self.data, scheduler=scheduler, workers=self.workers)
        print(report, flush=True)
        return report

    def generate_preset(self) -> None:
        """Generate what is missing of the data that the profile is meant for, those of smoke at draft quality."""
        from gelgap.domains import preset_recipes

        quality = "draft" if self.profile == "smoke" else "standard"
        self.generate(preset_recipes(self.profile, quality=quality, seed=0))

    def is_over(self) -> bool:
        """Return whether no further run is to be begun."""
        return time.time() >= self.stop


def adapt_job(bench: Bench, job: TrainingJob) -> RunRecord:
    """Do one run; a collapse, or a loss that is not finite, is a result, not a failure."""
    from gelgap.adapt import FeatureCollapse, TrainingDiverged, adapt_folders
    from gelgap.adapt.run_record import versions

    source, target = bench.data / job.source, bench.data / job.target
    try:
        (run,) = adapt_folders(
            source, target, [job.method], job.profile(bench.profile), job.seed, out_dir=bench.out
        )
    except (FeatureCollapse, TrainingDiverged) as problem:
        return RunRecord(job, bench.profile, versions(), problem=str(problem))
    last = run.history[-1] if run.history else {}
    return RunRecord(
        job=job,
        profile=bench.profile,
        versions=run.versions,
        key=run.key,
        mae_n=run.target_test.mae_n,
        r2=run.target_test.r2,
        constant_mean_n=run.target_constant_mean.mae_n,
        source_held_out_r2=None if run.source_held_out is None else run.source_held_out.r2,
        stage1_s=run.wall_s["stage1"],
        stage2_s=run.wall_s["stage2"],
        feature_rank=last.get("feature_rank", math.nan),
        prediction_spread=last.get("prediction_spread", math.nan),
        skipped_steps=run.skipped_steps,
    )


Work = Callable[[Bench, TrainingJob], Record]


def missing_jobs(jobs: Iterable[TrainingJob], profile: str, done: Iterable[Any]) -> list[TrainingJob]:
    """Return the jobs, each once, that no record of this profile covers."""
    finished = {record.job for record in done if record.profile == profile}
    return [job for job in dict.fromkeys(jobs) if job not in finished]


def run_missing(
    bench: Bench,
    jobs: Sequence[TrainingJob],
    file: str = RUNS,
    work: Work = adapt_job,
    kind: type[Record] = RunRecord,
) -> list[Record]:
    """Do the jobs that the bench's record `file` lacks and return the records of all that are finished.

    A killed run goes on from its last epoch.
    """
    path = bench.out / file
    todo = missing_jobs(jobs, bench.profile, read_records(path, kind))
    start = time.perf_counter()
    done = _one_by_one(bench, todo, work) if bench.workers == 1 else _on_workers(bench, todo, work)
    for count, record in enumerate(done, 1):
        append_record(path, record)
        print(f"{count}/{len(todo)}  {_summary(record)}  ({time.perf_counter() - start:.0f} s)", flush=True)
    wanted = set(jobs)
    return [r for r in read_records(path, kind) if r.profile == bench.profile and r.job in wanted]


def _one_by_one(bench: Bench, jobs: Sequence[TrainingJob], work: Work) -> Iterator[Any]:
    for job in jobs:
        if not bench.is_over():
            yield work(bench, job)


def _on_workers(bench: Bench, jobs: Sequence[TrainingJob], work: Work) -> Iterator[Any]:
    """Yield records as Dask workers finish them; runs that share a first stage wait for the one that trains it."""
    if not jobs:
        return
    from dask.distributed import as_completed

    from gelgap.adapt.run_key import stage1_profile
    from gelgap.domains import dask_client

    with dask_client(None, bench.workers) as client:
        first: dict[Any, Any] = {}
        runs = []
        for job in jobs:
            stage1 = (job.source, job.seed, stage1_profile(job.profile(bench.profile)).model_dump_json())
            runs.append(client.submit(_run_after, first.get(stage1), work, bench, job, pure=False))
            first.setdefault(stage1, runs[-1])
        for future in as_completed(runs, loop=client.loop):
            record = future.result()
            if record is not None:
                yield record


def _run_after(_: Any, work: Work, bench: Bench, job: TrainingJob) -> Any:
    return None if bench.is_over() else work(bench, job)


def _summary(record: Any) -> str:
    job = record.job
    changes = "".join(f"  {name} = {value}" for name, value in job.changes)
    result = record.problem or f"{record.mean_mae_n:.3f} N"
    return f"{job.source} → {job.target}  {job.method}  seed {job.seed}{changes}: {result}"
