"""The leaderboard: entries that are trained here, with their controls, and below them predictions that were handed in.

The places are fixed: two gaps of light, two seeds, contacts that are alike on both sides and contacts that are not.
An entry is a method on one of the inputs, or on one of the sources in random lights. What others have predicted is
judged by the same labels, but nobody saw how it was made (noise on the labels would come first), so that it has no
rank.
"""

from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.adapt.evaluation import evaluate_predictions
from gelgap.adapt.inputs import INPUTS
from gelgap.adapt.result_table import ResultTable
from gelgap.assets.names import is_plain_name
from gelgap.benchmarks.adaptation import board
from gelgap.benchmarks.adaptation.board import BY_POINT, PLAIN
from gelgap.benchmarks.adaptation.groups import (
    RULES,
    SUMMARY_FORMATS,
    check_one_configuration,
    load_upper_bounds,
    summary,
    upper_bounds_of,
    with_rules,
)
from gelgap.benchmarks.adaptation.inputs_and_lights import INPUT_RUNS, LIGHT_RUNS, changes_of
from gelgap.benchmarks.adaptation.study import RUNS, Part, Study, adapt_run, grid, load_runs, with_errors
from gelgap.benchmarks.common import Setting, read_records

GROUPS: tuple[board.Group, ...] = (("wmb0i0", "wmb0i1"), ("wmb0i0", "wmb0i2"))
SEEDS = (0, 1)
HANDED_IN = "handed-in"
"""The folder, below the runs, of records that others have sent: `NAME.jsonl` and the arrays in `NAME`."""
_PLACE = ["target", "seed"]
SOURCES = {"any-light": lambda target: board.ANY_LIGHT, "like-target": lambda target: board.LIKE + target}


def entry_grid(methods: tuple[str, ...], inputs: tuple[str, ...]) -> dict[str, list[Setting]]:
    """Return the runs of methods on inputs or in random lights, by the file of their records.

    Raises
    ------
    ValueError
        If an input shows markers, which the leaderboard's gaps have not.
    """
    if "markers" in inputs:
        raise ValueError("--inputs markers: the leaderboard's sensors have no markers")
    found: dict[str, list[Setting]] = {}
    for name, data in product(inputs, board.BY_ROLE):
        source, changes = SOURCES.get(name), BY_POINT if name in SOURCES else changes_of(name)
        groups = [(source(target), target) for _, target in GROUPS] if source else GROUPS
        file = LIGHT_RUNS if source else RUNS if name == "pictures" else INPUT_RUNS
        runs = grid([(data, group) for group in groups], methods, SEEDS, changes)
        found[file] = found.get(file, []) + runs
    return found


def measure(study: Study) -> None:
    """Train what is missing: the methods named with their controls, the baselines on pictures, and upper bounds."""
    methods, inputs = study.known_methods(), study.inputs or ("pictures",)
    wanted = entry_grid(methods, inputs)
    starts = entry_grid((PLAIN, "adabn"), ("pictures",))[RUNS]
    study.generate_for([*starts, *(run for runs in wanted.values() for run in runs)])
    for file, runs in ((RUNS, [*upper_bounds_of(starts), *starts]), *wanted.items()):
        study.run(adapt_run, runs, file)


def entries(folder: Path) -> pd.DataFrame:
    """Return all runs of a folder on the leaderboard's places; a method on another input is `method / input`.

    Raises
    ------
    ValueError
        If the runs of a place on one input are not all of one configuration.
    """
    source_of = {target: source for source, target in GROUPS}
    shown = {changes_of(name): name for name in INPUTS}
    found = []
    for file in (RUNS, INPUT_RUNS, LIGHT_RUNS):
        runs = load_runs(folder / file)
        runs = runs[
            runs["seed"].isin(SEEDS) & runs["data"].isin(board.BY_ROLE) & (runs["settings"].map(len) == 0)
        ]
        runs = runs[runs["target"].isin(source_of) & runs["changes"].isin(list(shown))]
        name, own = runs["changes"].map(shown), runs["target"].map(source_of)
        for light, source in SOURCES.items():
            name = name.mask(runs["source"] == runs["target"].map(source), light)
        for place, own_runs in runs.groupby(["source", "target", "data", name]):
            check_one_configuration(own_runs, f"{folder / file}: the runs of {' '.join(place)}")
        runs = runs.assign(method=runs["method"].where(name == "pictures", runs["method"] + " / " + name))
        found.append(runs[(runs["source"] == own) | name.isin(list(SOURCES))].assign(source=own))
    return with_errors(pd.concat(found).drop_duplicates(["data", "target", "method", "seed"]))


