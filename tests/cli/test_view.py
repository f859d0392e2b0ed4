"""`gelgap view` refuses bad input with one sentence, and ends with one on Ctrl-C."""

import os
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from pathlib import Path

import pytest

VIEW = ("view", "--no-browser")


def test_without_viser_it_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    monkeypatch.setattr("gelgap.assets.extras.find_spec", lambda name: None)
    assert "pip install 'gelgap[view]'" in refused(*VIEW)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--sensor", "papre"], ("sensor preset 'papre'", "did you mean")),
        (["--port", "70000"], ("--port = '70000'", "[0, 65535]")),
    ],
)
def test_it_refuses_bad_values(
    arguments: list[str], words: tuple[str, ...], refused: Callable[..., str]
) -> None:
    message = refused(*VIEW, *arguments)
    assert all(word in message for word in words)


def test_a_gel_too_thin_for_the_path_is_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    pytest.importorskip("viser")
    thin = tmp_path / "thin.toml"
    thin.write_text("young_modulus_mpa = 0.3\npoisson_ratio = 0.49\nfriction = 0.5\nthickness_mm = 0.8\n")
    assert "depth_mm" in refused(*VIEW, "--elastomer", thin, "--port", "0")


def test_a_taken_port_is_refused(refused: Callable[..., str]) -> None:
    pytest.importorskip("viser")
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert f"--port = {port}: Address already in use" in refused(*VIEW, "--port", str(port))


def test_an_address_of_another_machine_is_refused(refused: Callable[..., str]) -> None:
    pytest.importorskip("viser")
    assert "--host = '203.0.113.7'" in refused(*VIEW, "--host", "203.0.113.7", "--port", "0")


def test_it_serves_this_machine_and_ends_on_an_interrupt(tmp_path: Path) -> None:
    pytest.importorskip("viser")
    environment = os.environ | {"GELGAP_CACHE": str(tmp_path)}
    words = [sys.executable, "-m", "gelgap.cli.start", "view", "--no-browser", "--port", "0"]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as served:
        line = served.stdout.readline()
        address = line.split()[1]
        assert address.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(address) as answer:
            assert answer.status == 200
        served.send_signal(signal.SIGINT)
        out, err = served.communicate()
    assert served.returncode == 130
    assert out == ""
    assert err == "gelgap: interrupted; the page is closed, and solved physics is kept\n"
