"""The headline's finished runs as arrays over methods, groups and seeds, and the groups' oracles."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from gelgap.benchmarks.adaptation.compared import METHODS
from gelgap.benchmarks.adaptation.jobs import BY_POINT, RUNS, Axes, Changes, RunRecord, TrainingJob
from gelgap.benchmarks.adaptation.paper import GROUPS, PAPER_MAE_N
from gelgap.benchmarks.common.records import read_records, read_results, write_results

ORACLES = "oracles.json"
CEILING = "supervised"
_NO_RUN = RunRecord(TrainingJob("", "", "", 0), "")


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


def read_oracles(folder: Path) -> dict[tuple[str, str], GroupOracles]:
    """Return what `write_oracles` wrote."""
    found = read_results(folder / ORACLES, dict[str, GroupOracles])
    return {(name.split(" → ")[0], name.split(" → ")[1]): oracles for name, oracles in found.items()}


def is_benchmark(folder: Path) -> bool:
    """Return whether a folder holds the records of the benchmark."""
    return (folder / RUNS).is_file() and (folder / ORACLES).is_file()


@dataclass(frozen=True)
class Results:
    """The finished runs of one data set and split, of some groups, methods and seeds.

    A run that collapsed counts with the error of the constant mean that it became; NaN is a run that is not there.
    """

    records: Sequence[RunRecord]
    groups: Sequence[tuple[str, str]]
    methods: Sequence[str]
    seeds: Sequence[int]

    @cached_property
    def _by_place(self) -> dict[tuple, RunRecord]:
        return {(record.job.group, record.job.method, record.job.seed): record for record in self.records}

    def values(self, field: str) -> np.ndarray:
        """Return a record's field (methods, groups, seeds), NaN where a run is missing.

        A field with a value per axis gives (3, methods, groups, seeds).
        """
        found = np.array(
            [
                [
                    [getattr(self._by_place.get((g, m, s), _NO_RUN), field) for s in self.seeds]
                    for g in self.groups
                ]
                for m in self.methods
            ],
            float,
        )
        return np.moveaxis(found, 3, 0) if found.ndim == 4 else found

    @cached_property
    def common(self) -> np.ndarray:
        """Which pairs (groups, seeds) every method has finished, the ceiling apart."""
        learned = [method for method in self.methods if method != CEILING]
        return np.array(
            [[all((g, m, s) in self._by_place for m in learned) for s in self.seeds] for g in self.groups]
        )

    @cached_property
    def errors_n(self) -> np.ndarray:
        """Mean MAE over the axes (methods, groups, seeds) on the common pairs, N; NaN elsewhere."""
        return np.where(self.common, self.values("mean_mae_n"), np.nan)

    @cached_property
    def group_errors_n(self) -> np.ndarray:
        """The errors (methods, groups), means over seeds, N."""
        return mean_of(self.errors_n, axis=2)

    @cached_property
    def constant_mean_n(self) -> np.ndarray:
        """Error (groups,) of predicting the source's mean force, N, mean over the seeds' test frames."""
        return mean_of(self.values("constant_mean_n").mean(axis=0), axis=(0, 2))

    def has(self, *methods: str) -> bool:
        """Return whether all of these methods were run."""
        return set(methods) <= set(self.methods)

    def of(self, method: str) -> np.ndarray:
        """Return the errors (groups, seeds) of one method on the common pairs, N."""
        return self.errors_n[list(self.methods).index(method)]

    def group_means_n(self, method: str) -> np.ndarray:
        """Return the errors (groups,) of one method, means over seeds, N."""
        return mean_of(self.of(method), axis=1)

    def axis_means(self, field: str) -> np.ndarray:
        """Return the means (3, methods) of a field with a value per axis on the common pairs, over the groups."""
        return over_groups(np.where(self.common, self.values(field), np.nan))

    def collapsed(self, method: str) -> int:
        """Return how many runs of a method stopped with a problem."""
        return sum(record.problem is not None for record in self.records if record.job.method == method)

    def control_of(self, method: str) -> str | None:
        """Return the method's control; None if it has none, or the control was not run."""
        control = next((record.control for record in self.records if record.job.method == method), None)
        return control if control in self.methods else None

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


def load_results(folder: Path, data: str = "paired", changes: Changes = BY_POINT) -> Results:
    """Read the finished runs of a data set and split; methods, groups and seeds without any run are left out.

    Raises
    ------
    ValueError
        If the runs of a group are not all of one configuration.
    """
    records = [
        r for r in read_records(folder / RUNS, RunRecord) if (r.job.data, r.job.changes) == (data, changes)
    ]
    check_one_configuration(records, folder / RUNS)
    groups = [group for group in GROUPS if any(record.job.group == group for record in records)]
    methods = dict.fromkeys(record.job.method for record in records)
    known = [method for method in METHODS if method in methods]
    seeds = sorted({record.job.seed for record in records})
    return Results(records, groups, [*known, *(m for m in methods if m not in known)], seeds)


def check_one_configuration(records: Sequence[RunRecord], path: Path) -> None:
    """Raise ValueError if runs of the same group, data set and split differ in profile or recipes."""
    first: dict[tuple, RunRecord] = {}
    for record in records:
        job = record.job
        other = first.setdefault((job.data, job.group, job.changes), record)
        if (other.profile, other.configuration) != (record.profile, record.configuration):
            raise ValueError(
                f"{path}: the record of {job} is of another configuration than that of {other.job}; "
                "only runs of one profile and of the same data can be compared"
            )
