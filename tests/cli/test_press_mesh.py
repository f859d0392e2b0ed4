"""`gelgap press --mesh` writes membrane and sphere."""

from collections.abc import Callable
from pathlib import Path

import pytest
import trimesh

from gelgap.cli.main import main


def test_a_press_is_written_as_a_mesh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "out.ply"
    main(["press", "--depth-mm", "0.2", "--quality", "draft", "--mesh", str(path)])
    assert "force" in capsys.readouterr().out
    low, high = trimesh.load(path).bounds
    assert low[2] == pytest.approx(-0.2, abs=0.01)
    assert high[2] == pytest.approx(2.8, abs=1e-3)


def test_another_format_is_refused_before_anything_is_solved(refused: Callable[..., str]) -> None:
    assert ".glb, .ply" in refused("press", "--mesh", "out.stl")
