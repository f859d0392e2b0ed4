"""What all studies share: records by the hash of their settings, workers, arrays, bootstrap, tables."""

import math
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gelgap.adapt.result_table import ResultTable
from gelgap.benchmarks.common import drawn_means, interval, key_of, read_records, run_missing, write_records

GRID = [{"size": size, "ways": ("a", "b"), "seed": 0} for size in (3, 1, 2)]
STUDY = """
import os, sys, time
from pathlib import Path
from gelgap.benchmarks.common import run_missing

FILE, HOW = Path(sys.argv[1]), sys.argv[2]

def measure(setting):
    if HOW == "dies" and setting["number"] == 1:
        os._exit(9)
    if HOW == "hangs" and setting["number"] == 3:
        FILE.with_name("hanging").touch()
        time.sleep(600)
    time.sleep(0.5)
    return {"square": setting["number"] ** 2, "pid": os.getpid(), "threads": os.environ["OMP_NUM_THREADS"]}

if __name__ == "__main__":
    fresh = 1 if HOW == "fresh" else None
    run_missing(measure, [{"number": n} for n in range(6)], FILE, workers=2, tasks_per_worker=fresh)
"""


def squares(file: Path, grid=GRID, **options) -> tuple[pd.DataFrame, list[int]]:
    """Return the records of a study in this process, and what was measured now."""
    did = []

    def measure(setting: dict) -> dict:
        did.append(setting["size"])
        return {"area": np.float64(setting["size"] ** 2), "shape": {"x": 1, "y": [1, 2]}}

    return run_missing(measure, grid, file, workers=1, **options), did


def study(folder: Path, how: str) -> subprocess.Popen:
    """Start a study on two workers in a process of its own."""
    (folder / "study.py").write_text(STUDY)
    command = [sys.executable, folder / "study.py", folder / "squares.jsonl", how]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_what_is_finished_is_not_measured_again_and_a_tuple_is_its_list(tmp_path):
    file = tmp_path / "squares.jsonl"
    assert squares(file, stop=time.time())[1] == []
    found, did = squares(file)
    assert did == [3, 1, 2]
    assert squares(file)[1] == []
    more, did = squares(file, [*GRID, {"size": 4, "ways": ["a", "b"], "seed": 0}])
    assert did == [4]
    assert list(found["size"]) == [3, 1, 2]
    assert list(more["area"]) == [9, 1, 4, 16]
    assert more["shape.y"].iloc[0] == (1, 2)
    assert list(more.groupby("ways")["area"].sum()) == [30]
    assert found.index[0] == key_of({"seed": 0, "ways": ["a", "b"], "size": 3})
    assert list(squares(file, GRID[1:2])[0]["size"]) == [1]


def test_damaged_lines_are_named_and_a_cut_one_is_left_out(tmp_path, caplog):
    file = tmp_path / "squares.jsonl"
    squares(file)
    lines = file.read_bytes().splitlines()
    file.write_bytes(b"\n".join([lines[0].replace(b"9.0", b"8.0"), b"[[", b'{"job": 3}', *lines[1:]])[:-20])
    found, did = squares(file)
    assert did == [3, 2]
    assert list(found["area"]) == [9, 1, 4]
    # The cut line is damaged as well, now that others follow it.
    assert [int(text.split(",")[0]) for text in caplog.text.split("squares.jsonl, line ")[1:]] == [
        1,
        2,
        3,
    ] * 2 + [5]
    caplog.clear()
    assert squares(file)[1] == []


def test_a_record_of_something_else_is_refused(tmp_path):
    file = tmp_path / "squares.jsonl"
    squares(file, fixed=lambda setting: {"configuration": "c", "profile": "cpu"})
    assert squares(file, fixed=lambda setting: {"profile": "cpu"})[1] == []
    with pytest.raises(
        ValueError, match=r"squares.jsonl: the record of size = 3 .* of another configuration than"
    ):
        squares(file, fixed=lambda setting: {"configuration": "d"})
    assert squares(file, [{"size": 7}], fixed=lambda setting: {"configuration": "d"})[1] == [7]


def test_arrays_lie_beside_the_records_and_are_measured_again_if_damaged(tmp_path):
    file = tmp_path / "pictures.jsonl"

    def found() -> tuple[pd.DataFrame, int]:
        did = []

        def measure(setting: dict) -> dict:
            did.append(setting)
            return {"picture": np.full((2, 3), setting["n"]), "time": np.array(time.time()), "nan": math.nan}

        return run_missing(measure, [{"n": 1}, {"n": 2}], file, workers=1), len(did)

    assert found()[1] == 2
    table, did = found()
    assert did == 0
    assert table["picture"].iloc[1].tolist() == [[2] * 3] * 2
    first, second = (tmp_path / "pictures" / f"{key}.npz" for key in table.index)
    first.write_bytes(first.read_bytes()[:-9] + b"damaged!!")
    second.unlink()
    assert found()[1] == 2
    assert found()[1] == 0


