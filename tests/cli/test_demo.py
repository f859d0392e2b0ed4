"""The demo at its smallest: every stage runs, the page holds its pictures."""

import time
from pathlib import Path

import numpy as np
import pytest

from gelgap.adapt import Profile
from gelgap.cli.demo import Demo, timed
from gelgap.cli.demo_page import SOURCE, TARGET, DemoResult
from gelgap.cli.main import main

TINY_PATH = """points_x_mm = [-1.0, 1.0]
points_y_mm = [0.0]
depths_mm = [0.2, 0.6]
radii_mm = [0.1]
angles_deg = [0, 30, 60, 90, 120, 150, 180, 210, 240, 270, 300, 330]
"""


def test_the_demo_runs_end_to_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "tiny.toml").write_text(TINY_PATH)
    few_epochs = Profile.preset("smoke").replace(source_epochs=4, adapt_epochs=2)
    monkeypatch.setattr(Profile, "preset", lambda name: few_epochs)
    whole, results = Demo.result, []

    def keeping(demo: Demo) -> DemoResult:
        results.append(whole(demo))
        return results[0]

    monkeypatch.setattr(Demo, "result", keeping)
    words = ["demo", "--out", str(tmp_path), "--path", str(tmp_path / "tiny.toml"), "--quality", "draft"]
    main([*words, "--size", "64", "48", "--scheduler", "synchronous"])
    (result,) = results
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == page.count('<label class="picture">') == 3
    assert "http" not in page
    assert result.headline.split(":")[0] in page
    assert {domain for _, domain in result.errors} == {SOURCE, TARGET}
    assert np.isfinite([error.mean_mae_n for error in result.errors.values()]).all()
    assert np.all(np.abs(result.curve["force_n"] / result.curve["reference_n"] - 1) < 0.15)
    shown = capsys.readouterr().out
    assert "frames" in shown
    assert result.headline in shown


def test_the_time_of_a_stage_is_measured() -> None:
    stages_s: dict[str, float] = {}
    with timed("wait", stages_s):
        time.sleep(0.05)
    assert list(stages_s) == ["wait"]
    assert stages_s["wait"] >= 0.05
