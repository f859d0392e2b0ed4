"""The registry of benchmarks: what it says is there, no study knows it, and the command measures what was asked for."""

import ast
import inspect
from pathlib import Path
from pkgutil import resolve_name

import pytest

from gelgap.benchmarks.registry import BENCHMARKS, Benchmark
from gelgap.cli.main import main

REGISTRY = Path(inspect.getfile(Benchmark))


def test_every_benchmark_has_the_protocol():
    for name, benchmark in BENCHMARKS.items():
        parameters = ["quick", "out_dir", "data"] if benchmark.needs_data else ["quick", "out_dir"]
        function = resolve_name(f"gelgap.benchmarks.{benchmark.place}")
        assert list(inspect.signature(function).parameters) == parameters, name


def test_no_study_imports_the_registry():
    for source in REGISTRY.parent.rglob("*.py"):
        imported = {
            node.module for node in ast.walk(ast.parse(source.read_text())) if hasattr(node, "module")
        }
        assert "gelgap.benchmarks.registry" not in imported, source


def test_the_command_measures_what_was_asked_for(monkeypatch, tmp_path):
    reached = []
    monkeypatch.setattr(
        "gelgap.benchmarks.physics.stability.run", lambda quick, out_dir: reached.append((quick, out_dir))
    )
    main(["benchmark", "stability", "--quick", "--out", str(tmp_path)])
    assert reached == [(True, tmp_path)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["sensors"], "--data is missing"),
        (["physics", "--data", "."], "--data is for benchmarks of real data alone"),
        (["adaptation-lights", "--quick"], "this benchmark has no quick form"),
    ],
)
def test_what_a_benchmark_does_not_take_is_refused_before_anything_is_written(
    arguments, message, tmp_path, capsys
):
    with pytest.raises(SystemExit) as stopped:
        main(["benchmark", *arguments, "--out", str(tmp_path / "out")])
    assert stopped.value.code == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
