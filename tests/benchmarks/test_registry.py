"""The registry of benchmarks: what it says is there, and the command line measures what was asked for."""

import inspect
from pathlib import Path

import pytest

from gelgap.benchmarks.registry import BENCHMARKS, find_benchmarks, parts_of, subjects
from gelgap.cli.main import main


@pytest.mark.parametrize("benchmark", BENCHMARKS, ids=lambda benchmark: benchmark.module)
def test_every_benchmark_has_the_protocol(benchmark):
    data = {"data": Path("clones")} if benchmark.needs_data else {}
    assert inspect.signature(benchmark.load().run).bind(quick=True, out_dir=Path("out"), **data)
    assert benchmark.description
    assert (benchmark.part is None) == (not parts_of(benchmark.subject))


def test_every_subject_has_something_to_measure_in_both_forms():
    for subject in subjects():
        for quick in (False, True):
            assert find_benchmarks(subject, None, quick)


@pytest.mark.parametrize(
    ("arguments", "modules"),
    [
        (["physics"], ["physics.accuracy"]),
        (["stability"], ["physics.stability"]),
        (["stability", "--what", "losses"], ["adaptation.losses"]),
        (["stability", "--what", "published"], ["adaptation.published_losses"]),
        (["adaptation", "--what", "gaps"], ["adaptation.gaps"]),
        (["adaptation", "--quick"], ["adaptation.groups", "adaptation.speed"]),
        (["adaptation"], [f"adaptation.{part.part}" for part in parts_of("adaptation")]),
    ],
)
def test_the_command_measures_what_was_asked_for(arguments, modules, monkeypatch, tmp_path):
    reached = []
    for benchmark in BENCHMARKS:
        monkeypatch.setattr(
            benchmark.load(), "run", lambda quick, out_dir, module=benchmark.module: reached.append(module)
        )
    main(["benchmark", *arguments, "--out", str(tmp_path)])
    assert reached == modules
