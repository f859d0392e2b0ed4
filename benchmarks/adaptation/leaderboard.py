"""The leaderboard: results of anyone's methods, from records that carry their predictions and are computed anew.

A record is an .npz file: `record`, the JSON of a `Record` as bytes, and `predicted_n_K` (n, 3) float32 for run K, the
force on each of the target's test frames. The command opens the board's data, compares their hashes and configuration,
computes every error from the predictions, and ranks what agrees. The former records (JSON, format 1) have errors alone,
and are not ranked.
"""

import argparse
import datetime
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from gelgap.adapt import ResultTable, evaluate_constant_mean, evaluate_predictions
from gelgap.adapt.methods import registry
from gelgap.assets.array_file import read_arrays
from gelgap.assets.names import is_plain_name
from gelgap.assets.settings import Settings
from gelgap.assets.whole_file import whole_file, write_whole
from gelgap.benchmarks.adaptation import board, designs
from gelgap.benchmarks.adaptation.board import PLAIN
from gelgap.benchmarks.adaptation.groups import SUMMARY_FORMATS, load_ceilings, load_headline, summary
from gelgap.benchmarks.adaptation.study import BOARD, Study, grid, with_errors
from gelgap.benchmarks.common import result_table

OWN = "trained-on-target"
"""The name of the ceilings' record."""
_BAD_INPUT = 2
_PLACE = ["source", "target", "seed"]
_AGREE_N = 1e-3
_Error = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class RankedRun(Settings):
    """One run of a record: its group and seed, on which bytes it was done, and the errors that it states."""

    source: str
    target: str
    seed: int = Field(ge=0)
    configuration: str = Field(description="hash of what methods share: profile and both domains' recipes")
    frames_sha256: dict[str, str] = Field(description="hash of each part of the split, pictures and labels")
    stage1_sha256: str | None = Field(description="hash of the weights that stage 2 began with")
    mae_n: tuple[_Error, _Error, _Error]


class Record(Settings):
    """What a record states beside its predictions."""

    format: Literal[2] = 2
    method: str
    data: Literal["disjoint", "label-shift"]
    profile: str
    settings: dict[str, Any] = Field(description="the method's own settings that differ from its defaults")
    code_sha256: str | None = Field(description="hash of the file of a method that is not gelgap's")
    who: str = Field(description="who ran it")
    when: datetime.date
    versions: str
    runs: tuple[RankedRun, ...] = Field(min_length=1)


class Refused(ValueError):
    """Why a record is not ranked."""


def write_records(study: Study, folder: Path, who: str) -> list[Path]:
    """Write a record of each method whose runs are finished where source-only's are, and one of the ceilings."""
    written = []
    for data in board.BY_ROLE:
        runs = load_headline(study.out, data)
        if runs.empty:
            continue
        ceilings = (
            load_ceilings(study.out).reset_index().assign(method=OWN) if data == designs.DATA else runs[:0]
        )
        runs = pd.concat([runs, ceilings])
        places = {method: set(map(tuple, own[_PLACE].to_numpy())) for method, own in runs.groupby("method")}
        for method in (name for name in places if name == OWN or places[name] >= places.get(PLAIN, {()})):
            own = runs[runs["method"] == method].sort_values(_PLACE)
            first = own.iloc[0]
            settings = first.filter(like="settings.").dropna().rename(lambda name: name.partition(".")[2])
            rows = own.filter(regex=r"^frames_sha256\.").rename(columns=lambda name: name.partition(".")[2])
            record = Record(
                **first[["method", "profile", "versions"]],
                data=data,
                settings=settings.to_dict(),
                code_sha256=None if method == OWN else registry.method_code(method),
                who=who,
                when=datetime.datetime.now(tz=datetime.UTC).date(),
                runs=[
                    one | {"frames_sha256": parts}
                    for one, parts in zip(
                        own[[*_PLACE, "configuration", "stage1_sha256", "mae_n"]].to_dict("records"),
                        rows.to_dict("records"),
                        strict=True,
                    )
                ],
            )
            arrays = {f"predicted_n_{k}": values for k, values in enumerate(own["predicted_n"])}
            text = np.frombuffer(record.model_dump_json().encode(), np.uint8)
            written.append(folder / f"{method}-{data}.npz")
            with whole_file(written[-1]) as temporary, temporary.open("wb") as file:
                np.savez_compressed(file, record=text, **arrays)
    return written


