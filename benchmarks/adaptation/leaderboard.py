"""The leaderboard: results of anyone's methods, whose errors are computed anew from the predictions of their runs.

A record is a file of the benchmark's runs with the arrays beside it, named after who did them: `Ada.jsonl` and the
folder `Ada`. The command opens the board's data, compares configuration and labels, computes every error from the
predictions, and ranks what agrees. Pictures need not be the same to the byte, which another processor's are not: the
table says so.
"""

import argparse
import shutil
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.adapt import ResultTable, evaluate_predictions
from gelgap.adapt.evaluation import evaluate_baselines, evaluate_constant_mean
from gelgap.assets.names import is_plain_name
from gelgap.assets.whole_file import write_whole
from gelgap.benchmarks.adaptation import board
from gelgap.benchmarks.adaptation.board import PLAIN
from gelgap.benchmarks.adaptation.groups import RULES, SUMMARY_FORMATS, summary, with_rules
from gelgap.benchmarks.adaptation.study import BOARD, RUNS, Study, grid, with_errors
from gelgap.benchmarks.common import read_records

OWN = "trained-on-target"
"""The name of the upper bounds among the methods."""
_BAD_INPUT = 2
_PLACE = ["source", "target", "seed"]
_SETTING = "settings."
_AGREE_N = 1e-3


def write_record(study: Study, folder: Path, who: str) -> None:
    """Copy the runs of a study and their arrays to a folder of records.

    Raises
    ------
    ValueError
        If `who` is no name of a file, or there are no runs.
    """
    runs = study.out / RUNS
    if not is_plain_name(who):
        raise ValueError(f"--who {who!r} is no name of a file")
    if not runs.is_file():
        raise ValueError(f"{study.out} holds no runs of the adaptation benchmark ({RUNS})")
    folder.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(folder / who, ignore_errors=True)
    shutil.copytree(runs.with_suffix(""), folder / who)
    shutil.copy(runs, folder / f"{who}.jsonl")


def headline_runs(file: Path) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """Yield the compared runs of a record: data set, method and runs, those of the upper bounds as method `OWN`."""
    runs = read_records(file)
    if not {*_PLACE, "method", "data", "changes"} <= set(runs):
        return
    groups = {*board.GROUPS, *board.LIGHT_GROUPS}
    groups |= {(target, target) for _, target in groups}
    places = pd.Series(list(zip(runs["source"], runs["target"], strict=True)), runs.index, dtype=object)
    runs = runs[
        places.isin(groups) & runs["data"].isin(board.BY_ROLE) & runs["changes"].isin([board.BY_POINT])
    ]
    methods = runs["method"].where(runs["source"] != runs["target"], OWN)
    for (data, method), own in runs.assign(method=methods).groupby(["data", "method"], sort=False):
        yield data, method, own


