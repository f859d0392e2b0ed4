"""What every study is made of: settings → hash → record, tables of records, a bootstrap and a stopwatch.

A study is a grid of settings (plain dicts), a function that measures one of them, and tables that are queries on the
records: `run_missing` measures what has no record yet and returns all as a DataFrame; `print_tables` is the command
line that makes the tables of docs/results again.
"""

import argparse
import contextlib
import dataclasses
import io
import itertools
import json
import logging
import math
import os
import statistics
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gelgap.adapt.result_table import ResultTable
from gelgap.assets.array_file import read_arrays
from gelgap.assets.checksums import canonical_json, parse_json, sha256, with_checksum, without_checksum
from gelgap.assets.whole_file import write_whole
from gelgap.assets.workers import Workers

if TYPE_CHECKING:
    import pandas as pd

LOG = logging.getLogger(__name__)
Setting = dict[str, Any]
"""One cell of a study's grid, by name: what JSON can hold."""
Results = dict[str, Any]
"""What was measured, by names that no setting has: what JSON can hold, and arrays."""
RESAMPLES = 4000
"""How many draws a bootstrap takes."""
_JOB = "job"
_ARRAYS = "arrays"


def run_missing(
    function: Callable[[Setting], Results],
    settings: Iterable[Setting],
    file: Path,
    *,
    workers: int | None = None,
    tasks_per_worker: int | None = None,
    fixed: Callable[[Setting], Results] = lambda setting: {},
    describe: Callable[[Results], str] = lambda record: "",
    stop: float = math.inf,
) -> "pd.DataFrame":
    """Measure the settings that have no record in a file, in their order; return the records of all that are finished.

    A record is a line of JSON with its checksum, written as soon as its setting is measured; arrays lie in a folder
    beside the file, and the record names their digest. A line that a kill cut off is left out, a damaged one is named,
    and what it held is measured again. The table is that of `read_records`.

    Parameters
    ----------
    function
        Measures one setting. For worker processes it is a function of a module, or `functools.partial` of one.
    workers
        Processes of one thread each; by default one per core. One means this process.
    tasks_per_worker
        After how many settings a fresh process takes the place of a worker, even of a single one; None: never.
    fixed
        What a record of a setting states besides its results, such as a hash of the data.
    describe
        What the line that is printed for each new record says of it.
    stop
        No setting is begun after this time of `time.time`.

    Raises
    ------
    ValueError
        If a record of one of the settings states something else than `fixed`.
    RuntimeError
        If a worker process dies.
    """
    wanted = {key_of(setting): _through_json(setting) for setting in settings}
    stated = {key: _through_json(fixed(setting)) for key, setting in wanted.items()}
    found = _read(file)
    for key in [key for key in wanted if key in found]:
        if other := [name for name, value in stated[key].items() if found[key].get(name) != value]:
            raise ValueError(
                f"{file}: the record of {_in_words(wanted[key])} is of another {' and '.join(other)} than the same run "
                "has now; move the file away, or choose another --out"
            )
    todo = {key: setting for key, setting in wanted.items() if key not in found}
    count = len(todo)
    started = time.perf_counter()
    measure = partial(_measured, function, file.with_suffix(""))
    if workers == 1 and tasks_per_worker is None:
        done = ((key, measure(key, todo[key])) for key in todo if time.time() < stop)
    else:
        done = _on_workers(measure, todo, workers or len(os.sched_getaffinity(0)), tasks_per_worker, stop)
    with contextlib.closing(done):
        for number, (key, results) in enumerate(done, 1):
            record = {_JOB: wanted[key], **stated[key], **results}
            _append(file, record)
            said = f"{_in_words(wanted[key])}: {describe(record)}".removesuffix(": ")
            print(f"{number}/{count}  {said}  ({time.perf_counter() - started:.0f} s)", flush=True)
    found = _read(file)
    return _frame({key: found[key] for key in wanted if key in found})


def read_records(file: Path) -> "pd.DataFrame":
    """Return a file's records in its order, by the hash of their settings; an empty table if there is no file.

    Columns are settings and results by name; an entry of a dict is a column `name.entry`, and a list is a tuple.
    """
    return _frame(_read(file))