def checked_runs(path: Path, study: Study) -> pd.DataFrame:
    """Return the runs of a record with errors computed from its predictions and the data's labels.

    Raises
    ------
    Refused
        If it is no record, or was made of other data or another profile, or states errors that its predictions do not
        have; the message says which.
    """
    try:
        arrays = read_arrays(path)
        record = Record(**json.loads(arrays["record"].tobytes()))
    except (KeyError, TypeError, ValueError) as error:
        raise Refused(f"is no record: {' '.join(str(error).split())[:200]}") from None
    if not is_plain_name(record.method):
        raise Refused(f"method = {record.method!r} is no name")
    if record.profile != study.profile:
        raise Refused(f"is of profile {record.profile}, the board's is {study.profile}")
    places = [(run.source, run.target, run.seed) for run in record.runs]
    if len(set(places)) < len(places):
        raise Refused("has a run twice")
    rows = []
    for k, run in enumerate(record.runs):
        where = f"{run.source} → {run.target}, seed {run.seed}"
        method = PLAIN if record.method == OWN else record.method
        (setting,) = grid([(record.data, (run.source, run.target))], [PLAIN], [run.seed])
        try:
            expected, frames = study.stated_of(setting)["configuration"], study.frames_of(setting)
        except (FileNotFoundError, ValueError) as error:
            raise Refused(f"{where}: {' '.join(str(error).split())[:200]}") from None
        if run.configuration != expected:
            raise Refused(f"{where}, is of configuration {run.configuration}, the board's is {expected}")
        parts = {name: part.digest for name, part in frames.parts.items()}
        if other := [name for name, digest in parts.items() if run.frames_sha256.get(name) != digest]:
            raise Refused(
                f"{where}: its {other[0].replace('_', ' ')} frames are not those of the board's data"
            )
        predicted, true = arrays.get(f"predicted_n_{k}"), frames.target_test.force_n
        if predicted is None or predicted.shape != true.shape or not np.isfinite(predicted).all():
            raise Refused(f"{where}: it has no finite prediction for each of the {len(true)} test frames")
        found = evaluate_predictions(true, predicted, frames.target_test.force_range_n)
        if np.abs(np.subtract(found.mae_n, run.mae_n)).max() > _AGREE_N:
            raise Refused(
                f"{where}: it states a mean MAE of {np.mean(run.mae_n):.4f} N, its predictions have "
                f"{found.mean_mae_n:.4f} N"
            )
        constant = evaluate_constant_mean(frames.source_train, frames.target_test)
        rows.append(
            {
                **setting,
                **{"method": method if record.method != OWN else OWN, "problem": None, "r2": found.r2},
                **{"mae_n": found.mae_n, "constant_mean_n": constant.mae_n, "control": None},
                **{"who": record.who, "when": record.when.isoformat(), "stage1": run.stage1_sha256},
                "own_settings": ", ".join(f"{k} = {v}" for k, v in record.settings.items()) or None,
            }
        )
    return with_errors(pd.DataFrame(rows))


def ranked(folder: Path, study: Study) -> tuple[list[ResultTable], dict[str, str]]:
    """Return the tables of all records that hold, and of the others why they do not, by file."""
    found: dict[tuple[str, str], pd.DataFrame] = {}
    refused = {path.name: "has no predictions (format 1): run it anew" for path in folder.glob("*.json")}
    for path in sorted(folder.glob("*.npz")):
        try:
            runs = checked_runs(path, study)
        except Refused as error:
            refused[path.name] = str(error)
            continue
        key = runs["data"].iloc[0], runs["method"].iloc[0]
        if key in found:
            refused[path.name] = f"another record of {key[1]} on {key[0]} contacts was read first"
        else:
            found[key] = runs.assign(file=path.name)
    ceilings = found.pop((designs.DATA, OWN), pd.DataFrame())
    own = ceilings.set_index(["target", "seed"]).sort_index() if len(ceilings) else ceilings
    tables = []
    for data in board.BY_ROLE:
        plain = found.get((data, PLAIN))
        kept = []
        for runs in (runs for (of, _), runs in found.items() if of == data):
            problem = _problem(runs, plain, own)
            if problem:
                refused[runs["file"].iloc[0]] = problem
            else:
                kept.append(runs)
        if kept:
            tables.append(leaderboard_table(pd.concat(kept), data, own))
    return tables, refused


