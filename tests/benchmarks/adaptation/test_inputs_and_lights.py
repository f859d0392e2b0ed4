"""Inputs and drawn lights: what is run; tables of stored and of made-up records."""

from itertools import product
from pathlib import Path

import pytest
from run_records import record, rows_of, write_runs

from gelgap.adapt.inputs import INPUTS
from gelgap.benchmarks.adaptation import board, groups, inputs_and_lights
from gelgap.benchmarks.adaptation.inputs_and_lights import BOARD_INPUTS
from gelgap.benchmarks.adaptation.study import Part, Study
from gelgap.benchmarks.common import read_records

RUNS = Path(__file__).parents[3] / "docs" / "results" / "runs"


def test_every_input_is_run_where_it_can_be_shown():
    runs = inputs_and_lights.input_grid([("mb0i0", "mb1i1"), ("mb0i0", "wmb0i0")], ["adabn"], [0])
    shown = {(run["target"], dict(run["changes"]).get("input", "pictures")) for run in runs}
    shown_on = {own: {name for target, name in shown if target == own} for own in ("mb1i1", "wmb0i0")}
    assert shown_on == {"mb1i1": set(BOARD_INPUTS), "wmb0i0": set(BOARD_INPUTS) - {"markers"}}
    assert set(INPUTS) - set(BOARD_INPUTS) == {"pretrained"}
    study = Study(Path(), Path(), "benchmark")
    assert {study.profile_of(run).input for run in runs} == set(BOARD_INPUTS)
    (chosen,) = inputs_and_lights.input_grid([("wmb0i0", "wmb0i1")], ["adabn"], [0], ["calibrated"])
    assert study.profile_of(chosen).input == "calibrated"
    with pytest.raises(ValueError, match="--inputs markers: no chosen group has markers on both sides"):
        inputs_and_lights.INPUT_PART.measure(
            Study(Path(), Path(), "benchmark", groups=(("wmb0i0", "wmb0i1"),), inputs=("markers",))
        )


@pytest.mark.parametrize(
    ("stored", "part", "closed"),
    [
        (
            "board-lights",
            inputs_and_lights.LIGHT_PART,
            {"dann / calibrated": "62 %", "adabn / any light": "44 %", "adabn / like the target's": "86 %"},
        ),
        (
            "benchmark",
            inputs_and_lights.INPUT_PART,
            {"adabn / pictures": "44 %", "dann / calibrated": "75 %", "source-only / calibrated": "65 %"},
        ),
        (
            "board-dots",
            inputs_and_lights.INPUT_PART,
            {"adabn / calibrated": "79 %", "source-only / markers": "101 %", "adabn / markers": "99 %"},
        ),
        (
            "board-back",
            inputs_and_lights.INPUT_PART,
            {"adabn / calibrated": "55 %", "dann / calibrated": "58 %"},
        ),
    ],
)
def test_stored_measurements_are_the_published_tables(stored: str, part: Part, closed: dict[str, str]):
    (table,) = part.tables(RUNS / stored)
    rows = rows_of(table)
    page = (RUNS.parent / "README.md").read_text(encoding="utf-8").replace("*", "")
    for name, share in closed.items():
        assert rows[name]["closed"] == share
        cells = [share, *(f"{rows[name][column]}" for column in ("mean, N", "Fz, N", "shear, N"))]
        assert all(f"| {cell} |" in page for cell in cells)


def test_stored_errors_of_all_methods_are_the_published_ones():
    table, control = inputs_and_lights.INPUT_PART.tables(RUNS / "board-methods")
    page = (RUNS.parent / "README.md").read_text(encoding="utf-8").replace("*", "").replace("−", "-")
    cells, differences = rows_of(table), rows_of(control)
    shown = differences.keys() & set(board.METHODS)
    assert len(shown) == 12
    for method in shown:
        row = cells[f"{method} / calibrated"]
        difference = differences[method]["difference, N"].replace("+0.0000", "0.0000")
        assert f"| {row['closed']} | {row['mean, N']} | {difference}" in page
        assert f"| {row['Fz, N']} | {row['shear, N']} |" in page


