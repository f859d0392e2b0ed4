"""Records of adaptation runs that nobody trained."""

import os
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pandas as pd

from gelgap.adapt.evaluation import BASELINES
from gelgap.adapt.methods.registry import find_method
from gelgap.adapt.result_table import ResultTable
from gelgap.benchmarks.adaptation.protocol import BY_POINT
from gelgap.benchmarks.adaptation.study import RUNS, control_of, grid, load_runs
from gelgap.benchmarks.adaptation.tables import of_data
from gelgap.benchmarks.common import key_of, run_missing

Record = tuple[dict[str, Any], dict[str, Any]]
"""Setting and results."""


def record(
    group: tuple[str, str],
    method: str,
    error_n: float,
    seed: int = 0,
    data: str = "paired",
    changes=BY_POINT,
    **results,
) -> Record:
    """Return a run whose error is the same on each axis."""
    (run,) = grid([(data, group)], [method], [seed], changes)
    found = {
        "profile": "cpu",
        "configuration": "c",
        "versions": "gelgap 1",
        "settings": {},
        "problem": None,
        "control": control_of(method) if "." not in method else None,
        "mae_n": (error_n,) * 3,
        "r2": (0.85, 0.85, 0.95),
        "constant_mean_n": (0.4,) * 3,
        "source_held_out_r2": (0.9, 0.7, 0.95),
        "stage1_s": 60.0,
        "stage2_s": 30.0,
        "baselines_mae_n": dict.fromkeys(BASELINES, (0.4,) * 3),
        "baselines_r2": dict.fromkeys(BASELINES, (0.0,) * 3),
    }
    return run, found | results


def write_runs(file: Path, records: Iterable[Record]) -> None:
    """Add runs to a file of records."""
    results = {key_of(run): (run, found) for run, found in records}
    run_missing(lambda run: results[key_of(run)][1], [run for run, _ in results.values()], file, workers=1)


def loaded(folder: Path, records: Iterable[Record]) -> pd.DataFrame:
    """Return runs as they are read from the file of the benchmark."""
    write_runs(folder / RUNS, records)
    return load_runs(folder / RUNS)


def headline_of(folder: Path, records: Iterable[Record], data: str = "paired") -> pd.DataFrame:
    """Return the runs of a data set as the tables of groups take them."""
    return of_data(loaded(folder, records), data)


def rows_of(table: ResultTable) -> dict[str, dict[str, str]]:
    """Return the cells of a table by its first column and by its columns' names."""
    return {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.cells}


def look_up_method(study, run: dict[str, Any]) -> dict[str, Any]:
    """Return the class of a run's method, in whichever process."""
    time.sleep(0.5)
    results = {"problem": None, "mae_n": [0.1] * 3, "r2": [0.5] * 3}
    return results | {"found": find_method(run["method"]).__name__, "pid": os.getpid()}