def _problem(runs: pd.DataFrame, plain: pd.DataFrame | None, ceilings: pd.DataFrame) -> str | None:
    """Return why runs cannot stand beside source-only's, if they cannot."""
    if plain is None:
        return f"there is no record of {PLAIN} to compare with"
    places, wanted = (set(map(tuple, one[_PLACE].to_numpy())) for one in (runs, plain))
    if places != wanted:
        return f"{len(wanted - places)} runs of the board are missing, {len(places - wanted)} are none of it"
    if ceilings.empty:
        return None
    least = ceilings["error_n"].reindex(list(zip(runs["target"], runs["seed"], strict=True))).mean()
    if runs["error_n"].mean() < least:
        return (
            f"its error of {runs['error_n'].mean():.4f} N is below {least:.4f} N, the ceiling's: what training on the "
            "target's own labels gives"
        )
    return None


def leaderboard_table(runs: pd.DataFrame, data: str, ceilings: pd.DataFrame) -> ResultTable:
    """All methods of a data set by their share of the headroom, or without ceilings by their mean error."""
    frame = summary(runs, ceilings)
    by = "closed" if "closed" in frame else "mean, N"
    frame = frame.sort_values(by, kind="stable", ascending=by == "mean, N")
    of_method = runs.groupby("method").first()
    for name, column in {"settings": "own_settings", "who": "who", "when": "when"}.items():
        frame[name] = of_method[column]
    starts = runs[runs["method"] == PLAIN].set_index(_PLACE)["stage1"].to_dict()
    same = {
        method: all(starts[tuple(row[name] for name in _PLACE)] == row["stage1"] for _, row in own.iterrows())
        for method, own in runs.groupby("method")
    }
    frame["same stage 1"] = ["yes" if same[method] else "no" for method in frame.index]
    named = {method: f"**{method}**" for method in frame.index if method not in board.METHODS}
    groups, seeds = runs[["source", "target"]].drop_duplicates(), runs["seed"].nunique()
    return result_table(
        f"{data.capitalize()} contacts",
        frame.rename(index=named),
        f"{len(groups)} groups, {seeds} seed(s), split by contact point. Errors are computed from each record's "
        "predictions. Same stage 1: stage 2 began with the weights that source-only has.",
        SUMMARY_FORMATS,
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Check the records of a folder by the board's data and write the leaderboard of those that hold.

    With --write, first make records of the finished runs of a folder.
    """
    name = "python -m gelgap.benchmarks.adaptation.leaderboard"
    parser = argparse.ArgumentParser(prog=name, description=main.__doc__)
    parser.add_argument(
        "records", type=Path, help="folder of the records, a file for each method and data set"
    )
    parser.add_argument(
        "--runs",
        type=Path,
        default=Path("benchmark-results/adaptation") / BOARD,
        help="folder of runs; its data lie beside it",
    )
    parser.add_argument("--write", action="store_true", help="first make records of the runs")
    parser.add_argument("--who", default="gelgap", help="who ran them")
    parser.add_argument("--out", type=Path, default=Path("docs/results/leaderboard.md"))
    chosen = parser.parse_args(arguments)
    study = Study.at(chosen.runs)
    if chosen.write:
        write_records(study, chosen.records, chosen.who)
    tables, refused = ranked(chosen.records, study)
    for file, reason in refused.items():
        print(f"not ranked: {file} {reason}", file=sys.stderr)
    if not tables:
        parser.exit(_BAD_INPUT, f"{chosen.records} holds no record that can be ranked\n")
    lines = [f"- `{file}` {reason}" for file, reason in refused.items() if file.endswith(".npz")]
    parts = ["# Leaderboard\n", *(table.markdown() for table in tables)]
    parts += ["## Not ranked\n", "\n".join(lines) + "\n"] if lines else []
    write_whole(chosen.out, "\n".join(parts).encode())
    print(f"wrote {chosen.out}")


if __name__ == "__main__":
    main()