def test_stored_errors_on_shifted_labels_are_the_published_ones():
    own = RUNS / "board-shifted"
    tables = {
        table.title: table for table in (*groups.PART.tables(own), *inputs_and_lights.LIGHT_PART.tables(own))
    }
    page = (RUNS.parent / "README.md").read_text(encoding="utf-8").replace("*", "")
    titles = ("All methods, {} contacts: mean over 2 groups", "Adapt or randomise? {} contacts")
    for title, data in product(titles, board.BY_ROLE):
        table = tables[title.format(data)]
        # Shifted labels have no upper bound, so that no share of a gap can mislead.
        assert ("closed" in table.columns) == (data == board.DATA)
        for row in (row for name, row in rows_of(table).items() if not name.startswith("label-shift")):
            assert f" {row['mean, N']} | {row['Fz, N']} | {row['shear, N']} |" in page


def test_all_stored_records_can_be_read():
    files = sorted(RUNS.rglob("*.jsonl"))
    lines = {file: len(file.read_text(encoding="utf-8").splitlines()) for file in files}
    assert {file: len(read_records(file)) for file in files} == lines
    assert min(lines.values()) > 0


def test_drawn_lights_are_compared_on_the_labels_that_both_were_judged_by(tmp_path):
    pair, drawn = ("wmb0i0", "wmb0i1"), (board.LIKE + "wmb0i1", "wmb0i1")
    write_runs(tmp_path / inputs_and_lights.INPUT_RUNS, [record(pair, "source-only", 0.3, data=board.DATA)])
    write_runs(tmp_path / groups.RUNS, [record(pair, "source-only", 0.2, data=board.LABEL_SHIFT)])
    write_runs(tmp_path / inputs_and_lights.LIGHT_RUNS, [record(drawn, "source-only", 0.1, data=board.DATA)])
    (unshifted,) = inputs_and_lights.LIGHT_PART.tables(tmp_path)
    assert board.DATA in unshifted.title
    write_runs(
        tmp_path / inputs_and_lights.LIGHT_RUNS, [record(drawn, "source-only", 0.15, data=board.LABEL_SHIFT)]
    )
    _, shifted = inputs_and_lights.LIGHT_PART.tables(tmp_path)
    rows = rows_of(shifted)
    assert rows["source-only / pictures"]["mean, N"] == "0.200"
    assert rows["source-only / like the target's"]["mean, N"] == "0.150"


def test_an_upper_bound_is_on_the_input_that_it_bounds(tmp_path):
    group, own = ("wmb0i0", "wmb0i1"), [("wmb0i1", "wmb0i1")] * 2
    calibrated = inputs_and_lights.changes_of("calibrated")
    asked = inputs_and_lights.upper_bounds_of(
        inputs_and_lights.input_grid([group], ["adabn"], [0], ["calibrated"])
    )
    assert [(run["source"], run["changes"]) for run in asked] == [("wmb0i1", calibrated)]
    runs = [record(group, "source-only", 0.4, data=board.DATA)]
    runs += [record(group, "adabn", 0.3, 0, board.DATA, changes) for changes in (board.BY_POINT, calibrated)]
    write_runs(tmp_path / inputs_and_lights.INPUT_RUNS, runs)
    bounds = zip(own, (0.2, 0.1), (board.BY_POINT, calibrated), strict=True)
    found = [record(pair, "source-only", n, 0, board.DATA, c, r2=(0.95,) * 3) for pair, n, c in bounds]
    write_runs(tmp_path / groups.RUNS, found)
    (table, *_) = inputs_and_lights.INPUT_PART.tables(tmp_path)
    rows = rows_of(table)
    assert rows["adabn / pictures"]["closed"] == "50 %"
    assert rows["adabn / calibrated"]["closed"] == "33 %"


def test_where_controls_were_run_the_table_says_what_losses_bring(tmp_path):
    group, calibrated = ("wmb0i0", "wmb0i1"), inputs_and_lights.changes_of("calibrated")
    runs = [record(group, "source-only", 0.3, data=board.DATA)]
    errors = {"source-only": 0.2, "adabn": 0.15, "no-transfer": 0.14, "dann": 0.12}
    runs += [record(group, method, error, 0, board.DATA, calibrated) for method, error in errors.items()]
    write_runs(tmp_path / inputs_and_lights.INPUT_RUNS, runs)
    _, table = inputs_and_lights.INPUT_PART.tables(tmp_path)
    assert "calibrated" in table.title
    brought = {method: row["difference, N"] for method, row in rows_of(table).items()}
    assert brought == {"adabn": "-0.0500", "no-transfer": "-0.0100", "dann": "-0.0200"}
