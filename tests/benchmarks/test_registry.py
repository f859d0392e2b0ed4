"""The registry of benchmarks: what it says is there, and the command line measures what was asked for."""

import inspect
from pathlib import Path

import pytest

from gelgap.benchmarks.registry import BENCHMARKS, Benchmark, find_benchmarks, parts_of, subjects
from gelgap.cli.main import main


@pytest.mark.parametrize("benchmark", BENCHMARKS, ids=lambda benchmark: benchmark.place)
def test_every_benchmark_has_the_protocol(benchmark):
    data = {"data": Path("clones")} if benchmark.needs_data else {}
    place = benchmark.load()
    assert inspect.signature(getattr(place, "run", place)).bind(quick=True, out_dir=Path("out"), **data)
    assert benchmark.description
    assert (benchmark.part is None) == (not parts_of(benchmark.subject))


def test_every_subject_has_something_to_measure_in_both_forms():
    for subject in subjects():
        for quick in (False, True):
            assert find_benchmarks(subject, None, quick)


@pytest.mark.parametrize(
    ("arguments", "places"),
    [
        (["physics"], ["physics.accuracy"]),
        (["stability"], ["physics.stability"]),
        (["stability", "--what", "physics"], ["physics.stability"]),
        (["adaptation", "--what", "crossed"], ["adaptation.rivals:CROSSED_PART"]),
        (["adaptation", "--quick"], ["adaptation.groups:PART"]),
        (["adaptation"], [part.place for part in parts_of("adaptation")]),
    ],
)
def test_the_command_measures_what_was_asked_for(arguments, places, monkeypatch, tmp_path):
    reached = []
    monkeypatch.setattr(Benchmark, "run", lambda benchmark, *given: reached.append(benchmark.place))
    main(["benchmark", *arguments, "--out", str(tmp_path)])
    assert reached == places
