"""The leaderboard: results of anyone's methods on the nine groups, from records that are documented and checked.

A record is a JSON file with the fields of `Entry`: one method on one design, all groups and seeds. `--write` makes one
of each method whose runs are finished; the table is made of all records in a folder.
"""

import argparse
import datetime
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from gelgap.adapt import ResultTable
from gelgap.assets.checksums import read_json
from gelgap.assets.names import is_plain_name
from gelgap.assets.settings import Settings
from gelgap.assets.whole_file import write_whole
from gelgap.benchmarks.adaptation.board import DESIGNS, GROUPS, METHODS, PLAIN
from gelgap.benchmarks.adaptation.groups import FORMATS, SEEDS, load_headline, methods_of, summary
from gelgap.benchmarks.adaptation.study import with_errors
from gelgap.benchmarks.common import result_table

_BAD_INPUT = 2
_PLACES = [(*group, seed) for group in GROUPS for seed in SEEDS]
_Error = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class EntryRun(Settings):
    """One run of an entry: errors on the target's test frames per axis, N, and R²."""

    source: str
    target: str
    seed: int = Field(ge=0)
    configuration: str = Field(description="hash of what methods share: profile and both domains' recipes")
    mae_n: tuple[_Error, _Error, _Error]
    r2: tuple[float, float, float]


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
        return np.array([place[one] for one in _PLACES]).reshape(len(GROUPS), len(SEEDS))


def entries_of(runs: pd.DataFrame, design: str, who: str) -> Iterator[Entry]:
    """Yield the entries of the methods that have run on all groups and seeds."""
    runs = runs[runs["seed"].isin(SEEDS)]
    for method in methods_of(runs):
        own = runs[runs["method"] == method]
        if len(own) == len(_PLACES):
            first = own.iloc[0]
            settings = first.filter(like="settings.").dropna().rename(lambda name: name.partition(".")[2])
            yield Entry(
                **first[["method", "profile", "versions"]],
                design=design,
                settings=settings.to_dict(),
                who=who,
                when=datetime.datetime.now(tz=datetime.UTC).date(),
                runs=own[list(EntryRun.model_fields)].to_dict("records"),
            )


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
            found[path] = Entry(**dict(read_json(path)))
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path}: {error}") from None
    if not found:
        raise ValueError(f"{folder} holds no records of the leaderboard; --write makes those of your runs")
    plain = {entry.design: entry for entry in found.values() if entry.method == PLAIN}
    for path, entry in sorted(found.items(), key=lambda item: item[1].method != PLAIN):
        if entry.design not in plain:
            raise ValueError(
                f"{folder} lacks the record of {PLAIN}, {entry.design}, with which the others are compared"
            )
        if problem := _problem(entry, plain[entry.design]):
            raise ValueError(f"{path}: {problem}")
    return list(found.values())


def _problem(entry: Entry, plain: Entry) -> str | None:
    """Return what is wrong with an entry, if anything is; it must be of the same configurations as another one."""
    if not is_plain_name(entry.method):
        return f"method = {entry.method!r} is no name"
    runs = {(run.source, run.target, run.seed): f"{entry.profile} {run.configuration}" for run in entry.runs}
    if missing := [place for place in _PLACES if place not in runs]:
        first = "{} → {}, seed {}".format(*missing[0])
        return f"runs: {len(missing)} of {len(_PLACES)} are missing, the first is {first}"
    if len(entry.runs) > len(_PLACES):
        return f"runs: there are {len(entry.runs)}, needed are {len(_PLACES)}: each group with seeds {SEEDS}"
    expected = {(run.source, run.target): f"{plain.profile} {run.configuration}" for run in plain.runs}
    for (*group, seed), configuration in runs.items():
        if configuration != expected[tuple(group)]:
            return (
                f"{' → '.join(group)}, seed {seed}, is of configuration {configuration}, {PLAIN}'s is "
                f"{expected[tuple(group)]}; only runs of one profile and of the same data can be compared"
            )
    return None


def leaderboard_table(entries: Sequence[Entry], design: str) -> ResultTable:
    """All methods of a design by their mean error, with interval, rank, who and when."""
    own = {entry.method: entry for entry in entries if entry.design == design}
    runs = [{**run.model_dump(), "method": entry.method} for entry in own.values() for run in entry.runs]
    frame = summary(with_errors(pd.DataFrame(runs))).sort_values("mean MAE, N", kind="stable")
    shown = [own[method] for method in frame.index]
    frame["settings"] = [", ".join(f"{k} = {v}" for k, v in e.settings.items()) or None for e in shown]
    frame["who"] = [entry.who for entry in shown]
    frame["when"] = [entry.when.isoformat() for entry in shown]
    named = {method: f"**{method}**" for method in frame.index if method not in METHODS}
    return result_table(
        f"{design.capitalize()} contacts",
        frame.rename(index=named, columns={"rank": "mean rank"}),
        f"Nine groups, seeds {SEEDS[0]} to {SEEDS[-1]}, profile {shown[0].profile}, split by contact point. Interval: "
        "bootstrap over groups and seeds. Rank: mean over the groups, the ceiling apart.",
        FORMATS | {"mean rank": "{:.1f}"},
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Check the records of a folder and write the leaderboard; with --write, first make those of finished runs."""
    name = "python -m gelgap.benchmarks.adaptation.leaderboard"
    parser = argparse.ArgumentParser(prog=name, description=main.__doc__)
    records_help = "folder of the records, a JSON file for each method and design"
    parser.add_argument("records", type=Path, help=records_help)
    parser.add_argument("--write", type=Path, metavar="RUNS", help="folder of the benchmark's runs")
    parser.add_argument("--who", default="gelgap", help="who ran them")
    parser.add_argument("--out", type=Path, default=Path("docs/results/leaderboard.md"))
    chosen = parser.parse_args(arguments)
    try:
        for design in DESIGNS if chosen.write else ():
            for entry in entries_of(load_headline(chosen.write, design), design, chosen.who):
                file = chosen.records / f"{entry.method}-{design}.json"
                write_whole(file, f"{entry.model_dump_json()}\n".encode())
        entries = read_entries(chosen.records)
        designs = [design for design in DESIGNS if any(entry.design == design for entry in entries)]
        tables = [leaderboard_table(entries, design).markdown() for design in designs]
        write_whole(chosen.out, "\n".join(["# Leaderboard\n", *tables]).encode())
    except ValueError as error:
        parser.exit(_BAD_INPUT, f"{' '.join(str(error).split())}\n")
    print(f"wrote {chosen.out}")


if __name__ == "__main__":
    main()
