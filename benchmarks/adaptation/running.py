"""Doing the runs that have no record yet, one per core; what was done before is not repeated."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from gelgap.benchmarks.adaptation.jobs import Bench, RunRecord, TrainingJob, configuration_of
from gelgap.benchmarks.common.records import append_record, read_records

Work = Callable[[Bench, TrainingJob], Any]
Configuration = Callable[[Bench, TrainingJob], str]


def missing_jobs(jobs: Iterable[TrainingJob], profile: str, done: Iterable[Any]) -> list[TrainingJob]:
    """Return the jobs, each once, that no record of this profile covers."""
    finished = {record.job for record in done if record.profile == profile}
    return [job for job in dict.fromkeys(jobs) if job not in finished]


def run_missing(
    bench: Bench,
    jobs: Sequence[TrainingJob],
    file: str,
    work: Work,
    kind: type = RunRecord,
    configuration: Configuration | None = None,
) -> list[Any]:
    """Do the jobs that the bench's record `file` lacks and return the records of all that are finished.

    `configuration` is what all methods of a job's data, group and changes have in common: `configuration_of` unless
    the data are no generated domains.

    Raises
    ------
    ValueError
        If a record is of another configuration than its job has now.
    """
    path = bench.out / file
    found = read_records(path, kind)
    todo = missing_jobs(jobs, bench.profile, found)
    _check_same_configuration(bench, set(jobs), found, path, configuration or configuration_of)
    start = time.perf_counter()
    done = _one_by_one(bench, todo, work) if bench.workers == 1 else _on_workers(bench, todo, work)
    for count, record in enumerate(done, 1):
        append_record(path, record)
        result = record.problem or f"{record.mean_mae_n:.3f} N"
        print(
            f"{count}/{len(todo)}  {record.job}: {result}  ({time.perf_counter() - start:.0f} s)", flush=True
        )
    wanted = set(jobs)
    return [r for r in read_records(path, kind) if r.profile == bench.profile and r.job in wanted]


def _check_same_configuration(
    bench: Bench, wanted: set[TrainingJob], found: Iterable[Any], path: Path, configuration: Configuration
) -> None:
    configurations: dict[Any, str] = {}
    for record in found:
        job = record.job
        if record.profile != bench.profile or job not in wanted:
            continue
        shared = (job.data, job.group, job.changes)
        if shared not in configurations:
            configurations[shared] = configuration(bench, job)
        settings = job.method_settings(bench.profile)
        if (record.configuration, record.settings) != (configurations[shared], settings):
            raise ValueError(
                f"{path}: the record of {job} is of another configuration than profile {bench.profile} and the data "
                "have now; move the file away, or choose another --out"
            )


def _one_by_one(bench: Bench, jobs: Sequence[TrainingJob], work: Work) -> Iterator[Any]:
    for job in jobs:
        if not bench.is_over():
            yield work(bench, job)


def _on_workers(bench: Bench, jobs: Sequence[TrainingJob], work: Work) -> Iterator[Any]:
    """Yield records as Dask workers finish them.

    Runs that share a first stage wait for the one that trains it. Which frames a source trains on may depend on the
    target; so the first runs of a source's groups follow one another, and the others of a group follow its first.
    """
    if not jobs:
        return
    from dask.distributed import as_completed

    from gelgap.adapt.runs import stage1_profile
    from gelgap.domains import dask_client

    with dask_client(None, bench.workers) as client:
        first: dict[Any, Any] = {}
        latest: dict[Any, Any] = {}
        runs = []
        for job in jobs:
            stage1 = stage1_profile(job.profile(bench.profile)).model_dump_json()
            of_source = (job.data, job.source, job.seed, stage1)
            of_group = (*of_source, job.target)
            before = first.get(of_group, latest.get(of_source))
            runs.append(client.submit(_run_after, before, work, bench, job, pure=False))
            if of_group not in first:
                first[of_group] = latest[of_source] = runs[-1]
        for future in as_completed(runs, loop=client.loop):
            record = future.result()
            if record is not None:
                yield record


def _run_after(_: Any, work: Work, bench: Bench, job: TrainingJob) -> Any:
    return None if bench.is_over() else work(bench, job)
