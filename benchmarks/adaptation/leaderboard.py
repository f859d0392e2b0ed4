"""The leaderboard: results of anyone's methods on the nine groups, from records that are documented and checked.

A record is a JSON file with the fields of `Entry`: one method on one design, all groups and seeds. `--write` makes one
of each method whose runs are finished; the table is made of all records in a folder.
"""

import argparse
import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from gelgap.adapt import ResultTable
from gelgap.assets.checksums import read_json
from gelgap.assets.names import is_plain_name
from gelgap.assets.settings import Settings
from gelgap.assets.whole_file import write_whole
from gelgap.benchmarks.adaptation.compared import METHODS
from gelgap.benchmarks.adaptation.data_sets import DESIGNS
from gelgap.benchmarks.adaptation.groups import SEEDS
from gelgap.benchmarks.adaptation.jobs import Axes, RunRecord
from gelgap.benchmarks.adaptation.paper import GROUPS
from gelgap.benchmarks.adaptation.results import CEILING, Results, load_results
from gelgap.benchmarks.adaptation.statistics import bootstrap_interval, ranks
from gelgap.benchmarks.adaptation.tables import AXES, by_column, interval, number, numbers

PLAIN = "source-only"
_BAD_INPUT = 2


class EntryRun(Settings):
    """One run of an entry: errors on the target's test frames per axis, N, and R²."""

    source: str
    target: str
    seed: int = Field(ge=0)
    configuration: str = Field(
        description="hash of what all methods share: profile and recipes of both domains"
    )
    mae_n: Axes
    r2: Axes


class Entry(Settings):
    """A method's result on one design: nine groups and five seeds, split by contact point."""

    format: Literal[1] = 1
    method: str
    design: Literal["paired", "independent"]
    profile: str
    settings: dict[str, Any] = Field(description="the method's own settings that differ from its defaults")
    who: str = Field(description="who ran it")
    when: datetime.date
    versions: str
    runs: tuple[EntryRun, ...]

    @property
    def errors_n(self) -> np.ndarray:
        """Mean MAE over the axes (groups, seeds), N."""
        place = {(run.source, run.target, run.seed): float(np.mean(run.mae_n)) for run in self.runs}
        return np.array([[place[(*group, seed)] for seed in SEEDS] for group in GROUPS])


def entries_of(results: Results, design: str, who: str) -> list[Entry]:
    """Return the entries of the methods that have run on all groups and seeds."""
    found = []
    for method in results.methods:
        own = [record for record in results.records if record.job.method == method]
        if {(*r.job.group, r.job.seed) for r in own} >= {
            (*group, seed) for group in GROUPS for seed in SEEDS
        }:
            found.append(_entry([record for record in own if record.job.seed in SEEDS], design, who))
    return found


def _entry(records: Sequence[RunRecord], design: str, who: str) -> Entry:
    first = records[0]
    runs = [
        EntryRun(
            source=record.job.source,
            target=record.job.target,
            seed=record.job.seed,
            configuration=record.configuration,
            mae_n=record.mae_n,
            r2=record.r2,
        )
        for record in records
    ]
    return Entry(
        method=first.job.method,
        design=design,
        profile=first.profile,
        settings=first.settings,
        who=who,
        when=datetime.datetime.now(tz=datetime.UTC).date(),
        versions=first.versions,
        runs=tuple(runs),
    )


def write_entries(entries: Sequence[Entry], folder: Path) -> None:
    """Write each entry to its file of a folder."""
    for entry in entries:
        write_whole(folder / f"{entry.method}-{entry.design}.json", f"{entry.model_dump_json()}\n".encode())


def read_entries(folder: Path) -> list[Entry]:
    """Read and check all entries of a folder.

    Raises
    ------
    ValueError
        If a file is no entry, lacks a run, or is of another configuration than source-only's entry of its design; the
        message names the file.
    """
    found: dict[Path, Entry] = {}
    for path in sorted(folder.glob("*.json")):
        try:
            found[path] = Entry.model_validate(read_json(path))
            _check_runs(found[path])
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
    if not found:
        raise ValueError(f"{folder} holds no records of the leaderboard; --write makes those of your runs")
    plain = {entry.design: entry for entry in found.values() if entry.method == PLAIN}
    for path, entry in found.items():
        if entry.design not in plain:
            raise ValueError(
                f"{folder} lacks the record of {PLAIN}, {entry.design}, with which the others are compared"
            )
        _check_same_configuration(path, entry, plain[entry.design])
    return list(found.values())


