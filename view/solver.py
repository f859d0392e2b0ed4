"""Solves in a process of their own, so that the page never waits; the newest request wins."""

import contextlib
import multiprocessing
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

from gelgap.sim import PoseLibrary
from gelgap.sim.plan import plan_visit
from gelgap.sim.solved import NoContact, SolvedPose
from gelgap.view.state import LibraryRequest, PoseRequest

Request = LibraryRequest | PoseRequest


@dataclass(frozen=True)
class Progress:
    """How many load steps of a request are done."""

    request: Request
    done: int
    total: int


@dataclass(frozen=True)
class SolvedLibrary:
    """The library that was asked for."""

    request: LibraryRequest
    result: PoseLibrary


@dataclass(frozen=True)
class SolvedAlone:
    """The pose that was asked for."""

    request: PoseRequest
    result: SolvedPose | NoContact


@dataclass(frozen=True)
class Failed:
    """Why a request has no result, in one sentence."""

    request: Request
    reason: str


Answer = Progress | SolvedLibrary | SolvedAlone | Failed


class Solver:
    """One process that solves the newest request; `on_answer` hears of it in a thread of its own.

    A process that dies is reported as a failure of what it solved, and the next request starts another.
    """

    def __init__(self, on_answer: Callable[[Answer], None]) -> None:
        self._on_answer = on_answer
        self._lock = threading.Lock()
        self._process: BaseProcess | None = None
        self._connection: Connection | None = None
        self._current: Request | None = None
        self._closed = False

    def request(self, request: Request) -> None:
        """Have something solved instead of what is being solved now; the same once more changes nothing."""
        with self._lock:
            if self._closed or request == self._current:
                return
            self._current = request
            if self._process is None or self._connection is None:
                context = multiprocessing.get_context("spawn")
                self._connection, theirs = context.Pipe()
                self._process = context.Process(target=_serve, args=(theirs,), daemon=True)
                self._process.start()
                theirs.close()
                threading.Thread(target=self._listen, args=(self._connection,), daemon=True).start()
            with contextlib.suppress(OSError):
                self._connection.send(request)

    def close(self) -> None:
        """End the process, whatever it does."""
        with self._lock:
            self._closed = True
            process = self._process
        if process is not None:
            process.terminate()
            process.join()

    def _listen(self, connection: Connection) -> None:
        """Pass on the answers to the newest request."""
        while True:
            try:
                answer: Answer = connection.recv()
            except (EOFError, OSError):
                break
            with self._lock:
                wanted = answer.request == self._current and not self._closed
                if wanted and not isinstance(answer, Progress):
                    self._current = None
            if wanted:
                self._on_answer(answer)
        with self._lock:
            lost, self._current, self._process = self._current, None, None
        if lost is not None and not self._closed:
            self._on_answer(Failed(lost, "the solving process ended before it was done; ask once more"))


class Superseded(Exception):
    """A newer request has come."""


def _serve(connection: Connection) -> None:
    """Answer requests until the other side is gone."""
    # Ctrl-C is the page's to handle.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(EOFError, OSError):
        while True:
            request = connection.recv()
            while connection.poll():
                request = connection.recv()
            with contextlib.suppress(Superseded):
                connection.send(answer_to(request, connection))


def answer_to(request: Request, connection: Connection) -> Answer:
    """Solve a request and return its result; sends its progress.

    Raises
    ------
    Superseded
        If another request has come.
    """
    try:
        if isinstance(request, LibraryRequest):
            plan = request.plan.solved
        else:
            plan = plan_visit(request.elastomer, request.indenter, (request.pose,), request.quality)
        total = sum(solve.problem.load_steps for solve in plan.solves)
        solutions, before = {}, 0

        def tell(done: int, _: int) -> None:
            if connection.poll():
                raise Superseded
            connection.send(Progress(request, before + done, total))

        for solve in plan.solves:
            solutions[solve.key] = solve.run(tell)
            before += solve.problem.load_steps
        if isinstance(request, LibraryRequest):
            return SolvedLibrary(request, request.plan.build(solutions))
        return SolvedAlone(request, plan.state(0, solutions))
    except Superseded:
        raise
    except Exception as error:
        return Failed(request, str(error) or type(error).__name__)
