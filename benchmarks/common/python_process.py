"""Start Python code in a process and a session of its own, which can be stopped as one that a user started."""

import signal
import subprocess
import sys
from typing import IO


def start_python(
    code: str, stdout: IO | int = subprocess.DEVNULL, stderr: IO | int = subprocess.DEVNULL
) -> subprocess.Popen:
    """Return the process; it heeds kill -INT, which a shell's background jobs and their children ignore."""
    return subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=stdout,
        stderr=stderr,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
