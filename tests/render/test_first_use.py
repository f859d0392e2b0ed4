"""The first compilation of the renderer is announced, once, and loading compiled code is not."""

import os
import subprocess
import sys
from pathlib import Path

COMPILE = """
import numba
from gelgap.render import renderer
def one(x):
    return x + 1
def two(x):
    return x + 2
one.__module__ = two.__module__ = MODULE
for function in (one, two):
    numba.njit(function)(1)
"""


def said(module: str, tmp_path: Path) -> str:
    run = subprocess.run(
        [sys.executable, "-c", COMPILE.replace("MODULE", repr(module))],
        env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    return run.stderr


def test_only_gelgaps_own_compilation_is_said_and_only_once(tmp_path: Path) -> None:
    assert said("gelgap.render.light.gloss", tmp_path).count("numba compiles the renderer") == 1
    assert said("elsewhere", tmp_path) == ""
