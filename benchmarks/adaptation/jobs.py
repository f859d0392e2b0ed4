"""Runs of the adaptation benchmarks as resumable records: one JSON line a run, nothing computed twice."""

import argparse
import json
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

if TYPE_CHECKING:
    from gelgap.adapt import Profile

Axes = tuple[float, float, float]
Changes = tuple[tuple[str, Any], ...]
_NOTHING = (math.nan, math.nan, math.nan)


def study_parser(description: str | None, seeds: Sequence[int]) -> argparse.ArgumentParser:
    """Return a parser of what every study takes: seeds, processes, and how long to go on beginning runs."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(seeds))
    parser.add_argument("--workers", type=int, help="processes; default: one a core")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no run after so many minutes")
    return parser


@dataclass(frozen=True)
class Job:
    """One run to do: a method on a group with a seed; `changes` are profile fields that differ from the preset."""

    source: str
    target: str
    method: str
    seed: int
    changes: Changes = ()

    def profile(self, preset: str) -> "Profile":
        """Return the preset with this job's changes; a transfer weight among them stands above the method's own."""
        from gelgap.adapt import Profile

        profile, changes = Profile.preset(preset), dict(self.changes)
        if "transfer_weight" in changes:
            own = {k: v for k, v in profile.settings.get(self.method, {}).items() if k != "transfer_weight"}
            changes["settings"] = {**profile.settings, self.method: own}
        return profile.replace(**changes)


@dataclass(frozen=True)
class Line:
    """One finished run: errors on the target's test frames per axis (N, and R²), and what else the tables need.

    Errors are NaN where the run stopped with `problem`. `stage1_s` is 0 where another run had trained the checkpoint.
    """

    job: Job
    profile: str
    versions: dict[str, str]
    problem: str | None = None
    key: str = ""
    mae_n: Axes = _NOTHING
    r2: Axes = _NOTHING
    constant_mean_n: Axes = _NOTHING
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


AnyLine = TypeVar("AnyLine")
Work = Callable[[Path, Path, str, Job], AnyLine]


def adapt_job(data: Path, out: Path, profile: str, job: Job) -> Line:
    """Do one run; a collapse, or a loss that is not finite, is a result, not a failure."""
    from gelgap.adapt import FeatureCollapse, TrainingDiverged, adapt_folders
    from gelgap.adapt.run_record import versions

    settings = job.profile(profile)
    try:
        (run,) = adapt_folders(
            data / job.source, data / job.target, [job.method], settings, job.seed, out_dir=out
        )
    except (FeatureCollapse, TrainingDiverged) as problem:
        return Line(job, profile, versions(), problem=str(problem))
    last = run.history[-1] if run.history else {}
    return Line(
        job=job,
        profile=profile,
        mae_n=run.target_test.mae_n,
        r2=run.target_test.r2,
        constant_mean_n=run.target_constant_mean.mae_n,
        source_held_out_r2=None if run.source_held_out is None else run.source_held_out.r2,
        stage1_s=run.wall_s["stage1"],
        stage2_s=run.wall_s["stage2"],
        feature_rank=last.get("feature_rank", math.nan),
        prediction_spread=last.get("prediction_spread", math.nan),
        skipped_steps=run.skipped_steps,
        problem=None,
        key=run.key,
        versions=run.versions,
    )


def read_lines(path: Path, kind: type[AnyLine] = Line) -> list[AnyLine]:
    """Read finished runs; a last line that was cut off by a kill is left out."""
    if not path.is_file():
        return []
    lines = []
    for text in path.read_text(encoding="utf-8").splitlines():
        try:
            content = json.loads(text)
        except json.JSONDecodeError:
            continue
        content = {field.name: _tuples(content[field.name]) for field in fields(kind)}
        lines.append(kind(**content | {"job": Job(**content["job"])}))
    return lines


def append_line(path: Path, line: Any) -> None:
    """Add one finished run; a line that a kill left unfinished is ended first."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a+b") as file:
        if file.tell():
            file.seek(-1, 2)
            if file.read(1) != b"\n":
                file.write(b"\n")
        file.write((json.dumps(asdict(line), ensure_ascii=False) + "\n").encode())


