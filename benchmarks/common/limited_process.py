"""Run a function in a process of its own that may crash or hang without harm."""

import multiprocessing
import resource
import signal
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any


@dataclass(frozen=True)
class Attempt:
    """What came of it: `value`, or else `failure` says in a few words why there is none."""

    value: Any = None
    failure: str | None = None


WALL_PER_PROCESSOR = 10  # a process that sleeps, or starves on a busy machine, ends after this many limits


def run_limited(function: Callable[[Any], Any], argument: Any, limit_s: float) -> Attempt:
    """Call `function(argument)` (both picklable) in a fresh process that gets `limit_s` of processor time."""
    spawn = multiprocessing.get_context("spawn")
    receiver, sender = spawn.Pipe(duplex=False)
    process = spawn.Process(target=_call, args=(function, argument, limit_s, sender))
    process.start()
    sender.close()
    no_end = Attempt(failure=f"no end within {limit_s:g} s of processor time")
    try:
        attempt = receiver.recv() if receiver.poll(WALL_PER_PROCESSOR * limit_s) else no_end
    except EOFError:
        process.join()
        ended = Attempt(failure=f"process ended with code {process.exitcode}")
        attempt = no_end if process.exitcode == -signal.SIGXCPU else ended
    finally:
        if process.is_alive():
            process.kill()
        process.join()
        receiver.close()
    return attempt


def _call(function: Callable[[Any], Any], argument: Any, limit_s: float, sender: Connection) -> None:
    seconds = max(1, round(limit_s))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    try:
        attempt = Attempt(function(argument))
    except Exception as error:
        attempt = Attempt(failure=f"{type(error).__name__}: {error}")
    sender.send(attempt)
    sender.close()
