"""The demo at its smallest: every stage runs, the page holds its pictures."""

import re
from functools import partial
from pathlib import Path

import pytest

from gelgap import domains
from gelgap.adapt import Profile
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
    monkeypatch.setattr("gelgap.cli.demo.PATH", str(tmp_path / "tiny.toml"))
    monkeypatch.setattr(domains, "generate", partial(domains.generate, scheduler="synchronous"))
    main(["demo", "--out", str(tmp_path)])
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 2
    assert "http" not in page
    assert "From mb0i0 to wmb1i1" in (tmp_path / "wmb1i1.html").read_text(encoding="utf-8")
    shown = capsys.readouterr().out
    assert re.search(r"DSAN (beats|does NOT beat) source-only on the target: mean error 0\.\d+ N", shown)
    assert re.search(r"AdaBN, the target.*s normalisation statistics alone, has 0\.\d+ N", shown)
    assert "frames" in shown
    assert all(name in shown for name in ("source-only", "adabn", "dsan", "constant mean"))