def checked(runs: pd.DataFrame, study: Study) -> pd.DataFrame:
    """Return runs of one method and data set with errors computed from their predictions and the data's labels.

    Raises
    ------
    ValueError
        If they were made of other data or another profile, or state errors that their predictions do not have; the
        message says which.
    KeyError, TypeError, FileNotFoundError
        If they lack something, or the board's data do.
    """
    if runs.duplicated(_PLACE).any():
        raise ValueError("has a run twice")
    rows = []
    for run in runs.to_dict("records"):
        where = f"{run['source']} → {run['target']}, seed {run['seed']}"
        if not is_plain_name(run["method"]):
            raise ValueError(f"method = {run['method']!r} is no name")
        if run["profile"] != study.profile:
            raise ValueError(f"is of profile {run['profile']}, the board's is {study.profile}")
        (setting,) = grid([(run["data"], (run["source"], run["target"]))], [PLAIN], [run["seed"]])
        expected, frames = study.stated_of(setting)["configuration"], study.frames_of(setting)
        if run["configuration"] != expected:
            raise ValueError(
                f"{where}, is of configuration {run['configuration']}, the board's is {expected}"
            )
        predicted, test = np.asarray(run["predicted_n"]), frames.target_test
        constant = evaluate_constant_mean(frames.source_train, test)
        if not np.allclose(run["constant_mean_n"], constant.mae_n, rtol=0, atol=_AGREE_N):
            raise ValueError(
                f"{where}: its frames are others: the source's mean force has a mean MAE of "
                f"{np.mean(run['constant_mean_n']):.4f} N on them, on the board's {constant.mean_mae_n:.4f} N"
            )
        same = all(run[f"frames_sha256.{name}"] == part.digest for name, part in frames.parts.items())
        if predicted.shape != test.force_n.shape or not np.isfinite(predicted).all():
            raise ValueError(f"{where}: it has no finite prediction for each of the {len(test)} test frames")
        found = evaluate_predictions(test.force_n, predicted, test.force_range_n)
        if not np.allclose(run["mae_n"], found.mae_n, rtol=0, atol=_AGREE_N):
            raise ValueError(
                f"{where}: it states a mean MAE of {np.mean(run['mae_n']):.4f} N, its predictions have "
                f"{found.mean_mae_n:.4f} N"
            )
        own = {name.removeprefix(_SETTING): run[name] for name in run if name.startswith(_SETTING)}
        own = ", ".join(f"{name} = {value}" for name, value in own.items() if pd.notna(value))
        computed = {"mae_n": found.mae_n, "r2": found.r2, "constant_mean_n": constant.mae_n}
        if run["method"] in (PLAIN, "adabn"):  # whose rows have the rules that stand beside all methods
            for rule, error in evaluate_baselines(frames).items():
                computed |= {f"baselines_mae_n.{rule}": error.mae_n, f"baselines_r2.{rule}": error.r2}
        shown = {"same_frames": same, "own_settings": own or None, "when": run.get("when")}
        rows.append(run | computed | shown)
    return with_errors(pd.DataFrame(rows))


def ranked(folder: Path, study: Study) -> tuple[list[ResultTable], dict[str, str]]:
    """Return the tables of all records that hold, and of the others why they do not, by file and method."""
    found: dict[tuple[str, str], pd.DataFrame] = {}
    refused: dict[str, str] = {}
    for file in sorted(folder.glob("*.jsonl")):
        compared = list(headline_runs(file))
        if not compared:
            refused[file.name] = "holds no run of the groups that are compared"
        for data, method, runs in compared:
            name = f"{file.name}: {method} on {data} contacts"
            try:
                own = checked(runs, study).assign(name=name, who=file.stem)
            except KeyError as error:
                refused[name] = f"lacks {error}"
                continue
            except (TypeError, ValueError, FileNotFoundError) as error:
                refused[name] = " ".join(str(error).split())[:200]
                continue
            # A guest may run source-only for some places alone: the fullest record counts.
            other = found.get((data, method))
            if other is None or len(own) > len(other):
                own, found[data, method] = other, own
            if own is not None:
                refused[own["name"].iloc[0]] = "another record of it has more runs, or was read first"
    upper_bounds = found.pop((board.DATA, OWN), pd.DataFrame())
    own = upper_bounds.set_index(["target", "seed"]).sort_index() if len(upper_bounds) else upper_bounds
    tables = []
    for data in board.BY_ROLE:
        upper_bound = own if data == board.DATA else own.iloc[:0]  # frames of shifted labels are others
        plain = found.get((data, PLAIN))
        if plain is not None and _problem(plain, plain, upper_bound):
            plain = None
        kept = []
        for runs in (runs for (of, _), runs in found.items() if of == data):
            if problem := _problem(runs, plain, upper_bound):
                refused[runs["name"].iloc[0]] = problem
            else:
                kept.append(runs)
        if kept:
            tables.append(leaderboard_table(pd.concat(kept), data, upper_bound))
    return tables, refused