def _check_runs(entry: Entry) -> None:
    if not is_plain_name(entry.method):
        raise ValueError(f"method = {entry.method!r} is no name")
    wanted = [(*group, seed) for group in GROUPS for seed in SEEDS]
    given = [(run.source, run.target, run.seed) for run in entry.runs]
    if missing := [run for run in wanted if run not in given]:
        source, target, seed = missing[0]
        first = f"{source} → {target}, seed {seed}"
        raise ValueError(f"runs: {len(missing)} of {len(wanted)} are missing, the first is {first}")
    if len(given) > len(wanted):
        raise ValueError(
            f"runs: there are {len(given)}, needed are {len(wanted)}: each group with seeds {SEEDS}"
        )
    if not np.isfinite([run.mae_n for run in entry.runs]).all() or min(min(r.mae_n) for r in entry.runs) < 0:
        raise ValueError("mae_n: must be finite and not negative")


def _check_same_configuration(path: Path, entry: Entry, plain: Entry) -> None:
    expected = {(run.source, run.target): run.configuration for run in plain.runs}
    for run in entry.runs:
        if (entry.profile, run.configuration) != (plain.profile, expected[run.source, run.target]):
            raise ValueError(
                f"{path}: {run.source} → {run.target}, seed {run.seed}, is of configuration {entry.profile} "
                f"{run.configuration}, {PLAIN}'s is {plain.profile} {expected[run.source, run.target]}; only runs "
                "of one profile and of the same data can be compared"
            )


def leaderboard_table(entries: Sequence[Entry], design: str) -> ResultTable:
    """All methods of a design by their mean error, with interval, rank, who and when."""
    own = sorted((e for e in entries if e.design == design), key=lambda entry: entry.errors_n.mean())
    learned = [entry for entry in own if entry.method != CEILING]
    by_group = np.array([entry.errors_n.mean(axis=1) for entry in learned])
    rank = dict(zip((e.method for e in learned), ranks(by_group).mean(axis=1), strict=True))
    r2 = np.array([np.mean([run.r2 for run in entry.runs], axis=0) for entry in own])
    return by_column(
        f"{design.capitalize()} contacts",
        "method",
        [entry.method if entry.method in METHODS else f"**{entry.method}**" for entry in own],
        {
            "mean MAE, N": numbers([entry.errors_n.mean() for entry in own]),
            "95 % interval": [interval(bootstrap_interval(entry.errors_n)) for entry in own],
            **{f"R² {axis}": numbers(r2[:, i], ".2f") for i, axis in enumerate(AXES)},
            "mean rank": [number(rank.get(entry.method, np.nan), ".1f") for entry in own],
            "settings": [", ".join(f"{k} = {v}" for k, v in entry.settings.items()) or "–" for entry in own],
            "who": [entry.who for entry in own],
            "when": [entry.when.isoformat() for entry in own],
        },
        f"Nine groups, seeds {SEEDS[0]} to {SEEDS[-1]}, profile {own[0].profile}, split by contact point. Interval: "
        "bootstrap over groups and seeds. Rank: mean over the groups, the ceiling apart.",
    )


def write_leaderboard(entries: Sequence[Entry], path: Path) -> None:
    """Write the leaderboard as Markdown."""
    designs = [design for design in DESIGNS if any(entry.design == design for entry in entries)]
    tables = [leaderboard_table(entries, design).markdown() for design in designs]
    write_whole(path, "\n".join(["# Leaderboard\n", *tables]).encode())


def main(arguments: Sequence[str] | None = None) -> None:
    """Check the records of a folder and write the leaderboard; with --write, first make those of finished runs."""
    parser = argparse.ArgumentParser(
        prog="python -m gelgap.benchmarks.adaptation.leaderboard", description=main.__doc__
    )
    parser.add_argument(
        "records", type=Path, help="folder of the records, a JSON file for each method and design"
    )
    parser.add_argument("--write", type=Path, metavar="RUNS", help="folder of the benchmark's runs")
    parser.add_argument("--who", default="gelgap", help="who ran them")
    parser.add_argument("--out", type=Path, default=Path("docs/results/leaderboard.md"))
    chosen = parser.parse_args(arguments)
    try:
        if chosen.write is not None:
            for design in DESIGNS:
                write_entries(
                    entries_of(load_results(chosen.write, design), design, chosen.who), chosen.records
                )
        write_leaderboard(read_entries(chosen.records), chosen.out)
    except ValueError as error:
        parser.exit(_BAD_INPUT, f"{' '.join(str(error).split())}\n")
    print(f"wrote {chosen.out}")


if __name__ == "__main__":
    main()
