"""The leaderboard: entries that are trained here, with their controls, and apart from them predictions handed in.

    python -m gelgap.benchmarks.adaptation.leaderboard --methods mine.py:Mine --inputs calibrated

The places are fixed: two gaps of light, two seeds, contacts that are alike on both sides and contacts that are not.
An entry is a method on one of the inputs, or on one of the sources in random lights. What others have predicted is
judged by the same labels, but nobody saw how it was made (noise on the labels would come first), so that it has no
rank.

With `--table FILE` it prints the tables of a file of records in Markdown, and measures nothing.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.adapt.evaluation import evaluate_predictions
from gelgap.adapt.result_table import ResultTable
from gelgap.assets.names import is_plain_name
from gelgap.benchmarks.adaptation import protocol
from gelgap.benchmarks.adaptation.inputs import input_grid
from gelgap.benchmarks.adaptation.protocol import DRAWN_LIGHTS, PLAIN
from gelgap.benchmarks.adaptation.study import (
    RUNS,
    Study,
    load_runs,
    run_script,
    upper_bounds_of,
    with_errors,
)
from gelgap.benchmarks.adaptation.tables import (
    R2,
    RULES,
    SUMMARY_FORMATS,
    check_one_configuration,
    summary,
    upper_bounds,
    with_rules,
)
from gelgap.benchmarks.common import Setting, read_records

GROUPS: tuple[protocol.Group, ...] = (("wmb0i0", "wmb0i1"), ("wmb0i0", "wmb0i2"))
SEEDS = (0, 1)
HANDED_IN = "handed-in"
"""The folder, below the runs, of records that others have sent: `NAME.jsonl` and the arrays in `NAME`."""
LEFT_OUT = ["interval", "closed Fz", "closed shear", "no shear, N", *R2, "rank Fz", "rank shear"]
"""Columns of a summary that the leaderboard does not show."""
_PLACE = ["target", "seed"]


def entry_grid(methods: tuple[str, ...], inputs: tuple[str, ...]) -> list[Setting]:
    """Return the runs of methods on inputs or in random lights.

    Raises
    ------
    ValueError
        If an input shows markers, which the leaderboard's gaps have not.
    """
    if "markers" in inputs:
        raise ValueError("--inputs markers: the leaderboard's sensors have no markers")
    runs: list[Setting] = []
    for name in inputs:
        for data in protocol.BY_ROLE:
            runs += input_grid(GROUPS, methods, SEEDS, [name], data)
    return runs


def measure(study: Study) -> None:
    """Train what is missing: the methods named with their controls, the baselines on pictures, and upper bounds.

    What was handed in is judged and shown.
    """
    wanted = entry_grid(study.known_methods(), study.inputs or ("pictures",))
    starts = entry_grid((PLAIN, "adabn"), ("pictures",))
    study.generate_for([*starts, *wanted])
    study.run([*upper_bounds_of(starts), *starts, *wanted])
    for table in handed_in_tables(study):
        table.show()


def entries(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the runs on the leaderboard's places; a method on another input than pictures is `method / input`.

    Raises
    ------
    ValueError
        If the runs of a place on one input are not all of one configuration.
    """
    source_of = {target: source for source, target in GROUPS}
    runs = runs[runs["seed"].isin(SEEDS) & runs["data"].isin(protocol.BY_ROLE) & runs["shown"].notna()]
    runs = runs[runs["target"].isin(source_of) & (runs["settings"].map(len) == 0)]
    own_source = runs["target"].map(source_of)
    runs = runs[(runs["source"] == own_source) | runs["shown"].isin(DRAWN_LIGHTS)]
    for place, own in runs.groupby(["source", "target", "data", "shown"]):
        check_one_configuration(own, f"the runs of {' '.join(place)}")
    named = runs["method"].where(runs["shown"] == "pictures", runs["method"] + " / " + runs["shown"])
    return with_errors(runs.assign(method=named, source=runs["target"].map(source_of)))


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
            yield protocol.DATA, file.stem, "holds no predictions of a method for places of the leaderboard"
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
    for start in places.reset_index().to_dict("records"):
        place = start["target"], start["seed"]
        test = study.frames_of(start).target_test
        predicted = np.asarray(own.loc[place, "predicted_n"])
        if predicted.shape != test.force_n.shape or not np.isfinite(predicted).all():
            return f"has no finite prediction for each of the {len(test)} test frames of {place[0]}, seed {place[1]}"
        found = evaluate_predictions(test.force_n, predicted, test.force_range_n)
        known = {"method": name, "mae_n": found.mae_n, "r2": found.r2}
        rows.append(start | known)
    return with_errors(pd.DataFrame(rows))


def tables(runs: pd.DataFrame) -> list[ResultTable]:
    """Return the entries that were trained here, for each set of contacts."""
    own, bounds, found = entries(runs), upper_bounds(runs), []
    for data in protocol.BY_ROLE:
        on_data = own[own["data"] == data]
        places = (on_data["method"] == PLAIN).sum()
        if not places:
            continue
        number = on_data["method"].map(on_data["method"].value_counts())
        whole = on_data[number == places]
        unfinished = sorted(set(on_data["method"]) - set(whole["method"]))
        found.append(_verified(data, whole, _bounds_of(data, bounds), unfinished))
    return found


def handed_in_tables(study: Study) -> list[ResultTable]:
    """Return the errors of what was handed in, for each set of contacts."""
    runs = load_runs(study.out / RUNS)
    own, bounds = entries(runs), upper_bounds(runs)
    starts = own[own["method"] == PLAIN]
    given = list(handed_in(study.out / HANDED_IN, study, starts))
    found = []
    for data in protocol.BY_ROLE:
        if sent := [(name, judged) for of, name, judged in given if of == data]:
            plain = with_rules(starts[starts["data"] == data])
            found.append(_unverified(data, sent, plain, _bounds_of(data, bounds)))
    return found


def _bounds_of(data: str, bounds: pd.DataFrame) -> pd.DataFrame:
    """Return upper bounds if they are of the same frames: those of shifted labels are others."""
    return bounds if data == protocol.DATA else bounds.iloc[:0]


def _verified(data: str, runs: pd.DataFrame, bounds: pd.DataFrame, unfinished: list[str]) -> ResultTable:
    frame = _by_gap(summary(with_rules(runs), bounds)).drop(columns=LEFT_OUT, errors="ignore")
    known = [*RULES, *protocol.METHODS]
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
    bounds: pd.DataFrame,
) -> ResultTable:
    judged = [runs for _, runs in sent if isinstance(runs, pd.DataFrame)]
    frame = pd.DataFrame(index=pd.Index([], name="method"))
    if judged:
        frame = summary(pd.concat([starts, *judged]), bounds)
        frame = _by_gap(frame.drop(index=[*starts["method"].unique()]))
        frame = frame.drop(columns=[*LEFT_OUT, "rank mean"], errors="ignore")
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


if __name__ == "__main__":
    run_script("leaderboard", __doc__, measure, tables, ("methods", "inputs"))
