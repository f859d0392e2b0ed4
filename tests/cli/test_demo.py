"""The demo at its smallest: every stage runs, the page holds its pictures."""

import re
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest

from gelgap import domains
from gelgap.adapt import Profile
from gelgap.cli.demo import METHODS, headline
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
    assert re.search(r"source-only 0\.\d+ N; AdaBN, .* alone, 0\.\d+ N \([+-]\d+ %\); DSAN 0\.\d+ N", shown)
    assert "frames" in shown
    assert all(name in shown for name in ("source-only", "adabn", "dsan", "constant mean"))


def run_of(method: str, target_n: float | None, source_n: float = 0.1) -> SimpleNamespace:
    errors = None if target_n is None else SimpleNamespace(mean_mae_n=target_n)
    return SimpleNamespace(
        method=method,
        problem=None if errors else "diverged",
        target_test=errors,
        source_held_out=SimpleNamespace(mean_mae_n=source_n),
        source_constant_mean=SimpleNamespace(mean_mae_n=0.4),
    )


@pytest.mark.parametrize(
    ("errors_n", "source_n", "said"),
    [
        ((0.4, 0.2, 0.1), 0.1, "DSAN 0.100 N (-75 %), so its alignment adds to what AdaBN has (-50 %)"),
        (
            (0.4, 0.2, 0.3),
            0.1,
            "DSAN 0.300 N (-25 %), so its alignment adds NOTHING to what AdaBN has (+50 %)",
        ),
        ((0.4, 0.2, 0.1), 0.2, "source-only did NOT learn"),
        ((0.4, 0.2, None), 0.1, "dsan failed: diverged"),
    ],
)
def test_the_headline_tells_methods_by_name_and_what_each_earns(
    errors_n: tuple[float | None, ...], source_n: float, said: str
) -> None:
    runs = [run_of(method, error, source_n) for method, error in zip(METHODS, errors_n, strict=True)]
    assert said in headline(runs[::-1])