def key_of(setting: Setting) -> str:
    """Return the name of a setting: a hash of its canonical JSON, in which a tuple is a list."""
    return sha256(canonical_json(_through_json(setting)))[:16]


def _measured(
    function: Callable[[Setting], Results], folder: Path, key: str, setting: Setting
) -> dict[str, Any]:
    """Return the results of a setting for its record; arrays are written by the process that found them."""
    results = function(setting)
    arrays = {name: value for name, value in results.items() if isinstance(value, np.ndarray)}
    plain = _through_json({name: value for name, value in results.items() if name not in arrays})
    if arrays:
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)
        write_whole(folder / f"{key}.npz", buffer.getvalue())
        plain[_ARRAYS] = sha256(buffer.getvalue())
    return plain


def _on_workers(
    measure: Callable[[str, Setting], dict[str, Any]],
    todo: dict[str, Setting],
    workers: int,
    tasks_per_worker: int | None,
    stop: float,
) -> Generator[tuple[str, dict[str, Any]], None, None]:
    """Yield results as worker processes find them."""
    waiting = iter(todo.items())
    running: dict[Future[dict[str, Any]], str] = {}
    try:
        with Workers(workers, tasks_per_worker) as pool:
            while True:
                free = workers - len(running) if time.time() < stop else 0
                for key, setting in itertools.islice(waiting, free):
                    running[pool.submit(measure, key, setting)] = key
                if not running:
                    return
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    yield running.pop(future), future.result()
    except BrokenProcessPool as error:
        raise RuntimeError(
            "a worker process died, perhaps for want of memory: start fewer; finished measurements are kept, run "
            "the same command again to go on"
        ) from error


def _append(file: Path, record: dict[str, Any]) -> None:
    """Add a record as one line with its checksum; a line that a kill left unfinished is ended first."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a+b") as lines:
        if lines.tell():
            lines.seek(-1, os.SEEK_END)
            if lines.read(1) != b"\n":
                lines.write(b"\n")
        lines.write((json.dumps(with_checksum(record), ensure_ascii=False) + "\n").encode())


def _read(file: Path) -> dict[str, dict[str, Any]]:
    """Return the intact records of a file by the hash of their settings; of two of one setting the last."""
    lines = file.read_bytes().split(b"\n") if file.is_file() else []
    records = {}
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            record = without_checksum(parse_json(line))
            if not isinstance(record.get(_JOB), dict):
                raise ValueError("it names no settings")
        except ValueError as error:
            if number < len(lines):  # the last one has no end if a kill cut it off
                reason = " ".join(str(error).split())[:120]
                LOG.warning("%s, line %d, is damaged (%s): left out, measured again", file, number, reason)
            continue
        records[key_of(record[_JOB])] = record
    arrays = {key: _read_arrays(file, key, record.pop(_ARRAYS, None)) for key, record in records.items()}
    return {key: record | arrays[key] for key, record in records.items() if arrays[key] is not None}


def _read_arrays(file: Path, key: str, digest: str | None) -> dict[str, np.ndarray] | None:
    """Return a record's arrays; None if they are gone or are others: the setting is measured again."""
    if digest is None:
        return {}
    path = file.with_suffix("") / f"{key}.npz"
    try:
        content = path.read_bytes()
        return read_arrays(content) if sha256(content) == digest else None
    except (FileNotFoundError, ValueError):
        return None


def _frame(records: dict[str, dict[str, Any]]) -> "pd.DataFrame":
    import pandas as pd

    rows = []
    for record in records.values():
        row: dict[str, Any] = {}
        for name, value in [*record[_JOB].items(), *record.items()]:
            if isinstance(value, dict):
                row |= {f"{name}.{entry}": _hashable(own) for entry, own in value.items() if name != _JOB}
            else:
                row[name] = _hashable(value)
        rows.append(row)
    return pd.DataFrame(rows, index=pd.Index(list(records), name="key"))


def _hashable(value: Any) -> Any:
    return tuple(map(_hashable, value)) if isinstance(value, list) else value


