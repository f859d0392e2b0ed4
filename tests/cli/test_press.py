"""`gelgap press` under load control."""

import json
from collections.abc import Callable

import pytest

from gelgap.cli.main import main


def test_press_to_a_force(capsys: pytest.CaptureFixture[str]) -> None:
    main(["press", "--force-n", "0.2", "--quality", "draft", "--json"])
    report = json.loads(capsys.readouterr().out)
    assert report["force_n"][2] == pytest.approx(-0.2, rel=0.01)
    assert 0.2 < report["settings"]["pose"]["depth_mm"] < 0.6


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--depth-mm", "0.2"], ("depth_mm", "normal_force_n")),
        (["--force-n", "-1"], ("--normal-force-n", "-1")),
    ],
)
def test_bad_load_control_is_refused(
    options: list[str], words: tuple[str, ...], refused: Callable[..., str]
) -> None:
    message = refused("press", "--force-n", "0.2", *options)
    assert all(word in message for word in words)


def test_a_press_may_twist(capsys: pytest.CaptureFixture[str], refused: Callable[..., str]) -> None:
    main(["press", "--depth-mm", "0.2", "--twist-deg", "5", "--quality", "draft", "--json"])
    report = json.loads(capsys.readouterr().out)
    assert report["torque_n_mm"][2] > 1e-4
    assert report["settings"]["pose"]["twist_deg"] == 5.0
    assert "twist_deg = 100: must be in [−90, 90]°" in refused("press", "--twist-deg", "100")
