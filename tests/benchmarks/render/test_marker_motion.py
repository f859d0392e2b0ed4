"""`gelgap benchmark markers --quick` runs, and finds displacements near the true ones, no marker mistaken."""

import json
from pathlib import Path

import pytest

from gelgap.benchmarks.render import marker_motion
from gelgap.cli.main import main


def test_the_quick_benchmark_runs_and_markers_are_found_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(marker_motion, "LIGHTS", ("i1",))
    main(["benchmark", "markers", "--quick", "--out", str(tmp_path)])
    rows = json.loads((tmp_path / "markers.json").read_text())
    assert [(row["pattern"], row["way"]) for row in rows[::2]] == [
        (name, "markers") for name in marker_motion.QUICK
    ]
    for row in rows[::2]:
        assert row["wrong"] == 0
        assert row["lost %"] < 5
        assert row["of a marker"] < 8
        assert row["of what is seen"] < row["error"] < 40
