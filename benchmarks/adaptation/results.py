"""The finished runs of the benchmark as arrays over methods, groups and seeds, and the groups' oracles."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from gelgap.benchmarks.adaptation.jobs import RUNS, Axes, RunRecord, TrainingJob
from gelgap.benchmarks.adaptation.paper import GROUPS, PAPER_MAE_N, TABLE_METHODS
from gelgap.benchmarks.common.records import read_records, read_results, write_results

ORACLES = "oracles.json"
_NO_RUN = RunRecord(TrainingJob("", "", "", 0), "", {})


@dataclass(frozen=True)
class GroupOracles:
    """Oracle errors of a group from paired contacts: mean absolute errors per axis, N, without learning."""

    pose_n: Axes
    geometry_n: Axes

    def comparable(self, group: tuple[str, str]) -> bool:
        """Return whether perfect alignment of poses could reach what the paper reports for DSAN."""
        if group not in GROUPS:
            return True
        return float(np.mean(self.pose_n)) <= PAPER_MAE_N["dsan"][GROUPS.index(group)]


def write_oracles(folder: Path, oracles: dict[tuple[str, str], GroupOracles]) -> None:
    """Keep the groups' oracles beside the runs, so that a report needs no data."""
    write_results(folder / ORACLES, {" → ".join(group): found for group, found in oracles.items()})


def is_benchmark(folder: Path) -> bool:
    """Return whether a folder holds the records of the benchmark."""
    return (folder / RUNS).is_file() and (folder / ORACLES).is_file()


@dataclass(frozen=True)
class Results:
    """The finished runs of some groups and methods, and the oracles of the groups."""

    records: Sequence[RunRecord]
    groups: Sequence[tuple[str, str]]
    methods: Sequence[str]
    seeds: Sequence[int]
    oracles: dict[tuple[str, str], GroupOracles]

    @cached_property
    def _by_job(self) -> dict[TrainingJob, RunRecord]:
        return {record.job: record for record in self.records}

    def values(self, field: str) -> np.ndarray:
        """Return a record's field (methods, groups, seeds), NaN where a run is missing or collapsed.

        A field with a value per axis gives (3, methods, groups, seeds).
        """

        def value(*job: object) -> float | Axes:
            record = self._by_job.get(TrainingJob(*job), _NO_RUN)
            return getattr(record if record.problem is None else _NO_RUN, field)

        found = np.array(
            [[[value(*g, m, s) for s in self.seeds] for g in self.groups] for m in self.methods], float
        )
        return np.moveaxis(found, 3, 0) if found.ndim == 4 else found

    @cached_property
    def errors_n(self) -> np.ndarray:
        """Mean MAE over the axes (methods, groups, seeds), N."""
        return self.values("mean_mae_n")

    @cached_property
    def constant_mean_n(self) -> np.ndarray:
        """Error (groups,) of predicting the source's mean force, N, mean over the seeds' test frames."""
        return mean_of(self.values("constant_mean_n").mean(axis=0), axis=(0, 2))

    @cached_property
    def common(self) -> np.ndarray:
        """Which pairs (groups, seeds) every method except supervised has finished, including those that collapsed."""
        learned = [method for method in self.methods if method != "supervised"]
        return np.array(
            [
                [all(TrainingJob(*g, m, s) in self._by_job for m in learned) for s in self.seeds]
                for g in self.groups
            ]
        )

    @cached_property
    def balanced_n(self) -> np.ndarray:
        """The errors on the common pairs, by which methods are compared; NaN elsewhere."""
        return np.where(self.common, self.errors_n, np.nan)

    def of(self, method: str) -> np.ndarray:
        """Return the errors (groups, seeds) of one method on the common pairs, N."""
        return self.balanced_n[list(self.methods).index(method)]

    def axis_means(self, field: str) -> np.ndarray:
        """Return the means (3, methods) of a field with a value per axis on the common pairs, over the groups."""
        return over_groups(np.where(self.common, self.values(field), np.nan))

    @cached_property
    def learned(self) -> list[int]:
        """The indices of the methods except supervised, which are ranked."""
        return [i for i, method in enumerate(self.methods) if method != "supervised"]

    @cached_property
    def group_errors_n(self) -> np.ndarray:
        """The errors (learned methods, groups) on the common pairs, means over seeds, N."""
        return mean_of(self.balanced_n[self.learned], axis=2)

    @cached_property
    def stage1_s(self) -> float:
        """Median time of the first stage, which all methods of a source and seed share; NaN if nothing was timed."""
        return float(np.median([r.stage1_s for r in self.records if r.stage1_s > 0] or [math.nan]))


def mean_of(values: np.ndarray, axis: int | tuple[int, ...] | None = None) -> np.ndarray:
    """Return the mean of what is not NaN; NaN where nothing is."""
    there = ~np.isnan(values)
    count = there.sum(axis=axis)
    return np.where(count > 0, np.where(there, values, 0.0).sum(axis=axis) / np.maximum(count, 1), np.nan)


def over_groups(values: np.ndarray) -> np.ndarray:
    """Return the mean over groups of the means over seeds of (…, groups, seeds); NaN where a group has no run."""
    return mean_of(values, axis=-1).mean(axis=-1)


def load_results(folder: Path) -> Results:
    """Read the finished runs of the paper's methods; groups and methods without any run are left out."""
    return _results(folder, [record for record in _records(folder) if record.job.method in TABLE_METHODS])


def load_further(folder: Path) -> Results:
    """Read the finished runs of all methods, of the groups and seeds that methods beside the paper's were run on."""
    records = _records(folder)
    further = {(r.job.group, r.job.seed) for r in records if r.job.method not in TABLE_METHODS}
    return _results(folder, [record for record in records if (record.job.group, record.job.seed) in further])


def first_run(folder: Path, group: tuple[str, str], method: str) -> Path | None:
    """Return the folder of a group's run with the least seed among those that are kept; None if there is none."""
    from gelgap.adapt.runs import run_folder

    for record in sorted(_records(folder), key=lambda record: record.job.seed):
        if (record.job.group, record.job.method) == (group, method):
            path = run_folder(folder, *group, method, record.job.seed, record.key)
            if path.is_dir():
                return path
    return None


def _records(folder: Path) -> list[RunRecord]:
    return [record for record in read_records(folder / RUNS, RunRecord) if not record.job.changes]


def _results(folder: Path, records: Sequence[RunRecord]) -> Results:
    found = read_results(folder / ORACLES, dict[str, GroupOracles])
    oracles = {tuple(name.split(" → ")): values for name, values in found.items()}
    groups = [group for group in oracles if any(record.job.group == group for record in records)]
    groups.sort(key=lambda group: GROUPS.index(group) if group in GROUPS else len(GROUPS))
    methods = dict.fromkeys(record.job.method for record in records)
    known = [method for method in TABLE_METHODS if method in methods]
    seeds = sorted({record.job.seed for record in records})
    every = [*known, *(method for method in methods if method not in known)]
    return Results(records, groups, every, seeds, {group: oracles[group] for group in groups})