def handed_in(
    folder: Path, study: Study, starts: pd.DataFrame
) -> Iterator[tuple[str, str, pd.DataFrame | str]]:
    """Yield data set, name and runs of every entry that was handed in; in place of runs why they cannot be judged.

    Errors are computed from the predictions and the labels of the test frames of `starts`, the runs of source-only.
    """
    for file in sorted(folder.glob("*.jsonl")):
        runs = read_records(file)
        if not {*_PLACE, "method", "data", "predicted_n"} <= set(runs) or not all(
            map(is_plain_name, runs["method"])
        ):
            yield board.DATA, file.stem, "holds no predictions of a method for places of the leaderboard"
            continue
        for (data, method), own in runs.groupby(["data", "method"], sort=False):
            places = starts[starts["data"] == data].set_index(_PLACE)
            own = own.set_index(_PLACE)
            own = own[own.index.isin(places.index)]
            name = f"{method} ({file.stem})"
            if own.index.duplicated().any():
                yield data, name, "has a run twice"
            elif missing := len(places.index.difference(own.index)):
                yield data, name, f"lacks {missing} of {len(places)} runs"
            elif len(places):
                yield data, name, _judged(own, places, study, name)


def _judged(own: pd.DataFrame, places: pd.DataFrame, study: Study, name: str) -> pd.DataFrame | str:
    rows = []
    for place, start in places.iterrows():
        test = study.frames_of(dict(zip(_PLACE, place, strict=True)) | dict(start)).target_test
        predicted = np.asarray(own.loc[place, "predicted_n"])
        if predicted.shape != test.force_n.shape or not np.isfinite(predicted).all():
            return f"has no finite prediction for each of the {len(test)} test frames of {place[0]}, seed {place[1]}"
        found = evaluate_predictions(test.force_n, predicted, test.force_range_n)
        known = {"method": name, "mae_n": found.mae_n, "r2": found.r2}
        rows.append(dict(start) | dict(zip(_PLACE, place, strict=True)) | known)
    return with_errors(pd.DataFrame(rows))


def tables(folder: Path) -> list[ResultTable]:
    """Return for each set of contacts the entries that were trained here, and those that were handed in."""
    runs, own = entries(folder), load_upper_bounds(folder)
    starts = runs[runs["method"] == PLAIN]
    given = list(handed_in(folder / HANDED_IN, Study.at(folder), starts))
    outside = {method.partition(" / ")[0] for method in runs["method"]} - set(board.METHODS)
    if starts.empty or not (given or outside):
        return []
    found = []
    for data in board.BY_ROLE:
        plain = starts[starts["data"] == data]
        upper_bounds = own if data == board.DATA else own.iloc[:0]  # frames of shifted labels are others
        of_data = runs[runs["data"] == data]
        number = of_data["method"].map(of_data["method"].value_counts())
        whole = of_data[number == len(plain)]
        unfinished = sorted(set(of_data["method"]) - set(whole["method"]))
        if len(plain):
            found.append(_verified(data, whole, upper_bounds, unfinished))
        if sent := [(name, judged) for of, name, judged in given if of == data]:
            found.append(_unverified(data, sent, with_rules(plain), upper_bounds))
    return found


def _verified(
    data: str, runs: pd.DataFrame, upper_bounds: pd.DataFrame, unfinished: list[str]
) -> ResultTable:
    frame = _by_gap(summary(with_rules(runs), upper_bounds))
    frame["when"] = runs.groupby("method")["when"].first()
    known = [*RULES, *board.METHODS]
    named = {name: f"**{name}**" for name in frame.index if name.partition(" / ")[0] not in known}
    left_out = f" Not all runs are finished of {', '.join(unfinished)}." if unfinished else ""
    return ResultTable.of(
        f"Leaderboard, {data} contacts: trained here",
        frame.rename(index=named),
        f"{len(GROUPS)} groups, seeds {', '.join(map(str, SEEDS))}, split by contact point. Ranks that two equal runs "
        f"could exchange are a range. Bold: a method from outside.{left_out}",
        SUMMARY_FORMATS,
    )


def _unverified(
    data: str,
    sent: list[tuple[str, pd.DataFrame | str]],
    starts: pd.DataFrame,
    upper_bounds: pd.DataFrame,
) -> ResultTable:
    judged = [runs for _, runs in sent if isinstance(runs, pd.DataFrame)]
    frame = pd.DataFrame(index=pd.Index([], name="method"))
    if judged:
        frame = summary(pd.concat([starts, *judged]), upper_bounds)
        frame = _by_gap(frame.drop(index=[*starts["method"].unique()]))
        frame = frame.drop(columns=[name for name in frame if name.startswith("rank")])
    refused = "".join(f" {name} {reason}." for name, reason in sent if isinstance(reason, str))
    return ResultTable.of(
        f"Leaderboard, {data} contacts: handed in, not verified",
        frame,
        f"Errors of predictions that were sent; how they were made was not seen, so that they have no rank.{refused}",
        SUMMARY_FORMATS,
    )


def _by_gap(frame: pd.DataFrame) -> pd.DataFrame:
    by = "closed" if "closed" in frame else "mean, N"
    return frame.sort_values(by, kind="stable", ascending=by == "mean, N")


PART = Part(measure, tables, chosen=("methods", "inputs"))