def _problem(runs: pd.DataFrame, plain: pd.DataFrame | None, upper_bounds: pd.DataFrame) -> str | None:
    """Return why runs cannot stand beside source-only's, if they cannot."""
    if plain is None:
        return f"there is no record of {PLAIN} that holds, to compare with"
    places, wanted = (set(map(tuple, one[_PLACE].to_numpy())) for one in (runs, plain))
    if places != wanted:
        return f"{len(wanted - places)} runs of the board are missing, {len(places - wanted)} are none of it"
    if upper_bounds.empty:
        return None
    least = upper_bounds["error_n"].reindex(list(zip(runs["target"], runs["seed"], strict=True))).mean()
    if runs["error_n"].mean() < least:
        return (
            f"its error of {runs['error_n'].mean():.4f} N is below {least:.4f} N, the upper bound's: what training on "
            "the target's own labels gives"
        )
    return None


def leaderboard_table(runs: pd.DataFrame, data: str, upper_bounds: pd.DataFrame) -> ResultTable:
    """All methods of a data set by the gap closed, or without upper bounds by their mean error."""
    frame = summary(with_rules(runs), upper_bounds)
    by = "closed" if "closed" in frame else "mean, N"
    frame = frame.sort_values(by, kind="stable", ascending=by == "mean, N")
    of_method = runs.groupby("method")
    for column, values in {"settings": "own_settings", "who": "who", "when": "when"}.items():
        frame[column] = of_method[values].first()
    starts = runs[runs["method"] == PLAIN].set_index(_PLACE)["stage1_sha256"]
    same = runs["stage1_sha256"].to_numpy() == starts[pd.MultiIndex.from_frame(runs[_PLACE])].to_numpy()
    frame["same stage 1"] = pd.Series(same, runs.index).groupby(runs["method"]).all()
    frame["same frames"] = of_method["same_frames"].all()
    named = {method: f"**{method}**" for method in frame.index if method not in (*board.METHODS, *RULES)}
    groups, seeds = runs[["source", "target"]].drop_duplicates(), runs["seed"].nunique()
    return ResultTable.of(
        f"{data.capitalize()} contacts",
        frame.rename(index=named),
        f"{len(groups)} groups, {seeds} seed(s), split by contact point. Errors are computed from each record's "
        "predictions. Same stage 1: stage 2 began with source-only's weights. Same frames: to the byte; those "
        "of another processor have the same labels, and pictures that differ in the last bit.",
        SUMMARY_FORMATS,
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Check the records of a folder by the board's data and write the leaderboard of those that hold.

    With --write, first copy the finished runs of a folder there.
    """
    name = "python -m gelgap.benchmarks.adaptation.leaderboard"
    parser = argparse.ArgumentParser(prog=name, description=main.__doc__)
    parser.add_argument("records", type=Path, help="folder of the records, a file for each who ran some")
    runs = Path("benchmark-results/adaptation") / BOARD
    parser.add_argument(
        "--runs", type=Path, default=runs, help="folder of runs; the board's data lie beside it"
    )
    parser.add_argument("--write", action="store_true", help="first copy the runs to the records")
    parser.add_argument("--who", default="gelgap", help="who ran them")
    parser.add_argument("--out", type=Path, default=Path("docs/results/leaderboard.md"))
    chosen = parser.parse_args(arguments)
    study = Study.at(chosen.runs)
    if chosen.write:
        try:
            write_record(study, chosen.records, chosen.who)
        except ValueError as error:
            parser.exit(_BAD_INPUT, f"{error}\n")
    tables, refused = ranked(chosen.records, study)
    for record, reason in refused.items():
        print(f"not ranked: {record} {reason}", file=sys.stderr)
    if not tables:
        parser.exit(_BAD_INPUT, f"{chosen.records} holds no record that can be ranked\n")
    lines = [f"- {record} {reason}" for record, reason in refused.items()]
    parts = ["# Leaderboard\n", *(table.markdown() for table in tables)]
    parts += ["## Not ranked\n", "\n".join(lines) + "\n"] if lines else []
    write_whole(chosen.out, "\n".join(parts).encode())
    print(f"wrote {chosen.out}")


if __name__ == "__main__":
    main()