@pytest.mark.parametrize("how", ["reused", "fresh"])
def test_workers_are_processes_of_one_thread(tmp_path, how):
    process = study(tmp_path, how)
    out, error = process.communicate(timeout=120)
    assert (process.returncode, error) == (0, "")
    found = read_records(tmp_path / "squares.jsonl").sort_values("number")
    assert list(found["square"]) == [0, 1, 4, 9, 16, 25]
    assert set(found["threads"]) == {"1"}
    assert found["pid"].nunique() == (6 if how == "fresh" else 2)
    assert "6/6  " in out


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGKILL])
def test_a_stop_keeps_what_is_finished_and_leaves_no_worker(tmp_path, stop):
    process = study(tmp_path, "hangs")
    while not (tmp_path / "hanging").exists():
        time.sleep(0.05)
        assert process.poll() is None
    time.sleep(1.0)
    workers = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    process.send_signal(stop)
    _, error = process.communicate(timeout=60)
    assert error.count("Traceback") == (stop == signal.SIGINT)  # of the study itself
    deadline = time.time() + 10
    while any(Path(f"/proc/{pid}").exists() for pid in workers) and time.time() < deadline:
        time.sleep(0.1)
    assert not [pid for pid in workers if Path(f"/proc/{pid}").exists()]
    assert {0, 1} <= set(read_records(tmp_path / "squares.jsonl")["number"])
    assert study(tmp_path, "reused").wait(120) == 0
    assert len(read_records(tmp_path / "squares.jsonl")) == 6


def test_a_worker_that_dies_is_one_sentence(tmp_path):
    process = study(tmp_path, "dies")
    _, error = process.communicate(timeout=120)
    assert error.splitlines()[-1].startswith("RuntimeError: a worker process died, perhaps for want")


def test_bootstrap_interval_holds_the_mean():
    values = np.random.default_rng(0).standard_normal((200, 1))
    low, high = interval(drawn_means(values))
    assert low < values.mean() < high
    assert high - low == pytest.approx(2 * 1.96 / np.sqrt(200), rel=0.25)
    low, high = interval(drawn_means(np.hstack([values, np.where(values > 0, values, np.nan)])))
    assert low < values.mean() < high


def test_seeds_that_shift_all_groups_widen_the_interval():
    rng = np.random.default_rng(0)
    own, shared = rng.standard_normal((9, 5)), np.broadcast_to(rng.standard_normal(5), (9, 5))
    (low, high), (low_shared, high_shared) = (interval(drawn_means(one)) for one in (own, shared))
    assert high_shared - low_shared > 1.5 * (high - low)


def test_cases_of_one_cluster_are_no_further_cases():
    """Eight copies of a case say no more than the case: the interval over clusters does not shrink."""
    values = np.random.default_rng(0).normal(size=(4, 5))
    copied = values[[0, 1, 2, 3, 3, 3, 3, 3, 3, 3, 3]]
    alone, as_cases = interval(drawn_means(values)), interval(drawn_means(copied))
    as_cluster = interval(drawn_means(copied, [0, 1, 2, *[3] * 8]))
    assert np.ptp(as_cluster) > 1.2 * np.ptp(as_cases)
    assert np.ptp(as_cluster) > 0.8 * np.ptp(alone)
    assert drawn_means(np.ones((2, 3, 4)), "abc").shape == (4000, 2)
    assert math.isnan(interval(drawn_means(np.full((2, 2), math.nan)))[0])


def test_tables_show_numbers_ranges_and_what_is_not_there():
    frame = pd.DataFrame(
        {
            "error": [0.12345, math.nan],
            "interval": [(0.1, 0.2), (math.nan, math.nan)],
            "n": [1, 2],
            "ok": [True, None],
        },
        index=pd.Index(["dan", "dsan"], name="method"),
    )
    table = ResultTable.of("Errors", frame, "a note", {"error": "{:.1f} %", "interval": "{:+.2f}"})
    assert list(table.columns) == ["method", "error", "interval", "n", "ok"]
    assert table.cells == [["dan", "0.1 %", "+0.10…+0.20", "1", "yes"], ["dsan", "–", "–", "2", "–"]]
    assert ResultTable.of("Errors", frame.reset_index(drop=True)).cells[0][0] == "0.1235"


def test_a_table_is_written_as_records(tmp_path):
    frame = pd.DataFrame(
        {"name": ["a", "b"], "value": [np.float32(0.5), math.nan], "levels": [(1.0, 2.0), (3.0,)]}
    )
    write_records(tmp_path / "new" / "results.jsonl", frame, ("name",))
    found = read_records(tmp_path / "new" / "results.jsonl")
    assert found["name"].tolist() == ["a", "b"]
    assert found["levels"].tolist() == [(1.0, 2.0), (3.0,)]
    assert found["value"].iloc[0] == 0.5
    assert math.isnan(found["value"].iloc[1])
    write_records(tmp_path / "new" / "results.jsonl", frame[:1], ("name",))
    assert len(read_records(tmp_path / "new" / "results.jsonl")) == 1
