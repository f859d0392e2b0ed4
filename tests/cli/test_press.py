"""`gelgap press`: to a force, with a twist, with a body from a file, and written as a mesh."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
import trimesh

from gelgap.cli.main import main


def test_a_press_to_a_force_is_written_as_a_mesh(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    main(["press", "--force-n", "0.2", "--quality", "draft", "--json", "--mesh", str(tmp_path / "out.ply")])
    report = json.loads(capsys.readouterr().out)
    assert report["force_n"][2] == pytest.approx(-0.2, rel=0.01)
    depth_mm = report["settings"]["pose"]["depth_mm"]
    assert 0.2 < depth_mm < 0.6
    low, high = trimesh.load(tmp_path / "out.ply").bounds
    assert low[2] == pytest.approx(-depth_mm, abs=0.01)
    assert high[2] == pytest.approx(3.0 - depth_mm, abs=1e-3)


def test_a_press_may_twist(capsys: pytest.CaptureFixture[str], refused: Callable[..., str]) -> None:
    main(["press", "--depth-mm", "0.2", "--turn-deg", "0", "0", "5", "--quality", "draft", "--json"])
    report = json.loads(capsys.readouterr().out)
    assert report["torque_n_mm"][2] > 1e-4
    assert report["settings"]["pose"]["twist_deg"] == 5.0
    assert "twist_deg = 100: must be in [−90, 90]°" in refused("press", "--turn-deg", "0", "0", "100")


def test_a_press_that_does_not_converge_says_how_far_it_came(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gelgap.sim.newton.most_iterations", lambda _: 12)
    main(["press", "--quality", "draft", "--depth-mm", "0.513"])
    told = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("converged"))
    assert "NO: the indenter came 0." in told
    assert told.endswith("try --quality standard, less depth or travel")


def test_a_mesh_file_is_read_in_its_unit_and_turned_over(tmp_path: Path, refused: Callable[..., str]) -> None:
    tip = trimesh.util.concatenate(
        [trimesh.creation.box((0.003, 0.003, 0.012)), trimesh.creation.box((0.016, 0.016, 0.004))]
    )
    tip.vertices[8:, 2] -= 0.008
    tip.export(tmp_path / "tip.stl")
    press = ("press", "--depth-mm", "9", "--indenter", str(tmp_path / "tip.stl"), "--set", "edge_radius_mm=0")
    assert "set unit: " in refused(*press)
    assert "16 × 16 × 4 mm" in refused(*press, "--set", "unit=m")
    message = refused(*press, "--set", "unit=m", "flip=true")
    assert "3 × 3 × 12 mm, the convex end of a body of 16 × 16 × 16 mm" in message
    assert "touches by its top (+z, of glTF +y)" in message
    assert "flip: a box has none" in refused("press", "--indenter", "box", "--set", "flip=true")


def test_a_size_without_commas_is_told_how_it_is_written(refused: Callable[..., str]) -> None:
    said = refused("press", "--indenter", "box", "--set", "size_mm=3 2")
    assert "size_mm = '3 2': must be several values with commas between" in said