def missing_jobs(jobs: Iterable[Job], profile: str, done: Iterable[Any]) -> list[Job]:
    """Return the jobs, each once, that no finished line of this profile covers."""
    finished = {line.job for line in done if line.profile == profile}
    return [job for job in dict.fromkeys(jobs) if job not in finished]


def run_missing(
    data: Path,
    out: Path,
    profile: str,
    jobs: Sequence[Job],
    work: Work = adapt_job,
    kind: type[AnyLine] = Line,
    record: str = "runs.jsonl",
    workers: int | None = None,
    scheduler: str | None = None,
    minutes: float = math.inf,
) -> list[AnyLine]:
    """Do the jobs that `out/record` lacks, one a core, and return the lines of all that are finished.

    A killed run goes on from its last epoch. One worker means this process, without a cluster. `minutes` ends a piece
    of the work: no run is begun after that time.
    """
    path, limit_s = out / record, 60 * minutes
    todo = missing_jobs(jobs, profile, read_lines(path, kind))
    start = time.perf_counter()
    if workers == 1:
        lines = _one_by_one(data, out, profile, todo, work, limit_s)
    else:
        lines = _on_workers(data, out, profile, todo, work, limit_s, workers, scheduler)
    for count, line in enumerate(lines, 1):
        append_line(path, line)
        print(f"{count}/{len(todo)}  {_said(line)}  ({time.perf_counter() - start:.0f} s)", flush=True)
    wanted = set(jobs)
    return [line for line in read_lines(path, kind) if line.profile == profile and line.job in wanted]


def _one_by_one(
    data: Path, out: Path, profile: str, jobs: Sequence[Job], work: Work, limit_s: float
) -> Iterator[Any]:
    start = time.perf_counter()
    for job in jobs:
        if time.perf_counter() - start < limit_s:
            yield work(data, out, profile, job)


def _on_workers(
    data: Path,
    out: Path,
    profile: str,
    jobs: Sequence[Job],
    work: Work,
    limit_s: float,
    workers: int | None,
    scheduler: str | None,
) -> Iterator[Any]:
    """Yield lines as Dask workers finish them; runs that share a stage 1 wait for it."""
    if not jobs:
        return
    from dask.distributed import as_completed

    from gelgap.adapt.run_key import stage1_profile
    from gelgap.domains import dask_client

    stop = time.time() + limit_s
    with dask_client(scheduler, workers) as client:
        stage1: dict[Any, Any] = {}
        runs = []
        for job in jobs:
            shared = (job.source, job.seed, stage1_profile(job.profile(profile)).model_dump_json())
            if shared not in stage1:
                stage1[shared] = client.submit(_stage1, data, out, profile, job, pure=False)
            runs.append(
                client.submit(_after, stage1[shared], stop, work, data, out, profile, job, pure=False)
            )
        for future in as_completed(runs, loop=client.loop):
            line = future.result()
            if line is not None:
                yield line


def _stage1(data: Path, out: Path, profile: str, job: Job) -> float:
    from gelgap.adapt import Stage1, split_for_training
    from gelgap.domains import open_domain

    settings = job.profile(profile)
    source, target = open_domain(data / job.source), open_domain(data / job.target)
    frames = split_for_training(source, target, settings, job.seed)
    return Stage1(frames.source_train, settings, job.seed, out=out).model()[1]


def _after(stage1_s: float, stop: float, work: Work, data: Path, out: Path, profile: str, job: Job) -> Any:
    return work(data, out, profile, job) if time.time() < stop else None


def _said(line: Any) -> str:
    job = line.job
    changes = "".join(f"  {name} = {value}" for name, value in job.changes)
    result = line.problem or f"{line.mean_mae_n:.3f} N"
    return f"{job.source} → {job.target}  {job.method}  seed {job.seed}{changes}: {result}"


def _tuples(value: Any) -> Any:
    """Turn JSON's lists back into the tuples of the dataclasses."""
    if isinstance(value, list):
        return tuple(_tuples(item) for item in value)
    if isinstance(value, dict):
        return {name: _tuples(item) for name, item in value.items()}
    return value
