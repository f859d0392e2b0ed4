"""A renderer's first compilation is announced, once; other compilations and loading compiled code are not."""

import subprocess
import sys

COMPILE = """
import numba
from numba.core import event
from gelgap.render import renderer
numba.njit(lambda x: x)(1)
print("before", flush=True)
with event.install_listener("numba:compile", renderer._ANNOUNCEMENT):
    numba.njit(lambda x: x + 1)(1)
    numba.njit(lambda x: x + 2)(1)
"""


def test_only_a_renderers_compilation_is_said_and_only_once() -> None:
    run = subprocess.run(
        [sys.executable, "-c", COMPILE],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=True,
    )
    before, after = run.stdout.split("before")
    assert before == ""
    assert after.count("numba compiles the renderer") == 1
