"""What `gelgap benchmark` lists is there, and it measures what was asked for."""

import inspect
from pkgutil import resolve_name

import pytest

from gelgap.cli.benchmark import SUBJECTS
from gelgap.cli.main import main


def test_every_benchmark_has_the_protocol():
    for name, benchmark in SUBJECTS.items():
        parameters = ["quick", "out_dir", "data"] if benchmark.needs_data else ["quick", "out_dir"]
        function = resolve_name(f"gelgap.benchmarks.{benchmark.place}")
        assert list(inspect.signature(function).parameters) == parameters, name


def test_the_command_measures_what_was_asked_for(monkeypatch, tmp_path):
    reached = []
    monkeypatch.setattr(
        "gelgap.benchmarks.physics.stability.run", lambda quick, out_dir: reached.append((quick, out_dir))
    )
    main(["benchmark", "stability", "--quick", "--out", str(tmp_path)])
    assert reached == [(True, tmp_path)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["sensors"], "--data is missing"), (["physics", "--data", "."], "--data is for benchmarks of real")],
)
def test_what_a_benchmark_does_not_take_is_refused_before_all_else(arguments, message, tmp_path, refused):
    assert message in refused("benchmark", *arguments, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()
