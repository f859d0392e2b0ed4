"""Ctrl-C ends a program once, also where it comes within an import, a callback from C, or a cleaning up."""

import subprocess
import sys

import pytest

PROGRAM = """
import ctypes, os, signal, sys, time
from gelgap.assets.locks import counted_stops
sys.path.insert(0, {folder!r})

def stop():
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.01)

with counted_stops() as stops:
    try:
{body}
        time.sleep(60)
    except KeyboardInterrupt:
        time.sleep(0.5)
        print("stopped", len(stops) > 0)
"""
CALLBACK = """        called = ctypes.CFUNCTYPE(None)(stop)
        called()"""
CLEANING = """        try:
            stop()
        finally:
            time.sleep(0.5)
            print("clean")"""
IN_TWO = "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\nprint('whole')"
CAUGHT = """import os, signal
try:
    os.kill(os.getpid(), signal.SIGINT)
    print('whole')
except BaseException:
    pass"""


@pytest.mark.parametrize(
    ("body", "package", "said"),
    [
        ("        import package", IN_TWO, "whole"),
        ("        import package", CAUGHT, "whole"),
        (CALLBACK, "", ""),
        (CLEANING, "", "clean"),
    ],
    ids=[
        "an import that would be cut in two",
        "an import that would catch it",
        "a callback",
        "a cleaning up",
    ],
)
def test_a_stop_is_heeded_once(body, package, said, tmp_path):
    (tmp_path / "package.py").write_text(package)
    program = PROGRAM.format(folder=str(tmp_path), body=body)
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=50)
    assert ended.stdout.split() == [*said.split(), "stopped", "True"], ended.stderr
    assert ended.stderr == ""
    assert ended.returncode == 0
