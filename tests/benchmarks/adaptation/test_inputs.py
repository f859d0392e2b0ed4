"""Inputs and drawn lights: what is run, and what stands beside what in the tables."""

from pathlib import Path

from run_records import loaded, record, rows_of

from gelgap.adapt.inputs import INPUTS
from gelgap.benchmarks.adaptation import protocol
from gelgap.benchmarks.adaptation.inputs import input_grid, tables
from gelgap.benchmarks.adaptation.protocol import BY_POINT, DATA, DRAWN_LIGHTS, SHOWABLE, changes_of, shown_in
from gelgap.benchmarks.adaptation.study import Study, upper_bounds_of

GROUP = ("wmb0i0", "wmb0i1")
LIT = (protocol.LIKE + "wmb0i1", "wmb0i1")


def test_every_input_is_run_where_it_can_be_shown():
    runs = input_grid([("mb0i0", "mb1i1"), ("mb0i0", "wmb0i0")], ["adabn"], [0])
    shown = {(run["target"], shown_in(run["source"], run["changes"])) for run in runs}
    shown_on = {own: {name for target, name in shown if target == own} for own in ("mb1i1", "wmb0i0")}
    assert shown_on["mb1i1"] == set(SHOWABLE)
    assert shown_on["wmb0i0"] == {*SHOWABLE, *DRAWN_LIGHTS} - {"markers"}
    assert set(INPUTS) - set(SHOWABLE) == {"pretrained"}
    study = Study(Path(), Path(), "benchmark")
    assert {study.profile_of(run).input for run in runs} == set(SHOWABLE)
    (chosen,) = input_grid([GROUP], ["adabn"], [0], ["calibrated"])
    assert study.profile_of(chosen).input == "calibrated"


def test_what_is_not_of_the_protocol_shows_nothing():
    assert shown_in("wmb0i0", (*BY_POINT, ("adapt_epochs", 3))) is None
    assert shown_in(protocol.ANY_LIGHT, changes_of("calibrated")) == "calibrated"


def test_drawn_lights_stand_beside_the_groups_of_their_target(tmp_path):
    found = [record(GROUP, "source-only", 0.3, data=DATA), record(LIT, "source-only", 0.1, data=DATA)]
    found.append(record(LIT, "source-only", 0.15, data=protocol.LABEL_SHIFT))
    by_target, worth = tables(loaded(tmp_path, found))
    assert [(row[0], row[2]) for row in by_target.cells] == [
        ("pictures", "0.300"),
        ("like-target", "0.100"),
    ]
    rows = rows_of(worth)
    assert rows["source-only / pictures"]["mean, N"] == "0.300"
    assert rows["source-only / like-target"]["mean, N"] == "0.100"
    assert "drawn" in worth.note.lower()


def test_an_upper_bound_is_on_the_input_that_it_bounds(tmp_path):
    own, calibrated = ("wmb0i1", "wmb0i1"), changes_of("calibrated")
    (asked,) = upper_bounds_of(input_grid([GROUP], ["adabn"], [0], ["calibrated"]))
    assert (asked["source"], asked["changes"]) == ("wmb0i1", calibrated)
    found = [record(GROUP, "source-only", 0.4, data=DATA)]
    found += [record(GROUP, "adabn", 0.3, 0, DATA, changes) for changes in (BY_POINT, calibrated)]
    for error_n, changes in ((0.2, BY_POINT), (0.1, calibrated)):
        found.append(record(own, "source-only", error_n, 0, DATA, changes, r2=(0.95,) * 3))
    _, worth = tables(loaded(tmp_path, found))
    rows = rows_of(worth)
    assert rows["adabn / pictures"]["closed"] == "50 %"
    assert rows["adabn / calibrated"]["closed"] == "33 %"


def test_where_controls_were_run_the_table_says_what_losses_bring(tmp_path):
    found = [record(GROUP, "source-only", 0.3, data=DATA)]
    errors = {"source-only": 0.2, "adabn": 0.15, "no-transfer": 0.14, "dann": 0.12}
    found += [
        record(GROUP, method, error, 0, DATA, changes_of("calibrated")) for method, error in errors.items()
    ]
    *_, table = tables(loaded(tmp_path, found))
    assert "calibrated" in table.title
    brought = {method: row["difference, N"] for method, row in rows_of(table).items()}
    assert brought == {"adabn": "-0.0500", "no-transfer": "-0.0100", "dann": "-0.0200"}