def _in_words(setting: Setting) -> str:
    """Return a setting as a line of text: names speak for themselves, other values stand behind theirs."""
    there = {name: value for name, value in setting.items() if value not in ([], {}, None)}
    return "  ".join(v if isinstance(v, str) else f"{name} = {v}" for name, v in there.items())


def _through_json(value: Any) -> Any:
    return json.loads(json.dumps(value, default=_plain))


def _plain(value: Any) -> Any:
    """Return what JSON can hold in place of an array, a table, a NumPy number or a dataclass: `json.dumps`' default."""
    if hasattr(value, "to_dict"):
        return value.to_dict("records")
    if dataclasses.is_dataclass(value):
        return dataclasses.asdict(value)
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)


def write_records(file: Path, frame: "pd.DataFrame", settings: Sequence[str]) -> None:
    """Write a table in place of a file of records, a line a row; `settings` names the columns by which rows differ."""
    lines = []
    for row in frame.to_dict("records"):
        known = {
            name: value for name, value in row.items() if not (isinstance(value, float) and math.isnan(value))
        }
        job = {name: known.pop(name) for name in settings if name in known}
        record = with_checksum(_through_json({_JOB: job, **known}))
        lines.append(json.dumps(record, ensure_ascii=False) + "\n")
    write_whole(file, "".join(lines).encode())


def drawn_means(values: np.ndarray, clusters: Sequence[object] | None = None) -> np.ndarray:
    """Return bootstrap means (RESAMPLES, …) of values (…, cases, seeds), NaN: no run; the same in every call.

    A mean is that over cases of the means over seeds. Cases and seeds are drawn with replacement, independently of each
    other: a seed gives all cases their split and their initial weights, so that its runs are drawn together. So are
    cases of one cluster, if there are clusters.
    """
    cases, seeds = values.shape[-2:]
    clusters = list(range(cases) if clusters is None else clusters)
    known = list(dict.fromkeys(clusters))
    rng = np.random.default_rng(0)
    of_clusters, of_seeds = _times_drawn(rng, len(known)), _times_drawn(rng, seeds)
    of_cases = of_clusters[:, [known.index(cluster) for cluster in clusters]]
    there = ~np.isnan(values)
    with np.errstate(invalid="ignore"):
        of_case = np.einsum("rs,...cs->r...c", of_seeds, np.where(there, values, 0.0))
        of_case /= np.einsum("rs,...cs->r...c", of_seeds, there)
        there = ~np.isnan(of_case)
        total = np.einsum("rc,r...c->r...", of_cases, np.where(there, of_case, 0.0))
        return total / np.einsum("rc,r...c->r...", of_cases, there)


def _times_drawn(rng: np.random.Generator, number: int) -> np.ndarray:
    """Return how often each of `number` things is in each draw with replacement (RESAMPLES, number)."""
    drawn = rng.integers(number, size=(RESAMPLES, number))
    return np.stack([np.bincount(row, minlength=number) for row in drawn])


def interval(draws: np.ndarray) -> tuple[float, float]:
    """Return the 95 % percentile interval of draws (RESAMPLES,), NaN left out; NaN if all are."""
    if np.isnan(draws).all():
        return math.nan, math.nan
    low, high = np.nanpercentile(draws, [2.5, 97.5])
    return float(low), float(high)


def processor_s(
    work: Callable[[], object], repeats: int = 0, clock: Callable[[], float] = time.process_time
) -> float:
    """Return the time of some work by a clock; with `repeats` their median, after one run to warm up."""
    times = []
    for _ in range(repeats + 1):
        start = clock()
        work()
        times.append(clock() - start)
    return statistics.median(times[1:] or times)


def rms(values: Any) -> float:
    """Return the root mean square of an array, or of what makes one."""
    return float(np.sqrt(np.square(values).mean()))


def print_tables(description: str | None, tables: "Callable[[pd.DataFrame], list[ResultTable]]") -> None:
    """Print the tables of the file of records that the command line names by `--table`, in Markdown."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--table", type=Path, required=True, metavar="FILE", help="a file of records")
    file = parser.parse_args().table
    if not file.is_file():
        parser.error(f"--table {file}: no such file")
    print("\n".join(table.markdown() for table in tables(read_records(file))))
